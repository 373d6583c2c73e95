"""Diagnosis of a configuration: mobility, rank, singular directions and indeterminate forces."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Literal

import numpy as np

from holdfast.dynamics import rank as rank_of
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.constraint import free_wrenches, length_scale, pattern
from holdfast.dynamics.near_singular import LostDirection, lost_directions
from holdfast.dynamics.tree.forest_diagnosis import diagnosed
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.serial_chain import answered_as_forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit


@dataclass(frozen=True, eq=False)
class IndeterminateForce(Frozen):
    """A set of grasp wrenches that loads no joint and does not accelerate the object.

    Attributes:
        words: a description of the pattern.
        wrenches: (arms, 6) [moment; force] about the contact points, world axes. The largest entry is 1 N, or
            1 N m per metre of the length L that the force decomposition uses.
    """

    words: str
    wrenches: Array


@called
@dataclass(frozen=True, eq=False)
class Diagnosis(Frozen):
    """Mobility, rank and singular directions of a configuration.

    Attributes:
        mobility: dimension of the space of velocities (qd, V(C), W) that the grasps allow.
        rank: number of independent rows of the grasp constraint in this configuration.
        generic_rank: the rank at neighbouring closed configurations.
        rows: number of all its rows, six per grasp.
        condition: condition number of the constraint as in `ForwardResult`; infinite at a singular configuration.
        status: "regular", "indeterminate" (the rank is low here and nearby, so the forces are not unique) or
            "singular" (the rank is lower than nearby).
        lost_directions: directions in which single arms cannot move their tips; an anchor, without joints, has none.
        anchors: what each anchor holds by design, in words.
        indeterminate_forces: a basis of the grasp wrenches that the dynamics does not determine.
    """

    mobility: int
    rank: int
    generic_rank: int
    rows: int
    condition: float
    status: Literal["regular", "indeterminate", "singular"]
    lost_directions: tuple[LostDirection, ...]
    anchors: tuple[str, ...]
    indeterminate_forces: tuple[IndeterminateForce, ...]

    def __repr__(self) -> str:
        """Return the report."""
        return f"<Diagnosis: {self.report()}>"

    def _repr_html_(self) -> str:
        """Return the report for notebooks."""
        return f"<pre>{escape(self.report())}</pre>"

    def report(self) -> str:
        """Return the diagnosis as text of several lines."""
        lines = [
            f"{self.status}: rank {self.rank} of {self.rows} (nearby {self.generic_rank}), mobility {self.mobility},"
            f" condition {self.condition:.3g}"
        ]
        if self.status == "singular":
            lines.append("  forces and accelerations here are those of no trajectory: forward dynamics refuses")
        elif self.status == "indeterminate":
            lines.append("  accelerations are unique; of the grasp forces the smallest are returned")
        lines += [f"  held: {held}" for held in self.anchors]
        lines += [f"  lost: {lost.words}" for lost in self.lost_directions]
        lines += [f"  indeterminate: {force.words}" for force in self.indeterminate_forces]
        return "\n".join(lines)


@np.errstate(all="ignore")  # what overflows is refused
def diagnose(chain: ClosedChain, state: State) -> Diagnosis:
    """Return rank, mobility, singular directions and indeterminate forces of a configuration.

    Velocities do not enter. A singular configuration of one arm does not make the chain singular; for that, the
    wrenches that several arms bear without joint torque must be linearly dependent. O(n^3).

    Args:
        chain: the chain.
        state: its configuration, which need not satisfy the grasps exactly.

    Returns:
        A `Diagnosis`; `str` of it is a report. For a chain with branches, loops, couplings or several objects a
        `ForestDiagnosis`, part by part, for which the state must satisfy grasps, loops and couplings.

    Raises:
        StateError: a state of the wrong shape for the chain.

    Reference:
        `docs/theory/singular.md`; the rank is the number of pivots that the object filter keeps.
    """
    if answered_as_forest(chain):
        given = mechanism_arguments(chain, state)
        return diagnosed(given._replace(qd=0.0 * given.qd))  # pyright: ignore[reportReturnType]
    require_fit(chain, state)
    still = state.at_rest()
    motion = chain_at_rest(chain, still)
    rank, condition = rank_of.constraint_pivots(chain, still)
    rows = chain.constraint_row_count
    found = rank_of.regularity(chain, still, rank)
    lost = [
        direction
        for name, c, arm in zip(chain.grasps, motion.contacts, motion.holding, strict=True)
        if arm.arm.joint_count
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
        anchors=tuple(_held(name, grasp) for name, grasp in chain.grasps.items() if not chain.arms[name].joint_count),
        indeterminate_forces=tuple(_indeterminate(motion)) if rank < rows else (),
    )


def _held(name: str, grasp: Grasp) -> str:
    """Return what an anchor's grasp holds, in words."""
    held = len(grasp.transmitted)
    if not held:
        return f"anchor '{name}' ({grasp.kind}) leaves the object free to move, against its springs"
    return (
        f"anchor '{name}' ({grasp.kind}) does not yield along the {held} directions of its grasp;"
        " loads along them go into its base"
    )


def _indeterminate(motion: ChainMotion) -> list[IndeterminateForce]:
    """Return a basis of the indeterminate grasp wrenches with descriptions."""
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
        words = f"{pattern(motion, per_grasp, length)} causes no joint torque"
        result.append(IndeterminateForce(words, wrenches))
    return result
