"""Andrews' squeezing mechanism: seven bodies in a plane, driven by a motor and held back by a spring.

Data and the motion's end from the Test Set for IVP Solvers (Bari), problem "Andrews' squeezing mechanism", tolerances
of 1e-14; also Hairer & Wanner, Solving Ordinary Differential Equations II, VII.7. The second body is the held object:
the motor's crank has it at one end, and the tips of three arms meet at the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, Spring, State
from tests.systems.five_bar import ACROSS

MASSES = (0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498)  # kg
INERTIAS = (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)  # kg m^2, about the mass centres
A, B, C = -0.06934 - 0.00227j, -0.03635 + 0.03273j, 0.014 + 0.072j  # m
STIFFNESS, NATURAL = 4530.0, 0.07785  # N/m, m
CRANK, CRANK_CENTRE = 7e-3, 92e-5
ROD, ROD_CENTRE = 28e-3, 115e-4
TRIANGLE, TRIANGLE_CENTRE, SPRING = 35e-3, 1874e-5 + 1043e-5j, 2e-2 - 18e-3j  # the spring's end in the triangle's axes
FOURTH, FOURTH_CENTRE = 2e-2, 2e-2 - 1421e-5
FIFTH, FIFTH_CENTRE = 4e-2, 2308e-5 + 916e-5j
SIXTH, SIXTH_CENTRE = 2e-2, 2e-2 - 1421e-5
SEVENTH, SEVENTH_CENTRE = 4e-2, 1228e-5 + 449e-5j
TORQUE = 33e-3  # N m
# beta, theta, gamma, phi, delta, omega, epsilon [rad]
START = (
    -0.0617138900142764496358948458001,
    0.0,
    0.455279819163070380255912382449,
    0.222668390165885884674473185609,
    0.487364979543842550225598953530,
    -0.222668390165885884674473185609,
    1.23054744454982119249735015568,
)
END_TIME = 0.03
END = (
    15.81077119629904,
    -15.75637105984298,
    0.04082224013073101,
    -0.5347301163226948,
    0.5244099658805304,
    0.5347301163226948,
    1.048080741042263,
)


def andrews() -> tuple[ClosedChain, State]:
    """Return the mechanism at rest at its start."""
    beta, theta, gamma, phi, delta, omega, epsilon = START
    # attitude of the last link against the axis on which its own length lies
    arms = {
        "crank": _arm(0.0, [(CRANK, CRANK_CENTRE, 0)]),
        "triangle": _arm(B, [(-1j * TRIANGLE, TRIANGLE_CENTRE, 2)]),
        "left": _arm(A, [(FIFTH, FIFTH_CENTRE, 4), (-1j * FOURTH, -1j * FOURTH_CENTRE, 3)]),
        "right": _arm(A, [(-1j * SEVENTH, SEVENTH_CENTRE, 6), (SIXTH, SIXTH_CENTRE, 5)]),
    }
    near, far = ROD_CENTRE, ROD_CENTRE - ROD  # along the rod, which points from its far end to the crank
    at = dict.fromkeys(arms, far) | {"crank": near}
    grasps = {name: Grasp("hinge", Pose(ACROSS, (x, 0, 0))) for name, x in at.items()}
    own = INERTIAS[1]
    ends = ("world", (C.real, C.imag, 0)), ("triangle", 0, (SPRING.real, SPRING.imag, 0))
    held = HeldObject(MASSES[1], np.diag([own / 2, own, own]))
    chain = ClosedChain(arms, held, grasps, (0, 0, 0), springs=[Spring(*ends, STIFFNESS, NATURAL)])
    q = np.array([beta, gamma, delta, phi, epsilon, omega])
    turn = beta + theta
    centre = CRANK * np.exp(1j * beta) - ROD_CENTRE * np.exp(1j * turn)
    pose = [np.cos(turn / 2), 0, 0, np.sin(turn / 2), centre.real, centre.imag, 0]
    return chain, State(q, np.zeros(6), pose, np.zeros(6))


def drive(t: float, state: State, memory: Any) -> tuple[np.ndarray, Any]:
    """Return the motor's torque."""
    return np.array([TORQUE, 0.0, 0.0, 0.0, 0.0, 0.0]), memory


def angles(state: State) -> np.ndarray:
    """Return beta, gamma, phi, delta, omega, epsilon [rad]; theta is the object's."""
    beta, gamma, delta, phi, epsilon, omega = state.q
    return np.array([beta, gamma, phi, delta, omega, epsilon])


def _arm(base: complex, bars: list[tuple[complex, complex, int]]) -> Arm:
    """Return an arm of bars, given by where they end and their mass centres in their own axes, and which body it is."""
    joints, links, before = [], [], 0j
    for end, centre, k in bars:
        joints.append(Joint("revolute", (0, 0, 1), Pose(np.eye(3), (before.real, before.imag, 0))))
        centre, own, before = complex(centre), INERTIAS[k], complex(end)
        links.append(Link(MASSES[k], (centre.real, centre.imag, 0), np.diag([own / 2, own, own])))
    base = complex(base)
    tip = Pose(ACROSS, (before.real, before.imag, 0))
    return Arm(joints, links, tip=tip, base=Pose(np.eye(3), (base.real, base.imag, 0)))
