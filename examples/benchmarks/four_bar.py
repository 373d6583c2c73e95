"""IFToMM's four-bar linkage with a diagonal spring: where it balances, and how fast it swings there.

Three rods of 1 m and 1 kg stand on the ground at A and D, 1 m apart: A-B, B-C, C-D. A spring of 25 N/m from A to C
holds them up; a damper of 1 N s/m beside it in the second variant.

Published: IFToMM library of multibody benchmarks (F. Gonzalez; solutions of B. Minaker), angle and eigenvalues as kept
in BPMinaker/eom_pkg. The spring's natural length, an image there, is taken as the diagonal of the square.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import root_scalar

import holdfast as hf

ANGLE = 2.23433101898  # of A-B from A-D [rad]
SPRING = 2.14767663834226j
DAMPER = -0.242385809304825 + 2.133955028187978j
HINGE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # a frame whose x axis is the world's z
FLAT = np.eye(3) / 12  # of a rod; in the plane it is felt about z alone [kg m^2]


def four_bar(damping: float = 0.0) -> hf.ClosedChain:
    """Return the linkage: two cranks, and the rod between them as the object that they hold by hinges."""
    crank = hf.Arm(
        [hf.Joint("revolute", (0, 0, 1))], [hf.Link(1.0, (0.5, 0, 0), FLAT)], tip=hf.Pose(HINGE, (1.0, 0, 0))
    )
    rod = hf.HeldObject(1.0, FLAT)
    grasps = {name: hf.Grasp("hinge", hf.Pose(HINGE, (x, 0, 0))) for name, x in (("A-B", -0.5), ("D-C", 0.5))}
    arms = {"A-B": crank, "D-C": crank.at(hf.Pose.translation(1.0, 0, 0))}
    spring = hf.Spring(("world", (0, 0, 0)), ("object", (0.5, 0, 0)), 25.0, np.sqrt(2.0), damping)
    return hf.ClosedChain(arms, rod, grasps, gravity=(0, -9.81, 0), springs=[spring])


def acceleration(chain: hf.ClosedChain, angle: float, rate: float) -> float:
    """Return the cranks' angular acceleration [rad/s^2]."""
    c, s = np.cos(angle), np.sin(angle)
    moving = hf.State([angle] * 2, [rate] * 2, [1, 0, 0, 0, 0.5 + c, s, 0], [0, 0, 0, -s * rate, c * rate, 0])
    return float(hf.forward_dynamics(chain, moving, np.zeros(2)).qdd[0])


def slope(function: Callable[[float], float], h: float = 1e-3) -> float:
    """Return a function's derivative at 0, by differences of sixth order."""
    return sum(w * (function(k * h) - function(-k * h)) for k, w in ((1, 45), (2, -9), (3, 1))) / (60 * h)


def eigenvalue(chain: hf.ClosedChain, angle: float) -> complex:
    """Return the eigenvalue of small motions about an angle, the one that turns forwards [1/s]."""
    stiffness = -slope(lambda x: acceleration(chain, angle + x, 0.0))
    resistance = -slope(lambda rate: acceleration(chain, angle, rate))
    return -0.5 * resistance + 1j * float(np.sqrt(stiffness - 0.25 * resistance**2))


def main() -> dict[str, complex]:
    """Print the figures beside the published ones, and return them."""
    still = four_bar()
    angle = float(root_scalar(lambda x: acceleration(still, x, 0.0), bracket=(2.0, 2.5), xtol=1e-14).root)
    found: dict[str, complex] = {"angle": angle}
    found |= {"spring": eigenvalue(still, angle), "damper": eigenvalue(four_bar(damping=1.0), angle)}
    for name, published in (("angle", ANGLE), ("spring", SPRING), ("damper", DAMPER)):
        print(f"{name:8} {found[name]:.12f}   published {published:.12f}   off by {abs(found[name] - published):.0e}")
    return found


if __name__ == "__main__":
    main()
