"""Kinds of chains in rollouts: what differs between serial arms that hold one object and all other chains."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.mechanism_replay import mechanism_chain, mechanism_samples
from holdfast.simulation.rollout.record import serial_chain_of, serial_samples
from holdfast.simulation.rollout.starting import mechanism_rank, serial_rank
from holdfast.simulation.rollout.step_code import SERIAL_STEP, StepCode
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.varied_mechanism import MECHANISM_STEP
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.simulation.rollout.rollout import Rollout

Rows = Sequence[Mapping[str, Array]]  # arrays of one system with a leading axis of one, among them its time `t`


class ChainKind(NamedTuple):
    """A kind of chain in rollouts.

    Attributes:
        code: how a step becomes machine code, and which arguments systems have.
        implicit: whether systems with stiff joints take linearly implicit steps.
        rank: returns the rank of the constraint of systems that start; None if it cannot be found.
        chain: returns the chain of one system with its parameters, of the rollout, the systems and the parameters.
        samples: returns parts of the run of one system, of its environment, the rollout, its arrays at the end, those
            at the samples and those just before the torques jump.
    """

    code: StepCode
    implicit: bool
    rank: Callable[[Rollout, RolloutSystems], int | None]
    chain: Callable[[Any, RolloutSystems, Mapping[str, Array]], ClosedChain]
    samples: Callable[[Environment, Any, RolloutSystems, Rows, Rows], list[Trajectory]]


SERIAL_ARMS = ChainKind(SERIAL_STEP, True, serial_rank, serial_chain_of, serial_samples)
BRANCHED = ChainKind(MECHANISM_STEP, False, mechanism_rank, mechanism_chain, mechanism_samples)


def kind_of(chain: ClosedChain) -> ChainKind:
    """Return the kind of a chain."""
    return BRANCHED if answered_as_forest(chain) else SERIAL_ARMS
