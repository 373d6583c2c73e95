"""What a law commands, and the torques that do it: the one place where a command becomes torques."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from holdfast.control.balanced_torques import bearing_wrenches
from holdfast.control.computed_torque import following_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.errors import ModelError
from holdfast.forces.elastic_distribution import DISTRIBUTE, ElasticDistribution, distribution, distribution_parameters
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import value_of
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import State

PER_GRASP = ("least_margin", "least_normal", "most_normal")


class Command(NamedTuple):
    """What a law wishes for at one instant.

    Attributes:
        acceleration: (6,) true acceleration [omega_dot; v_dot] of C, world axes.
        wrenches: (arms, 6) wished wrenches of the arms on the object about the contacts, world axes.
        joint_acceleration: (n,) wished joint accelerations.
    """

    acceleration: Array
    wrenches: Array
    joint_acceleration: Array


def commanded_torques(motion: ChainMotion, command: Command) -> tuple[Array, Array]:
    """Return the torques of a command, (n,), and the grasp wrenches that they give, (arms, 6).

    The object's acceleration comes first: of the wrenches that give it and can be transmitted, and of the joint
    accelerations that follow it, the nearest to the wished ones are chosen. Effort limits and friction are not
    considered; near a singular posture an arm follows in the least-squares sense.

    Args:
        motion: the chain's motion, without torques; external wrenches in it count as known.
        command: the command.
    """
    wrenches, _, _ = bearing_wrenches(motion, command.acceleration, command.wrenches)
    tau = following_torques(motion, command.acceleration, wrenches, command.joint_acceleration)
    return tau, wrenches


@dataclass(frozen=True, eq=False)
class WithinLimits(Frozen):
    """The torques of a command within limits.

    The object's acceleration comes first, then the limits, which give way only where it needs that; with a weight
    `cost.task` it is the other way round. Of what is left, the least cost is chosen, in which the wishes have the
    weights of `ForceCost`.

    Attributes:
        limits: the limits.
        cost: the cost, without wishes.
    """

    limits: ForceLimits
    cost: ForceCost

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain, limits and costs for which there is no machine code.

        Raises:
            MethodNotApplicable: a change from the last wrenches is limited.
            ModelError, StateError: the cost has wishes, a name is unknown, or a shape is wrong.
        """
        for name, part in (("wish", "forces"), ("joint_acceleration", "posture")):
            if getattr(self.cost, name) is not None:
                raise ModelError(f"cooperative_law: cost: expected no {name}, got one; it is that of `{part}`")
        still = np.zeros(chain.joint_count)
        self._parameters(chain, State(still, still, Pose.identity()))

    def for_chain(self, chain: ClosedChain) -> WithinLimits:
        """Return the same for a chain whose grasps have changed; limits of grasps that it lacks are left out."""
        kept = {name: _of_grasps(getattr(self.limits, name), chain) for name in PER_GRASP}
        return replace(self, limits=replace(self.limits, **kept))

    def torques(self, motion: ChainMotion, state: State, command: Command) -> ElasticDistribution:
        """Return the torques of a command, the wrenches that they give, and what gives way.

        Args:
            motion: the chain's motion, without torques; external wrenches in it count as known.
            state: positions and rates, for the limits of a sampled controller.
            command: the command.
        """
        chain = motion.chain
        frames = {name: c.frame for name, c in zip(chain.grasps, motion.contacts, strict=True)}
        wishes = zip(chain.names, command.wrenches, strict=True)
        wish = array([unrotate(frames[name], f) if name in frames else f for name, f in wishes])
        asked = {"acceleration": command.acceleration, "wish": wish, "wished_qdd": command.joint_acceleration}
        return distribution(motion, self._parameters(chain, state) | asked)

    def given_way(self, found: ElasticDistribution) -> list[Array]:
        """Return by how much limits give way, and with a weight of it the object's acceleration; see `memory`."""
        return [found.violation[()], *([] if self.cost.task is None else [found.missed[()]])]

    @property
    def memory(self) -> Array:
        """Zeros for the numbers that a law keeps of what gave way."""
        return np.zeros(1 if self.cost.task is None else 2)

    def _parameters(self, chain: ClosedChain, state: State) -> dict[str, Array]:
        """Return the parameters of `distribute`."""
        usual = {name: value_of(name, chain) for name in DISTRIBUTE.own(chain) if name != "acceleration"}
        return usual | distribution_parameters(chain, state, self.limits, self.cost)


def chosen_torques(
    motion: ChainMotion, state: State, command: Command, within: WithinLimits | None
) -> tuple[Array, Array, list[Array]]:
    """Return the torques of a command, the grasp wrenches that they give, and what gave way within limits."""
    if within is None:
        return *commanded_torques(motion, command), []
    found = within.torques(motion, state, command)
    return found.tau, found.grasp_wrench, within.given_way(found)


def within_limits(
    chain: ClosedChain, limits: ForceLimits | None, cost: ForceCost | None, what: str
) -> WithinLimits | None:
    """Return checked limits and their cost; None without limits. A message begins with `what`."""
    checks.instance(limits, (ForceLimits, type(None)), f"{what}: limits")
    checks.instance(cost, (ForceCost, type(None)), f"{what}: cost")
    if limits is None:
        if cost is not None:
            raise ModelError(f"{what}: expected limits with a cost, got none; try limits=ForceLimits()")
        return None
    within = WithinLimits(limits, cost or ForceCost())
    within.require(chain)
    return within


def _of_grasps(given: float | Mapping[str, float] | None, chain: ClosedChain) -> float | dict[str, float] | None:
    """Return a limit per grasp without those of grasps that a chain lacks."""
    return {name: x for name, x in given.items() if name in chain.grasps} if isinstance(given, Mapping) else given
