"""What the rows of wrenches and margins of a run belong to: arms, or grasps by frames and loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp


class GraspRow(NamedTuple):
    """A row of grasp wrenches and margins.

    Attributes:
        name: the name of an arm or a loop, or "arm/frame" for a grasp by a frame.
        key: its key in `chain.grasps`, or the name of the loop.
        grasp: the grasp or the loop's, with the contact frame in the axes of `body`; None if the chain has none.
        arm: the arm that holds, or in which the loop is; None for a loop of the chain.
        body: the body of the chain's forest that carries the contact frame; -1 without a grasp.
    """

    name: str
    key: Any
    grasp: Grasp | None
    arm: str | None
    body: int = -1


def row_name(key: Any) -> str:
    """Return the name of the grasp or loop with a key."""
    return key if isinstance(key, str) else "/".join(key)


def grasp_rows(chain: ClosedChain, further: Sequence[str] = ()) -> list[GraspRow]:
    """Return the rows of a run: one for each arm of a chain of serial arms, else one for each grasp and each loop.

    Args:
        chain: the chain at the start of the run.
        further: names of grasps that close later, which have rows behind the others.
    """
    found = chain.as_forest
    if not chain.beyond_serial:
        held = found.held_object
        return [GraspRow(n, n, grasp := chain.grasps.get(n), n, -1 if grasp is None else held) for n in chain.names]
    rows = []
    for key, i in found.closures.items():
        name, closure = row_name(key), found.forest.closures[i]
        arm = name.partition("/")[0] if name not in chain.loops else None
        rows.append(GraspRow(name, key, closure.grasp, arm, closure.b))
    later = [name for name in further if name not in [row.name for row in rows]]
    return rows + [GraspRow(name, _key(chain, name), None, name.partition("/")[0]) for name in later]


def _key(chain: ClosedChain, name: str) -> Any:
    """Return the key of a grasp in `chain.grasps` from its name."""
    return name if name in chain.arms else tuple(name.split("/", 1))
