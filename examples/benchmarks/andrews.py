"""Andrews' squeezing mechanism: seven bodies of grams in a plane, a motor, a spring, three closed loops.

The motor at O turns K1 at up to a thousand radians a second. K2 hangs between its end and E, where three others meet:
the triangle K3, which turns about B and is pulled to C by the spring, and the pairs K5, K4 and K7, K6, which turn about
A.

Published: Test Set for IVP Solvers (Bari), problem "Andrews' squeezing mechanism"; E. Hairer, G. Wanner, Solving
Ordinary Differential Equations II, VII.7. The end is PSIDE's with tolerances of 1e-14.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import holdfast as hf

HINGE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # a frame whose x axis is the world's z
# K1 .. K7: mass [kg], inertia about the mass centre [kg m^2]
BODIES = [
    hf.Link(mass, inertia=np.eye(3) * inertia)
    for mass, inertia in (
        (0.04325, 2.194e-6), (0.00365, 4.410e-7), (0.02373, 5.255e-6), (0.00706, 5.667e-7),
        (0.07050, 1.169e-5), (0.00706, 5.667e-7), (0.05498, 1.912e-5),
    )
]  # fmt: skip
A, B, C = (-0.06934, -0.00227), (-0.03635, 0.03273), (0.014, 0.072)  # pivots, and the spring's end on the ground [m]
STIFFNESS, LENGTH = 4530.0, 0.07785  # of the spring [N/m, m]
MOTOR = 33e-3  # N m
END_TIME = 0.03  # s
NAMES = ("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon")
START = (
    -0.0617138900142764496, 0.0, 0.455279819163070380, 0.222668390165885885,
    0.487364979543842550, -0.222668390165885885, 1.23054744454982119,
)  # fmt: skip
END = (
    15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948,
    0.5244099658805304, 0.5347301163226948, 1.048080741042263,
)  # fmt: skip


def body(number: int, x: float, y: float) -> hf.Link:
    """Return one of K1 .. K7, its mass centre where it is in the body's own axes [m]."""
    plain = BODIES[number - 1]
    return hf.Link(plain.mass, (x, y, 0), plain.inertia, name=f"K{number}")


def turning(x: float = 0.0, y: float = 0.0) -> hf.Joint:
    """Return a joint in the plane, at a point of the body before."""
    return hf.Joint("revolute", (0, 0, 1), hf.Pose.translation(x, y, 0))


def ending(x: float, y: float) -> hf.Pose:
    """Return a tip that a hinge holds."""
    return hf.Pose(HINGE, (x, y, 0))


def andrews() -> tuple[hf.ClosedChain, hf.State]:
    """Return the mechanism at rest at its start; the triangle is the object, its origin C at the pivot B."""
    at_A = hf.Pose.translation(*A, 0)
    arms = {
        "motor": hf.Arm([turning(), turning(7e-3, 0)], [body(1, 92e-5, 0), body(2, -115e-4, 0)], ending(-28e-3, 0)),
        "lower": hf.Arm(
            [turning(), turning(4e-2, 0)], [body(5, 2308e-5, 916e-5), body(4, 0, 1421e-5 - 2e-2)],
            tip=ending(0, -2e-2), base=at_A,
        ),
        "upper": hf.Arm(
            [turning(), turning(0, -4e-2)], [body(7, 1228e-5, 449e-5), body(6, 2e-2 - 1421e-5, 0)],
            tip=ending(2e-2, 0), base=at_A,
        ),
        "B": hf.Anchor(ending(*B)),
    }  # fmt: skip
    at_E = hf.Grasp("hinge", ending(0, -35e-3))
    grasps = {"motor": at_E, "lower": at_E, "upper": at_E, "B": hf.Grasp("hinge", ending(0, 0))}
    spring = hf.Spring(("world", (*C, 0)), ("object", (2e-2, -18e-3, 0)), STIFFNESS, LENGTH)
    triangle = body(3, 1874e-5, 1043e-5)
    held = hf.HeldObject(triangle.mass, triangle.inertia, triangle.com)
    chain = hf.ClosedChain(arms, held, grasps, gravity=(0, 0, 0), springs=[spring])
    beta, theta, gamma, phi, delta, omega, epsilon = START
    pose = hf.Pose.from_rpy(0, 0, gamma, [*B, 0])
    return chain, hf.State([beta, theta, delta, phi, epsilon, omega], np.zeros(6), pose)


def motor(t: float, state: hf.State, memory: Any) -> tuple[list[float], Any]:
    """Return the motor's torque; no other joint is driven."""
    return [MOTOR, 0, 0, 0, 0, 0], memory


def main() -> dict[str, float]:
    """Print the angles at the end beside the published ones, and return them."""
    chain, state = andrews()
    run = hf.simulate(chain, state, motor, END_TIME, 1e-3, scheme="dop853", rtol=1e-12)
    beta, theta, delta, phi, epsilon, omega = run.q[-1]
    w, z = run.object_pose[-1, [0, 3]]
    found = dict[str, float](zip(NAMES, (beta, theta, 2 * np.arctan2(z, w), phi, delta, omega, epsilon), strict=True))
    for name, published in zip(NAMES, END, strict=True):
        print(f"{name:8}{found[name]:18.12f}   published {published:18.12f}   off by {found[name] - published:8.0e}")
    print(f"largest energy error {np.abs(run.imbalance).max():.0e} J of {run.kinetic.max():.0e} J")
    return found


if __name__ == "__main__":
    main()
