"""Where the ends of springs between bodies are at a moment of a playback."""

from __future__ import annotations

from dataclasses import replace

from holdfast.dynamics.closed.force_elements import end_motions
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State
from holdfast.view.playback import Playback


def spring_ends(playback: Playback, k: int) -> list[tuple[Array, Array]]:
    """Return both ends (3,) of every spring of the chain at moment k, world axes [m]."""
    chain = playback.chain
    if not chain.springs:
        return []
    bases = dict(zip(chain.names, playback.base_pose[k], strict=True))
    moved = chain.with_bases({name: pose for name, pose in bases.items() if name not in chain.mounts})
    below = playback.trunk_pose[k]
    if moved.trunk is not None and not chain.floats:
        moved = replace(moved, trunk=replace(moved.trunk, base=below))
    state = State(
        playback.q[k], 0.0 * playback.q[k], playback.object_pose[k], base_pose=below if chain.floats else None
    )
    return [(a.position, b.position) for a, b in end_motions(moved, state, Inputs().shaped(moved))]
