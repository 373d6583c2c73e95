"""IFToMM's N-four-bar mechanism with N = 2: a bar on three parallel cranks, which passes singular configurations.

The cranks stand on the ground at x = 0, 1, 2 and carry one rod over two links' length. Where all of them lie along
x the mechanism may go on as a parallelogram, or fold. Released upright at 1 m/s it goes on as a parallelogram.
"""

from __future__ import annotations

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State
from tests.systems.five_bar import ACROSS

LENGTH, MASS, SPEED, GRAVITY = 1.0, 1.0, 1.0, 9.81


def rod(length: float, mass: float, centre: float) -> Link:
    """Return a slender rod along x."""
    inertia = mass * length**2 / 12
    return Link(mass, (centre, 0, 0), np.diag([0.0, inertia, inertia]))


def n_four_bar(cranks: int = 3) -> tuple[ClosedChain, State]:
    """Return the mechanism upright, its rods moving to the right."""
    hinge = Joint("revolute", (0, 0, 1))
    arms, grasps = {}, {}
    couplers = cranks - 1
    for i in range(cranks):
        base = Pose(np.eye(3), (i * LENGTH, 0, 0))
        arms[f"crank{i}"] = Arm([hinge], [rod(LENGTH, MASS, LENGTH / 2)], tip=Pose(ACROSS, (LENGTH, 0, 0)), base=base)
        grasps[f"crank{i}"] = Grasp("hinge", Pose(ACROSS, (i * LENGTH - couplers * LENGTH / 2, 0, 0)))
    mass = couplers * MASS
    inertia = mass * (couplers * LENGTH) ** 2 / 12
    body = HeldObject(mass, np.diag([1e-3 * inertia, inertia, inertia]))
    chain = ClosedChain(arms, body, grasps, gravity=(0, -GRAVITY, 0))
    pose = [1, 0, 0, 0, couplers * LENGTH / 2, LENGTH, 0]
    twist = [0, 0, 0, SPEED, 0, 0]
    return chain, State(np.full(cranks, np.pi / 2), np.full(cranks, -SPEED / LENGTH), pose, twist)


def passing_times(cranks: int, count: int) -> np.ndarray:
    """Return when the parallelogram's cranks lie along x, by quadrature of its one equation [s].

    Every crank has the inertia m l^2 / 3, the rod moves in parallel: I w^2 / 2 + w_g sin(angle) stays.
    """
    crank_inertia, rod_mass = MASS * LENGTH**2 / 3, (cranks - 1) * MASS
    inertia = cranks * crank_inertia + rod_mass * LENGTH**2
    weight = GRAVITY * LENGTH * (cranks * MASS / 2 + rod_mass)
    quarters = []
    for first, last in ((0.0, 0.5 * np.pi), (-np.pi, 0.0)):
        angles, weights = np.polynomial.legendre.leggauss(60)
        angles = 0.5 * (first + last) + 0.5 * (last - first) * angles
        rates = np.sqrt((SPEED / LENGTH) ** 2 + 2.0 * weight * (1.0 - np.sin(angles)) / inertia)
        quarters.append(0.5 * (last - first) * float(weights @ (1.0 / rates)))
    upper, lower = quarters  # from upright to the right; from there over below to the left
    gaps = [upper, *([lower, 2.0 * upper] * count)][:count]
    return np.cumsum(gaps)
