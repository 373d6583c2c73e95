"""Bricard's mechanism: a ring of five rods and the ground on six hinges, which moves although counting says it cannot.

Six hinges take away thirty of the thirty freedoms of five rods; but one of these rows follows from the others, in every
configuration, and so one freedom is left. The rods lie on edges of a cube of 1 m, weigh 1 kg each and are 0.1 m square.

Published: IFToMM benchmark A04; the figure that Exudyn prints after 1 s (jgerstmayr/EXUDYN, bricardMechanism.py): the
norm of 35 coordinates, the rods' displacements and changes of Euler parameters, plus the numbers of freedoms and of
redundant rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import holdfast as hf

PUBLISHED = 4.172189649307425  # 1,000 steps of an implicit scheme of order 2
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]], dtype=float)  # hinges [m]
X, Y, Z = np.eye(3)
AXES = [Y, Z, X, Y, Z, X]  # of the hinges
WIDTH = 0.1  # of a rod [m]


def rod(i: int) -> hf.Link:
    """Return the rod from one hinge to the next, its origin at the first of them; world axes at the start."""
    way = POINTS[i + 1] - POINTS[i]  # along an axis, 1 m
    along, across = np.diag(np.abs(way)), np.diag(1.0 - np.abs(way))
    return hf.Link(1.0, way / 2, (across * (1 + WIDTH**2) + along * 2 * WIDTH**2) / 12)


def hinge(i: int, origin: np.ndarray) -> hf.Pose:
    """Return the frame of a hinge, its x axis along it, from a body's origin; world axes at the start."""
    x, y = AXES[i], np.roll(AXES[i], 1)
    return hf.Pose(np.column_stack([x, y, np.cross(x, y)]), POINTS[i] - origin)


def bricard() -> tuple[hf.ClosedChain, hf.State]:
    """Return the mechanism at rest: four rods in a row from the ground, the fifth, the object, hinged to it again."""
    first = np.vstack([np.zeros(3), POINTS])  # what each hinge is measured from
    joints = [hf.Joint("revolute", AXES[i], hf.Pose.translation(*(POINTS[i] - first[i]))) for i in range(4)]
    arms = {
        "rods": hf.Arm(joints, [rod(i) for i in range(4)], tip=hinge(4, POINTS[3])),
        "ground": hf.Anchor(hinge(5, np.zeros(3))),
    }
    last = rod(4)
    grasps = {"rods": hf.Grasp("hinge", hinge(4, POINTS[4])), "ground": hf.Grasp("hinge", hinge(5, POINTS[4]))}
    held = hf.HeldObject(last.mass, last.inertia, last.com)
    chain = hf.ClosedChain(arms, held, grasps, gravity=(0, -9.81, 0))
    return chain, hf.State(np.zeros(4), np.zeros(4), hf.Pose.translation(*POINTS[4]))


def free(t: float, state: hf.State, memory: Any) -> tuple[np.ndarray, Any]:
    """Return no torques."""
    return 0.0 * state.qd, memory


def main(duration: float = 1.0) -> dict[str, float]:
    """Print the figures beside the published one, and return them."""
    chain, state = bricard()
    diagnosis = hf.diagnose(chain, state)
    run = hf.simulate(chain, state, free, duration, 2e-2, scheme="dop853", rtol=1e-12)
    moved, end = [], run.state(-1)
    rods = [*hf.dynamics.link_poses(chain.arms["rods"], end.q), end.object_frame]
    for pose, begun in zip(rods, POINTS[:5], strict=True):
        moved += [pose.p - begun, pose.wxyz_xyz[:4] - np.array([1, 0, 0, 0])]
    redundant = chain.constraint_row_count - diagnosis.rank
    total = float(np.linalg.norm(np.concatenate(moved))) + diagnosis.mobility + redundant
    energy = run.kinetic + run.potential
    found = {
        "mobility": diagnosis.mobility,
        "redundant": redundant,
        "sum": total,
        "energy_error": float(np.ptp(energy)),
        "kinetic": float(run.kinetic.max()),
        "gap": float(run.position_gap[:, 1].max()),
    }
    print(f"freedoms {diagnosis.mobility}, redundant rows {redundant}")
    print(f"sum {total:.12f}   published {PUBLISHED:.12f}   off by {total - PUBLISHED:.0e}")
    print(
        f"energy within {found['energy_error']:.0e} J of {found['kinetic']:.1f} J, hinges within {found['gap']:.0e} m"
    )
    return found


if __name__ == "__main__":
    main()
