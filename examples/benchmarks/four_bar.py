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


def four_bar() -> hf.ClosedChain:
    """Return the linkage: A-B and B-C in a row, C-D beside them, and the hinge at C as a loop; no object."""
    joints = [
        hf.Joint("revolute", (0, 0, 1), hf.Pose.translation(1.0, 0, 0) if k else hf.Pose.identity()) for k in range(3)
    ]
    links = [hf.Link(1.0, (0.5, 0, 0), FLAT, name) for name in ("A-B", "B-C", "D-C")]
    end = hf.Pose(HINGE, (1.0, 0, 0))
    hinge = hf.Closure("B-C", "D-C", hf.Grasp("hinge", end), end)
    rods = hf.Arm(joints, links, parents=[None, "A-B", None], loops={"C": hinge})
    return hf.ClosedChain({"rods": rods}, gravity=(0, -9.81, 0))


def acceleration(chain: hf.ClosedChain, angle: float, rate: float, damping: float = 0.0) -> float:
    """Return the cranks' angular acceleration [rad/s^2]; the spring pulls at C, which is on the rod B-C."""
    moving = hf.State([angle, -angle, angle], [rate, -rate, rate])
    diagonal = np.array([1.0 + np.cos(angle), np.sin(angle), 0.0])  # from A to C
    length = float(np.linalg.norm(diagonal))
    stretching = rate * (np.cross([0, 0, 1], diagonal - [1, 0, 0]) @ diagonal) / length
    force = -(25.0 * (length - np.sqrt(2.0)) + damping * stretching) * diagonal / length
    wrenches = np.zeros((3, 6))
    wrenches[1] = [*np.cross([1.0, 0, 0], force), *force]  # about B
    inputs = hf.Inputs(link_wrenches=wrenches)
    return float(hf.forward_dynamics(chain, moving, np.zeros(3), inputs=inputs).qdd[0])


def slope(function: Callable[[float], float], h: float = 1e-3) -> float:
    """Return a function's derivative at 0, by differences of sixth order."""
    return sum(w * (function(k * h) - function(-k * h)) for k, w in ((1, 45), (2, -9), (3, 1))) / (60 * h)


def eigenvalue(chain: hf.ClosedChain, angle: float, damping: float = 0.0) -> complex:
    """Return the eigenvalue of small motions about an angle, the one that turns forwards [1/s]."""
    stiffness = -slope(lambda x: acceleration(chain, angle + x, 0.0, damping))
    resistance = -slope(lambda rate: acceleration(chain, angle, rate, damping))
    return -0.5 * resistance + 1j * float(np.sqrt(stiffness - 0.25 * resistance**2))


def main() -> dict[str, complex]:
    """Print the figures beside the published ones, and return them."""
    linkage = four_bar()
    angle = float(root_scalar(lambda x: acceleration(linkage, x, 0.0), bracket=(2.0, 2.5), xtol=1e-14).root)
    found: dict[str, complex] = {"angle": angle}
    found |= {"spring": eigenvalue(linkage, angle), "damper": eigenvalue(linkage, angle, damping=1.0)}
    for name, published in (("angle", ANGLE), ("spring", SPRING), ("damper", DAMPER)):
        print(f"{name:8} {found[name]:.12f}   published {published:.12f}   off by {abs(found[name] - published):.0e}")
    return found


if __name__ == "__main__":
    main()
