"""First poses of the free bodies, from the closures that hold them and the model's frames."""

from __future__ import annotations

import numpy as np

from holdfast.calibration.geometry import Poses, adjusted, displacement
from holdfast.calibration.layout import FrameLayout
from holdfast.spatial.scalar import Array


def placed(layout: FrameLayout, x: Array, q: Array, active: Array) -> dict[int, Poses]:
    """Return poses of the free bodies with which one closure each is exactly closed, as if it were rigid. O(postures).

    Args:
        layout: the layout.
        x: (p,) corrections of the unknowns.
        q: (postures, n_q) joint positions.
        active: (postures, meetings) whether each closure holds.
    """
    count, frames = len(q), adjusted(layout, x)
    free = {
        k: Poses(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
        for k, body in enumerate(layout.bodies)
        if body.joint is None
    }
    root: list[int | None] = []  # the free body on which each stands
    on_root: list[Poses] = []  # and its pose on it, or in the world

    def through(start: Poses, chain: tuple[int, ...]) -> Poses:
        for k in chain:
            start = start.then(frames[k][0].R, frames[k][0].p)
        return start

    still = Poses(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    for k, body in enumerate(layout.bodies):
        if body.joint is None:
            root.append(k)
            on_root.append(still)
        else:
            root.append(None if body.parent is None else root[body.parent])
            start = through(still if body.parent is None else on_root[body.parent], body.frames)
            on_root.append(start.then(*displacement(body.joint, q[:, body.position :])))
    known = {k: np.zeros(count, bool) for k in free}
    for _ in free:
        for m, meeting in enumerate(layout.meetings):
            ends = []
            for body, chain in (meeting.a, meeting.b):
                ends.append(
                    (None if body is None else root[body], through(still if body is None else on_root[body], chain))
                )
            if meeting.target is not None:
                ends[1] = ends[1][0], ends[1][1].then(*meeting.target)
            for (base, here), (other, there) in (ends, ends[::-1]):
                if base is None or base == other:
                    continue
                settled = np.ones(count, bool) if other is None else known[other]
                chosen = active[:, m] & settled & ~known[base]
                target = there if other is None else free[other].then(there.R, there.p)
                pose = target.then(*here.inverse())
                free[base].R[chosen], free[base].p[chosen] = pose.R[chosen], pose.p[chosen]
                known[base] |= chosen
    return free
