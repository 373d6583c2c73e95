"""Planar mechanisms in space and, apart from the library, in the plane: where their constraint has no redundant row.

Arms whose joints are all parallel hold one object. In space every grasp but the first also says that the object stays
in its plane, which the others have said. In the complex plane nothing says it: the equations of motion in joint
angles and the object's position, with the loops' closure as constraints, are integrated by SciPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State
from tests.oracles.stepping import constrained, random_rates, runge_kutta
from tests.systems.five_bar import ACROSS

GRAVITY = -9.81j


@dataclass(frozen=True)
class PlanarArm:
    """A serial arm in the plane: lengths, masses, mass centres in link axes, inertias, base, grasp and contact."""

    lengths: np.ndarray
    masses: np.ndarray
    centres: np.ndarray
    inertias: np.ndarray
    base: complex
    grasp: str
    contact: complex  # in object axes
    attitude: float  # of the last link, seen from the object, where the arm holds it rigidly


@dataclass(frozen=True)
class PlanarMechanism:
    """Arms, an object whose mass centre is its origin, and where and how fast it starts.

    Attributes:
        arms: the arms.
        mass, inertia: of the object.
        start: joint angles, then the object's x, y and attitude.
        rates: of the same.
    """

    arms: list[PlanarArm]
    mass: float
    inertia: float
    start: np.ndarray
    rates: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def after(self, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates and rates after a time, under gravity alone."""
        n = len(self.start)
        found = solve_ivp(
            lambda t, y: np.concatenate([y[n:], self.accelerations(y[:n], y[n:])]),
            (0.0, duration),
            np.concatenate([self.start, self.rates]),
            "DOP853",
            rtol=1e-12,
            atol=1e-13,
        )
        return found.y[:n, -1], found.y[n:, -1]

    def stepped(self, duration: float, steps: int) -> np.ndarray:
        """Return coordinates after a time by steps of the classical Runge-Kutta scheme."""
        n = len(self.start)
        y = np.concatenate([self.start, self.rates])
        return runge_kutta(lambda y: np.concatenate([y[n:], self.accelerations(y[:n], y[n:])]), y, duration, steps)[:n]

    def accelerations(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return M a + J^T lambda = f, J a = -J' u, solved for a; the forces need not be unique."""
        return constrained(*self.equations(x, u))

    def equations(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return M, f, J and J' u."""
        n, at = len(x), 0
        M, f, rows, biases = np.zeros((n, n)), np.zeros(n), [], []
        body = np.exp(1j * x[-1])
        M[[-3, -2], [-3, -2]], M[-1, -1], f[-2] = self.mass, self.inertia, self.mass * GRAVITY.imag
        for arm in self.arms:
            part = slice(at, at + len(arm.lengths))
            turns = np.exp(1j * np.cumsum(x[part]))
            spins = np.cumsum(u[part])
            bars = arm.lengths * turns
            joints = arm.base + np.concatenate([[0.0], np.cumsum(bars)])
            pulled = np.concatenate([[0.0], np.cumsum(-(spins**2) * bars)])
            for k, (mass, inertia) in enumerate(zip(arm.masses, arm.inertias, strict=True)):
                lever = arm.centres[k] * turns[k]
                moved, turned = np.zeros(n, dtype=complex), np.zeros(n)
                moved[at : at + k + 1] = 1j * (joints[k] + lever - joints[: k + 1])
                turned[at : at + k + 1] = 1.0
                felt = pulled[k] - spins[k] ** 2 * lever - GRAVITY
                M += mass * np.real(np.outer(moved, moved.conj())) + inertia * np.outer(turned, turned)
                f -= mass * np.real(moved.conj() * felt)
            tip, lever = np.zeros(n, dtype=complex), body * arm.contact
            tip[part] = 1j * (joints[-1] - joints[:-1])
            tip[-3:] -= [1.0, 1j, 1j * lever]
            bias = pulled[-1] + u[-1] ** 2 * lever
            rows += [tip.real, tip.imag]
            biases += [bias.real, bias.imag]
            if arm.grasp == "rigid":
                turned = np.zeros(n)
                turned[part], turned[-1] = 1.0, -1.0
                rows.append(turned)
                biases.append(0.0)
            at = part.stop
        return M, f, np.array(rows), np.array(biases)

    def chain(self) -> tuple[ClosedChain, State]:
        """Return the mechanism in space, in the x-y plane."""
        arms, grasps = {}, {}
        for i, arm in enumerate(self.arms):
            joints = [
                Joint("revolute", (0, 0, 1), Pose(np.eye(3), (before, 0, 0))) for before in (0.0, *arm.lengths[:-1])
            ]
            links = [
                Link(m, (c.real, c.imag, 0), np.diag([inertia / 2, inertia, inertia]))
                for m, c, inertia in zip(arm.masses, arm.centres, arm.inertias, strict=True)
            ]
            tip, base = Pose(ACROSS, (arm.lengths[-1], 0, 0)), Pose(np.eye(3), (arm.base.real, arm.base.imag, 0))
            arms[f"arm{i}"] = Arm(joints, links, tip=tip, base=base)
            c, s = np.cos(arm.attitude), np.sin(arm.attitude)
            frame = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ ACROSS
            grasps[f"arm{i}"] = Grasp(arm.grasp, Pose(frame, (arm.contact.real, arm.contact.imag, 0)))
        body = HeldObject(self.mass, np.diag([self.inertia / 2, self.inertia, self.inertia]))
        x, y, turn = self.start[-3:]
        pose = [np.cos(turn / 2), 0, 0, np.sin(turn / 2), x, y, 0]
        twist = [0, 0, self.rates[-1], *self.rates[-3:-1], 0]
        chain = ClosedChain(arms, body, grasps, gravity=(0, GRAVITY.imag, 0))
        return chain, State(self.start[:-3], self.rates[:-3], pose, twist)


def random_mechanism(seed: int, others: Sequence[str] = ("rigid", "hinge", "ball")) -> PlanarMechanism:
    """Return two to four arms of one to three joints around an object, with a freedom left and a random velocity.

    Args:
        seed: of the random numbers.
        others: how all arms but the first may hold; what is not rigid is a pivot in the plane.
    """
    random = np.random.default_rng(seed)
    while True:
        counts = random.integers(1, 4, size=random.integers(2, 5))
        kinds = random.choice(others, size=len(counts))
        kinds[0] = random.choice(["rigid", "hinge"])  # balls alone let the object leave its plane
        freedoms = counts.sum() + 3 - sum(3 if kind == "rigid" else 2 for kind in kinds)
        if 1 <= freedoms <= 4:
            break
    place, turn = complex(*random.normal(scale=0.2, size=2)), random.uniform(-3, 3)
    arms, angles = [], []
    for i, (count, kind) in enumerate(zip(counts, kinds, strict=True)):
        contact = 0.3 * np.exp(2j * np.pi * (i + random.uniform(-0.2, 0.2)) / len(counts))
        lengths, q = random.uniform(0.3, 0.7, size=count), random.uniform(-2.5, 2.5, size=count)
        bars = lengths * np.exp(1j * np.cumsum(q))
        base = place + contact * np.exp(1j * turn) - bars.sum()
        centres = lengths * (random.uniform(0.3, 0.6, size=count) + 1j * random.uniform(-0.1, 0.1, size=count))
        masses = random.uniform(0.5, 3.0, size=count)
        inertias = masses * lengths**2 / random.uniform(8, 14, size=count)
        attitude = q.sum() - turn
        arms.append(PlanarArm(lengths, masses, centres, inertias, complex(base), str(kind), complex(contact), attitude))
        angles.append(q)
    start = np.concatenate([*angles, [place.real, place.imag, turn]])
    still = PlanarMechanism(arms, random.uniform(0.5, 5.0), random.uniform(0.02, 0.2), start, np.zeros(len(start)))
    J = still.equations(start, np.zeros(len(start)))[2]
    return PlanarMechanism(arms, still.mass, still.inertia, start, random_rates(random, J))
