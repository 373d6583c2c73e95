"""What can be violated while a chain moves: the margins of its grasps and of its joints' limits.

All margins of an instant are one array of signals, whatever the grasps at the time: the grasps by
arm [N], then by joint the margins of position [rad or m], rate [rad/s or m/s] and effort [N m or N].
Where nothing limits, a margin is infinite; a negative margin is a violation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from holdfast.dynamics.margin_range import margin_range
from holdfast.dynamics.margins import conditions, grasp_margins, joint_limits, joint_margins
from holdfast.dynamics.result import Status
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.simulation.instant import Instant
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate

Quantity = Literal["grasp", "position", "rate", "effort"]
JOINT_QUANTITIES: tuple[Quantity, ...] = ("position", "rate", "effort")
SAME = 1e-9  # of the wrench: margins nearer than this reach zero together


@dataclass(frozen=True, eq=False)
class Signals:
    """The margins of a chain, by place in the array.

    Attributes:
        chain: with the grasps of the time.
    """

    chain: ClosedChain

    def __len__(self) -> int:
        return len(self.chain.arms) + 3 * self.chain.joint_count

    @cached_property
    def names(self) -> list[str]:
        """Arms, then three times the joints as 'arm/joint'."""
        return [*self.chain.names, *3 * self.chain.joint_names()]

    @cached_property
    def quantities(self) -> list[Quantity]:
        """What each margin is of."""
        n = self.chain.joint_count
        grasps: list[Quantity] = ["grasp"] * len(self.chain.arms)
        return grasps + [quantity for quantity in JOINT_QUANTITIES for _ in range(n)]

    @cached_property
    def limited(self) -> Array:
        """Which of them something limits, as indices: what has to be looked at."""
        chain = self.chain
        grasps = [name in chain.grasps and bool(conditions(chain.grasps[name])) for name in chain.names]
        return np.flatnonzero(np.array([*grasps, *joint_limits(chain).limited.flat]))

    def of(self, at: Instant) -> Array:
        """Return all margins at an instant, (arms + 3 n,).

        Where the grasp forces are not unique, one is a violation only if no internal force holds every
        grasp: negative then, in place of what the smallest forces give (`margin_range`, a tenth of a second).
        """
        chain = self.chain
        given = grasp_margins(at.chain, at.state, at.result.grasp_wrench)
        if at.result.status is Status.INDETERMINATE_FORCES and (given < 0).any():
            given = np.where(given < 0, margin_range(at.chain, at.state, at.result).together, given)
        grasps = np.full(len(chain.arms), np.inf)
        grasps[[chain.names.index(name) for name in chain.grasps]] = given
        return np.concatenate([grasps, *joint_margins(at.chain, at.state, at.tau)])

    def words(self, at: Instant, signal: int) -> str:
        """Return what happens where a margin reaches zero, in a few words."""
        name, quantity = self.names[signal], self.quantities[signal]
        if quantity != "grasp":
            return f"joint '{name}' reaches its {quantity} limit"
        grasp = self.chain.grasps[name]
        wrench = unrotate(at.state.object_frame.R @ grasp.frame.R, at.result.grasp_wrench[signal])
        return f"grasp '{name}' {giving_way(grasp, wrench)}"


def giving_way(grasp: Grasp, wrench: Array) -> str:
    """Return how a grasp gives way under a contact-axes wrench (6,) that it cannot hold, in words."""
    must = conditions(grasp)
    margins = [condition.margin(wrench) for condition in must]
    least = min(margins)
    if grasp.contact is not None and margins[1] <= least + SAME * float(np.abs(wrench).max()):
        return "lifts off"  # without a pressing force the others vanish with it
    return must[margins.index(least)].broken
