"""The rows of a chain's diagram: each branch of an arm, from where it begins to its last joint or its grasp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from holdfast.model.closed_chain import ClosedChain


class Branch(NamedTuple):
    """A row of the diagram.

    Attributes:
        joints: indices of its joints in the arm.
        column: number of joints before them, on the way from the base.
        origin: the row of the arm in which it begins; None for the first, which begins at the base.
        key: key of the grasp at its end; None without one.
    """

    joints: Sequence[int]
    column: int
    origin: int | None
    key: Any

    @property
    def end(self) -> int:
        """Number of joints up to its end, on the way from the base."""
        return self.column + len(self.joints)


def branches_of(chain: ClosedChain, name: str) -> list[Branch]:
    """Return the rows of an arm, of which a serial one has a single one.

    What stands on a link goes on in its row, first of all a joint; everything else there begins a row of its own.
    """
    arm = chain.arms[name]
    on: dict[int | None, list[Any]] = {None: [], **{k: [] for k in range(len(arm.joints))}}
    for k, parent in enumerate(arm.parent_of):
        on[parent].append(k)
    for key in chain.grasps:
        if key == name:
            on[len(arm.joints) - 1 if arm.joints else None].append(key)
        elif not isinstance(key, str) and key[0] == name:
            on[arm.frame(key[1], name)[0]].append(key)
    rows: list[Branch] = []
    waiting: list[tuple[Any, int, int | None]] = [(one, 0, None if k == 0 else 0) for k, one in enumerate(on[None])]
    while waiting:
        node, column, origin = waiting.pop(0)
        joints: list[int] = []
        while isinstance(node, int):
            joints.append(node)
            node, *others = on[node] or [None]
            waiting += [(one, column + len(joints), len(rows)) for one in others]
        rows.append(Branch(joints, column, origin, node))
    return rows or [Branch((), 0, None, None)]
