"""What a configuration can and cannot do: mobility, rank, lost directions, indeterminate forces."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Literal

import numpy as np

from holdfast.dynamics import rank as rank_of
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.indeterminate import free_wrenches, pattern
from holdfast.dynamics.lost_direction import LostDirection, lost_directions
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import State


@dataclass(frozen=True, eq=False)
class IndeterminateForce(Frozen):
    """A pattern of grasp wrenches that no joint and no object motion feels.

    Attributes:
        words: the pattern in words.
        wrenches: (arms, 6) about the contacts, world axes; largest entry 1 (N, or N m per
            metre of the force split's length).
    """

    words: str
    wrenches: Array


@dataclass(frozen=True, eq=False)
class Diagnosis(Frozen):
    """What a configuration allows.

    Attributes:
        mobility: dimension of the velocities (qd, V(C), W) that the grasps allow.
        rank: independent rows of the grasp constraint here.
        generic_rank: the same at closed neighbours.
        rows: all its rows, six a grasp.
        condition: how near the chain is to a singular configuration, as in `ForwardResult`; infinite at one.
        status: "regular", "indeterminate" (rank constantly low: the forces are not unique) or
            "singular" (rank lower than nearby).
        lost_directions: where single arms cannot move their tips.
        indeterminate_forces: a basis of the forces that dynamics leaves open.
    """

    mobility: int
    rank: int
    generic_rank: int
    rows: int
    condition: float
    status: Literal["regular", "indeterminate", "singular"]
    lost_directions: tuple[LostDirection, ...]
    indeterminate_forces: tuple[IndeterminateForce, ...]

    def __repr__(self) -> str:
        """Return the report."""
        return f"<Diagnosis: {self.report()}>"

    def _repr_html_(self) -> str:
        """Return the report for notebooks."""
        return f"<pre>{escape(self.report())}</pre>"

    def report(self) -> str:
        """Return the diagnosis in words, several lines."""
        lines = [
            f"{self.status}: rank {self.rank} of {self.rows} (nearby {self.generic_rank}), mobility {self.mobility},"
            f" condition {self.condition:.3g}"
        ]
        if self.status == "singular":
            lines.append("  forces and accelerations here are those of no trajectory: forward dynamics refuses")
        elif self.status == "indeterminate":
            lines.append("  accelerations are unique; of the grasp forces the smallest are returned")
        lines += [f"  lost: {lost.words}" for lost in self.lost_directions]
        lines += [f"  indeterminate: {force.words}" for force in self.indeterminate_forces]
        return "\n".join(lines)


def diagnose(chain: ClosedChain, state: State) -> Diagnosis:
    """Return rank, mobility, lost directions and indeterminate forces of a configuration.

    Velocities do not enter. One arm at a singularity does not make the chain singular;
    the structural wrenches of several arms must be dependent for that. O(n^3).

    Args:
        chain: the chain.
        state: its configuration; it need not be closed exactly.

    Returns:
        A `Diagnosis`: numbers, lost directions and indeterminate forces, and a text of them (`str`).

    Raises:
        StateError: a state of the wrong shape for the chain.

    Reference:
        `docs/theory/singular.md`; the constraint's rank is that of the filter's pivots.
    """
    state.fits(chain)
    still = state.at_rest()
    motion = chain_at_rest(chain, still)
    rank, condition = rank_of.constraint_pivots(chain, still)
    rows = chain.constraint_row_count
    found = rank_of.regularity(chain, still, rank)
    lost = [
        direction
        for name, c, arm in zip(chain.grasps, motion.contacts, motion.holding, strict=True)
        for direction in lost_directions(name, c, jacobian(arm.arm, arm.at), arm.at.tip.p)
    ]
    return Diagnosis(
        mobility=chain.velocity_count + chain.contact_freedom_count - rank,
        rank=rank,
        generic_rank=found.generic_rank,
        rows=rows,
        condition=np.inf if found.kind == "singular" else condition,
        status=found.kind,
        lost_directions=tuple(lost),
        indeterminate_forces=tuple(_indeterminate(motion)) if rank < rows else (),
    )


def _indeterminate(motion: ChainMotion) -> list[IndeterminateForce]:
    """Return the null wrenches, sparsest first, in words."""
    chain = motion.chain
    length = length_scale([c.offset for c in motion.contacts])
    result = []
    for column in free_wrenches(motion, length).T:
        per_grasp = column.reshape(-1, 6)
        metric = np.r_[np.full(3, 1 / length), np.ones(3)]
        per_grasp = per_grasp / np.abs(per_grasp * metric).max()
        wrenches = np.zeros((len(chain.arms), 6))
        for name, f in zip(chain.grasps, per_grasp, strict=True):
            wrenches[chain.names.index(name)] = f
        words = f"{pattern(motion, per_grasp, length)} is felt by no joint"
        result.append(IndeterminateForce(words, wrenches))
    return result
