"""A leg of a run: from one change of the grasps to the next, the chain is one and the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from holdfast.model.grasp import Grasp
from holdfast.simulation.checkpoint import Origin
from holdfast.simulation.environment import Environment
from holdfast.simulation.events import Event
from holdfast.simulation.instant import Controller, Instant, evaluate
from holdfast.simulation.limits import Signals
from holdfast.simulation.policy import Policy
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stepper import Stepper
from holdfast.simulation.stops import Stops
from holdfast.simulation.subdivision import SubdividingStepper
from holdfast.simulation.tolerance import Tolerance
from holdfast.spatial.scalar import Array

MakeStepper = Callable[[Environment, Controller, int, Tableau, Tolerance], Stepper]


@dataclass(frozen=True, eq=False)
class Plan:
    """What stays the same through a run.

    Attributes:
        environment: the chain as it is at the start, and what acts on it.
        controller: torques, as it is at the start.
        make_stepper: (environment, controller, generic rank, scheme, tolerance) -> what takes the steps.
        scheme: Runge-Kutta scheme.
        tolerance: of a scheme that estimates its error.
        largest_drift: of a step of one that does not, see `subdivision` [m or rad]; None: any.
        policy: what is done about violations.
        events: in order of time.
        stops: times that steps end at.
    """

    environment: Environment
    controller: Controller
    make_stepper: MakeStepper
    scheme: Tableau
    tolerance: Tolerance
    largest_drift: float | None
    policy: Policy
    events: list[Event]
    stops: Stops

    @cached_property
    def longest_step(self) -> float:
        """The longest step that a scheme of fixed steps takes [s]."""
        times, jumps = self.stops
        return float(np.diff(times, prepend=0.0)[~jumps].max())


@dataclass(frozen=True, eq=False)
class Leg:
    """What stays the same while the same arms hold the object.

    Attributes:
        plan: of the run.
        environment: the chain with its grasps now, and what acts on it.
        controller: torques.
        generic_rank: of the constraint away from singular configurations.
    """

    plan: Plan
    environment: Environment
    controller: Controller
    generic_rank: int

    @cached_property
    def stepper(self) -> Stepper:
        """What takes the steps; those of a scheme that does not choose its own are taken in parts where need be."""
        plan = self.plan
        whole = plan.make_stepper(self.environment, self.controller, self.generic_rank, plan.scheme, plan.tolerance)
        if plan.scheme.adaptive or plan.largest_drift is None:
            return whole
        return SubdividingStepper(whole, plan.largest_drift)

    @cached_property
    def signals(self) -> Signals:
        """The margins that there are."""
        return Signals(self.environment.chain)

    @cached_property
    def acting(self) -> Array:
        """Indices of the signals that end a step where they become negative."""
        return self.plan.policy.acting(self.signals)

    def at(self, origin: Origin) -> Instant:
        """Return the instant that an accepted time, state and memory make; nothing is projected."""
        return self.stepper.evaluate(origin.t, origin.state, origin.memory)


def first_leg(plan: Plan, start: Origin) -> Leg:
    """Return the leg that a run begins with.

    Raises:
        StateError: the state breaks a grasp, or the controller's torques do not fit.
        SingularChainError: the configuration is singular.
    """
    # judged with its neighbours; later a rank below its rank is a singularity
    first = evaluate(plan.environment, plan.controller, start.t, start.state, start.memory, check=True)
    return Leg(plan, plan.environment, plan.controller, first.result.rank)


def leg_with(leg: Leg, grasps: Mapping[str, Grasp], start: Origin) -> Leg:
    """Return the leg that begins where grasps close or open.

    A controller that has a `for_chain(chain)` is replaced by what that returns; another goes on as it is.

    Raises:
        SingularChainError: the configuration is singular with these grasps.
    """
    environment, controller = _for_grasps(leg.plan, grasps)
    first = evaluate(environment, controller, start.t, start.state, start.memory)
    return Leg(leg.plan, environment, controller, first.result.rank)


def resumed_leg(plan: Plan, grasps: Mapping[str, Grasp], generic_rank: int) -> Leg:
    """Return the leg with the grasps and the generic rank of a checkpoint."""
    return Leg(plan, *_for_grasps(plan, grasps), generic_rank)


def _for_grasps(plan: Plan, grasps: Mapping[str, Grasp]) -> tuple[Environment, Controller]:
    chain = replace(plan.environment.chain, grasps=grasps)
    for_chain = getattr(plan.controller, "for_chain", None)
    return replace(plan.environment, chain=chain), plan.controller if for_chain is None else for_chain(chain)
