"""`holdfast.compile_rollout`: many systems stepped in machine code, control law included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from holdfast.compiled.structure import optional_parameters, require_rank
from holdfast.control.controller import ControlLaw, Controller, GivenLaw, held_torques
from holdfast.control.traced_law import law_of
from holdfast.errors import ModelError
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.external_inputs import GivenInputs, take_state
from holdfast.simulation.rollout.arguments import require_free_names
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.runge_kutta import scheme as scheme_of


def compile_rollout(
    chain: ClosedChain,
    law: ControlLaw | Controller | None = None,
    *,
    scheme: str = "rk4",
    generic_rank: int | None = None,
    base_motion: Mapping[str, BaseMotion] | None = None,
    inputs: GivenInputs | None = None,
    parameters: Sequence[str] = (),
) -> Rollout:
    """Compile steps of a chain under a control law to machine code of this computer.

    A step is the scheme's stages, two Newton rounds back onto the grasps in position, then in
    velocity, in the kinetic metric.

    Args:
        chain: arms, object and grasps.
        law: torques, a `ControlLaw` or a ready-made controller that can be traced; without one they are given to every
            call as `tau`, and held for each step.
        scheme: `rk4`, or `midpoint`: half the evaluations, second order.
        generic_rank: rank of the grasp constraint away from singular configurations; found from the
            first systems if not given.
        base_motion: t -> (pose, twist, acceleration) of moving bases, by arm name or "trunk", as for `simulate`;
            written as a control law is, as it becomes part of the machine code.
        inputs: external wrenches that depend on t, or on (t, state), as for `simulate`; written as a control law is, as
            they become part of the machine code. Those given to calls come on top.
        parameters: what else may be given, as for `compile`: `link_inertia` (link_mass, link_com,
            link_inertia), `link_wrench` (external wrenches on the links).

    Returns:
        The rollout: `start` makes systems of it, `step` and `run` move them.

    Raises:
        ModelError: no such scheme, or one that estimates errors; a parameter of the law is named as an argument; a base
            motion of no arm, inputs that are no function of (t) or (t, state).
        StateError: no such optional parameter, or no rank.
        CompileError: (when first started) the law, a base motion or inputs do what cannot be traced; the line is named.
    """
    if scheme_of(scheme).adaptive:
        raise ModelError(f"rollout: scheme: expected 'rk4' or 'midpoint', got '{scheme}'; it is for `simulate`")
    if not isinstance(chain, ClosedChain):
        raise ModelError(f"rollout: chain: expected a ClosedChain, got {type(chain).__name__}")
    require_rank(generic_rank, chain, "rollout")
    traced = held_torques(chain.joint_count) if law is None else _traced(law, chain)
    if law is not None:
        require_free_names(traced.parameters)
    motions = Environment(chain, base_motion or {}).base_motion
    options = optional_parameters(parameters, "rollout")
    if inputs is not None:
        take_state(inputs)
    return Rollout(chain, traced, scheme, generic_rank, motions, options, inputs)


def _traced(law: ControlLaw | Controller, chain: ClosedChain) -> ControlLaw:
    """Return the law of what may be one.

    Raises:
        ModelError: a function, which need not depend on its arguments alone.
    """
    found = law if isinstance(law, ControlLaw) else None if isinstance(law, GivenLaw) else law_of(law, chain)
    if found is None:
        raise ModelError(
            f"rollout: law: expected a ControlLaw, a ready-made controller or None, got {type(law).__name__}; try"
            " ControlLaw(function)"
        )
    return found
