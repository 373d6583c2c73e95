"""`holdfast.compile_rollout`, which compiles the steps of many systems with their control law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from holdfast.compiled.structure import optional_parameters, require_rank
from holdfast.control.controller import ControlLaw, Controller, GivenLaw, held_torques
from holdfast.control.traced_law import law_of, require_function
from holdfast.errors import MethodNotApplicable, ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import (
    answered_as_forest,
    require_machine_code,
    require_unused,
    serial_chain,
    without_contacts,
)
from holdfast.simulation.environment import BaseMotion, Environment, GivenInputs, take_state
from holdfast.simulation.rollout.arguments import require_free_names
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.user_functions import require_functions
from holdfast.simulation.runge_kutta import IMEX, MIDPOINT
from holdfast.simulation.runge_kutta import scheme as scheme_of


def compile_rollout(
    chain: ClosedChain,
    law: ControlLaw | Controller | None = None,
    *,
    scheme: str | None = None,
    generic_rank: int | None = None,
    base_motion: Mapping[str, BaseMotion] | None = None,
    inputs: GivenInputs | None = None,
    parameters: Sequence[str] = (),
) -> Rollout:
    """Compile the steps of a chain with a control law to machine code for this computer.

    A step consists of the stages of the scheme, followed by two Newton iterations that project the positions onto the
    grasps, and a projection of the velocities, both in the kinetic metric. A chain with `touching` takes the steps of
    `simulate(contacts="steps")`: the midpoint rule with impulses of contacts. They begin with the forces of the step
    before, which the systems keep as `touch_force`, and are found anew where these do not lead to impulses that satisfy
    the laws; the status of a system in which none are found is UNLAWFUL.

    Numbers of a chain with branches, loops, couplings or several objects are constants of the machine code, but for
    gravity and those of an only object, and the rank of its constraint is that of the first system: another one is
    SINGULAR. Its passive joints take no torque.

    Args:
        chain: arms, object and grasps.
        law: a `ControlLaw`, or a controller of the library that can be traced. Without a law, the torques are passed to
            every call as `tau` and are constant during each step.
        scheme: `rk4`, the default; or `midpoint`, which is of second order, needs half as many evaluations, and is the
            only one with `touching`.
        generic_rank: rank of the grasp constraint away from singular configurations; by default it is determined from
            the first systems.
        base_motion: functions t -> (pose, twist, acceleration) of moving bases, by arm name or "trunk", as for
            `simulate`, of chains without branches. They become part of the machine code, so the rules for writing
            control laws apply.
        inputs: external wrenches that depend on t or on (t, state), as for `simulate`. They become part of the machine
            code, so the rules for writing control laws apply. Wrenches passed to calls are added to them.
        parameters: names of optional groups of arguments, as for `compile`: `link_inertia` (link_mass, link_com,
            link_inertia; with a trunk also trunk_link_mass, trunk_link_com, trunk_link_inertia) and `link_wrench`
            (external wrenches on the links).

    Returns:
        The rollout: `start` makes systems of it, `step` and `run` move them.

    Raises:
        ModelError: the scheme is unknown or adaptive, a parameter of the law has the name of another argument, a base
            motion belongs to no arm, the inputs are not a function of (t) or (t, state), or one of these functions
            depends on more than its arguments.
        MethodNotApplicable: the contacts of the chain need another scheme or have no machine code, or a chain with
            branches is given what is for serial arms.
        StateError: an optional group of arguments is unknown, or `generic_rank` is not a rank.
        CompileError: (at the first start) the law, a base motion or the inputs cannot be traced; the message names the
            line.
    """
    named = scheme or ("rk4" if getattr(chain, "touching", None) is None else MIDPOINT.name)
    if scheme_of(named).adaptive:
        raise ModelError(f"rollout: scheme: expected 'rk4' or 'midpoint', got '{scheme}'; it is for `simulate`")
    if not isinstance(chain, ClosedChain):
        raise ModelError(f"rollout: chain: expected a ClosedChain, got {type(chain).__name__}")
    if forest := answered_as_forest(chain):
        _require_of_forest(chain, named, base_motion, parameters)
    else:
        serial_chain(chain, "rollout: chain")
    if chain.touching is not None and named != MIDPOINT.name:
        raise MethodNotApplicable(
            f"rollout: scheme: expected 'midpoint' with contacts, got {named!r}; try it, or no scheme"
        )
    require_machine_code(chain, "rollout")
    require_rank(generic_rank, chain.forest if forest else chain, "rollout")
    traced = held_torques(chain.joint_count) if law is None else _traced(law, chain)
    if law is not None:
        require_free_names(traced.parameters)
        require_function(traced, chain)
    motions = Environment(chain, base_motion or {}).base_motion
    options = optional_parameters(parameters, "rollout")
    if inputs is not None:
        take_state(inputs)
    require_functions(motions, inputs, chain)
    return Rollout(chain, traced, named, generic_rank, motions, options, inputs)


def _require_of_forest(chain: ClosedChain, scheme: str, base_motion: object, parameters: object) -> None:
    """Refuse what rollouts of chains that are answered as forests do not take.

    Raises:
        MethodNotApplicable: naming it.
    """
    require_unused(base_motion=bool(base_motion), scheme=scheme == IMEX.name)
    without_contacts(chain, "rollout: chain that is answered as a forest")
    if checks.is_listed(parameters) and "link_inertia" in parameters:  # pyright: ignore[reportOperatorIssue]
        raise MethodNotApplicable(
            "rollout: parameters: expected 'link_wrench' or none for a chain that is answered as a forest, got"
            " 'link_inertia': its links are constants of the machine code; try a rollout of another chain"
        )


def _traced(law: ControlLaw | Controller, chain: ClosedChain) -> ControlLaw:
    """Return a control law or a controller of the library as a `ControlLaw`.

    Raises:
        ModelError: it is another function, which need not depend on its arguments alone.
    """
    found = law if isinstance(law, ControlLaw) else None if isinstance(law, GivenLaw) else law_of(law, chain)
    if found is None:
        raise ModelError(
            f"rollout: law: expected a ControlLaw, a ready-made controller or None, got {type(law).__name__}; try"
            " ControlLaw(function)"
        )
    return found
