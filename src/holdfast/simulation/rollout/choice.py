"""Which stepper a run gets."""

from __future__ import annotations

from holdfast.compiler.errors import CompileError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Controller
from holdfast.simulation.limits import Signals
from holdfast.simulation.rollout.fused import FusedStepper
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.rollout.law_text import law_program
from holdfast.simulation.rollout.stagewise import StagewiseStepper, unsteady
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stepper import ReferenceStepper, Stepper
from holdfast.simulation.tolerance import Tolerance

WORTH_COMPILING = 45  # steps: fewer are taken by the readable texts in the time that compiling takes
LOOKED_AT = 16  # steps that the looks inside one come to, where something is limited


def stepper_for(
    environment: Environment,
    controller: Controller | ControlLaw,
    generic_rank: int,
    scheme: Tableau,
    tolerance: Tolerance,
    steps: int,
) -> Stepper:
    """Return the stepper that suits a run; all of them give the same answers to rounding.

    A `ControlLaw`, or a controller or base motion that says it is `traceable`, becomes part of the machine code;
    any other one is asked from Python, stage by stage. So go schemes that estimate their errors.

    Args:
        environment: the chain and what acts on it.
        controller: torques.
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the Runge-Kutta scheme.
        tolerance: for schemes that estimate errors.
        steps: how many there will be, at least.

    Raises:
        StateError: a law that is told parameters, which a run has not.
        CompileError: a law does what cannot be traced.
    """
    few = steps * (LOOKED_AT if len(Signals(environment.chain).limited) else 1) < WORTH_COMPILING
    if (few and not scheme.adaptive) or _acting_on_links(environment):
        return ReferenceStepper(environment, controller, generic_rank, scheme, tolerance)
    law = law_of(controller, environment.chain)
    if law is None or scheme.adaptive or not _traceable(environment):
        return StagewiseStepper.of(environment, controller, generic_rank, scheme, tolerance, law)
    return FusedStepper.of(environment, law, scheme, generic_rank)


def law_of(controller: Controller | ControlLaw, chain: ClosedChain) -> ControlLaw | None:
    """Return the law of a controller that can be traced, or None.

    Raises:
        StateError: a law that is told parameters.
    """
    if isinstance(controller, ControlLaw):
        controller.require_no_parameters()
        return controller
    if not getattr(controller, "traceable", False):
        return None
    key = exact_fingerprint(controller)
    law = ControlLaw(lambda t, state, memory, given: (controller(t, state, None)[0], memory), key=key or "")
    if key is None:  # a part of it is the user's own, such as a path
        try:
            law_program(law, chain)
        except CompileError:
            return None
    return law


def _traceable(environment: Environment) -> bool:
    """Return whether all that changes with time can be part of the machine code."""
    motions = environment.base_motion.values()
    return not unsteady(environment.inputs) and all(getattr(motion, "traceable", False) for motion in motions)


def _acting_on_links(environment: Environment) -> bool:
    inputs = environment.inputs(0.0) if callable(environment.inputs) else environment.inputs
    return inputs.link_wrenches is not None
