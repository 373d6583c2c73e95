"""Bricard's mechanism: a ring of five rods and the ground on six hinges, which moves although counting says it cannot.

Six hinges take away thirty of the thirty freedoms of five rods; but one of these rows follows from the others, in every
posture, and so one freedom is left. The rods lie on edges of a cube of 1 m, weigh 1 kg each and are 0.1 m square.

Published: IFToMM benchmark A04; the figure that Exudyn prints after 1 s (jgerstmayr/EXUDYN, bricardMechanism.py): the
norm of 35 coordinates, the rods' displacements and changes of Euler parameters, plus the numbers of freedoms and of
redundant rows.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

import holdfast as hf

PUBLISHED = 4.172189649307425  # 1,000 steps of an implicit scheme of order 2
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]], dtype=float)  # hinges [m]
X, Y, Z = np.eye(3)
AXES = [Y, Z, X, Y, Z, X]  # of the hinges
WIDTH = 0.1  # of a rod [m]


def rod(i: int, j: int) -> hf.Link:
    """Return the rod between two hinges, its origin at the first of them; world axes at the start."""
    along = np.abs(POINTS[j] - POINTS[i])  # a unit vector
    across = np.diag(1.0 - along)
    return hf.Link(1.0, (POINTS[j] - POINTS[i]) / 2, (across * (1 + WIDTH**2) + np.diag(along) * 2 * WIDTH**2) / 12)


def hinge(i: int, origin: np.ndarray) -> hf.Pose:
    """Return the frame of a hinge, its x axis along it, from a body's origin; world axes at the start."""
    x, y = AXES[i], np.roll(AXES[i], 1)
    return hf.Pose(np.column_stack([x, y, np.cross(x, y)]), POINTS[i] - origin)


def from_ground(*points: int) -> hf.Arm:
    """Return the arm of rods through some hinges, the first on the ground."""
    before = [np.zeros(3), *POINTS[list(points)]]
    joints = [
        hf.Joint("revolute", AXES[i], hf.Pose.translation(*(POINTS[i] - origin)))
        for i, origin in zip(points[:-1], before, strict=False)
    ]
    return hf.Arm(joints, [rod(i, j) for i, j in pairwise(points)], tip=hinge(points[-1], POINTS[points[-2]]))


def bricard() -> tuple[hf.ClosedChain, hf.State]:
    """Return the mechanism at rest: two rods from either side of the ground, and the object between them."""
    middle, centre = rod(2, 3), (POINTS[2] + POINTS[3]) / 2
    grasps = {"left": hf.Grasp("hinge", hinge(2, centre)), "right": hf.Grasp("hinge", hinge(3, centre))}
    arms = {"left": from_ground(0, 1, 2), "right": from_ground(5, 4, 3)}
    chain = hf.ClosedChain(arms, hf.HeldObject(middle.mass, middle.inertia), grasps, gravity=(0, -9.81, 0))
    return chain, hf.State(np.zeros(4), np.zeros(4), hf.Pose.translation(*centre))


def free(t: float, state: hf.State, memory: Any) -> tuple[np.ndarray, Any]:
    """Return no torques."""
    return 0.0 * state.qd, memory


def rods(chain: hf.ClosedChain, state: hf.State) -> list[tuple[hf.Pose, np.ndarray]]:
    """Return the five rods' poses, and where in their axes the benchmark has their origins [m]."""
    poses = {name: hf.dynamics.link_poses(chain.arms[name], state.q[chain.joints[name]]) for name in chain.names}
    left, right = ([(pose, np.zeros(3)) for pose in poses["left"]], poses["right"][::-1])
    first = zip(right, (POINTS[3] - POINTS[4], POINTS[4] - POINTS[5]), strict=True)
    return [*left, (state.object_frame, (POINTS[2] - POINTS[3]) / 2), *first]


def main(duration: float = 1.0) -> dict[str, float]:
    """Print the figures beside the published one, and return them."""
    chain, state = bricard()
    diagnosis = hf.diagnose(chain, state)
    run = hf.simulate(chain, state, free, duration, 2e-2, scheme="dop853", rtol=1e-12)
    moved = []
    for (pose, origin), at in zip(rods(chain, run.state(-1)), POINTS, strict=False):
        moved += [pose.p + pose.R @ origin - at, pose.wxyz_xyz[:4] - np.array([1, 0, 0, 0])]
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
