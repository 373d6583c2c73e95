"""Derivatives of forward dynamics while contacts with the world keep their modes.

The world's wrench w on the object is an external one, so y(theta) is the answer of the chain without contacts at
w(theta), whose derivatives are known; dw comes from `mode_derivatives`. In reverse, with w_bar of the results,

    x_bar = D w_bar,   s_bar = -S^-T x_bar,   theta_bar = that of y_bar and of alpha_bar + A^T s_bar
                                              + (d(A alpha + drift)|)^T s_bar + (dw|)^T (w_bar + P^T A^T s_bar)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.dynamics.contact.mode_derivatives import ContactRates, contact_rates
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import arguments_of, gradient_shapes, results_of
from holdfast.questions.derivatives import Derivatives, directions, finite_derivatives, require_names
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

OBJECT_WRENCH, OBJECT_ACCELERATION, TOUCH_FORCE = "object_wrench", "object_acceleration", "touch_force"


class OfForward(Protocol):
    """One of the derivatives of forward dynamics."""

    def __call__(self, *args: Any, **given: Any) -> Derivatives:
        """Return the derivatives."""
        ...


class TouchingPoint(NamedTuple):
    """Forward dynamics of a chain with contacts, and the same question of the chain without them.

    Attributes:
        result: with contacts.
        rates: the contacts; None if none is closed.
        chain: the chain without contacts.
        given: its arguments after the chain: state and torques.
        more: its keyword arguments, with the world's wrench among the inputs.
    """

    result: ForwardResult
    rates: ContactRates | None
    chain: ClosedChain
    given: tuple[Any, ...]
    more: Mapping[str, Any]

    def mobility(self, jacobian: OfForward) -> Array:
        """Return P, (6, 6)."""
        return jacobian(self.chain, *self.given, of=[OBJECT_ACCELERATION], by=[OBJECT_WRENCH], **self.more)[
            OBJECT_ACCELERATION, OBJECT_WRENCH
        ]


def _point(
    chain: ClosedChain, state: State, tau: Any, inputs: Inputs | None, more: dict[str, Any], by_forces: bool
) -> TouchingPoint:
    result = forward_dynamics(chain, state, tau, inputs=inputs, **more)
    rates = contact_rates(chain, state, result, by_forces)
    known = Inputs() if inputs is None else inputs
    if rates is not None:
        before = np.zeros(6) if known.object_wrench is None else known.object_wrench
        known = replace(known, object_wrench=before + rates.wrench)
    return TouchingPoint(result, rates, replace(chain, touching=None), (state, tau), {"inputs": known, **more})


def touching_vjp(
    of: tuple[OfForward, OfForward],
    chain: ClosedChain,
    state: State,
    tau: Any,
    inputs: Inputs | None,
    by: Sequence[str],
    more: dict[str, Any],
    cotangents: Mapping[str, Any],
) -> Derivatives:
    """Return the gradients; `of` are vjp and jacobian of chains without contacts, `more` their further arguments."""
    vjp, jacobian = of
    require_names("forward_dynamics_vjp", by, arguments_of(chain))
    require_names("forward_dynamics_vjp", cotangents, (*results_of(chain), TOUCH_FORCE))
    of_forces = TOUCH_FORCE in cotangents
    at = _point(chain, state, tau, inputs, more, of_forces)
    rest = {name: x for name, x in cotangents.items() if name != TOUCH_FORCE}
    force_bar = np.zeros((len(at.result.touch_gap), 3))  # pyright: ignore[reportArgumentType]
    if of_forces:
        force_bar = checks.numbers(cotangents[TOUCH_FORCE], force_bar.shape, TOUCH_FORCE, StateError)
    if at.rates is None:
        rest = rest or {OBJECT_ACCELERATION: np.zeros(6)}
        return Derivatives(at.result, vjp(at.chain, *at.given, by=by, **at.more, **rest).parts)
    rates, P = at.rates, at.mobility(jacobian)
    wrench_bar = vjp(at.chain, *at.given, by=[OBJECT_WRENCH], **at.more, **rest)[OBJECT_WRENCH] if rest else np.zeros(6)
    s_bar = -rates.compliance(P).T @ (rates.D @ wrench_bar + rates.gives.T @ force_bar.ravel())
    rest[OBJECT_ACCELERATION] = (
        checks.numbers(rest.get(OBJECT_ACCELERATION, np.zeros(6)), (6,), OBJECT_ACCELERATION, StateError)
        + rates.A.T @ s_bar
    )
    found = dict(vjp(at.chain, *at.given, by=by, **at.more, **rest).parts)
    wrench_bar = wrench_bar + P.T @ rates.A.T @ s_bar
    for name, (rows, wrench, forces) in rates.by.items():
        if name in found:
            found[name] = found[name] + rows.T @ s_bar + wrench.T @ wrench_bar + forces.T @ force_bar.ravel()
    return finite_derivatives(at.result, found)


def touching_jvp(
    of: tuple[OfForward, OfForward],
    chain: ClosedChain,
    state: State,
    tau: Any,
    inputs: Inputs | None,
    along: Mapping[str, Any],
    more: dict[str, Any],
) -> Derivatives:
    """Return the rates; `of` are jvp and jacobian of chains without contacts, `more` their further arguments."""
    jvp, jacobian = of
    require_names("forward_dynamics_jvp", along, arguments_of(chain))
    at = _point(chain, state, tau, inputs, more, False)
    given = directions("forward_dynamics_jvp", along, gradient_shapes(chain))
    if at.rates is None:
        return Derivatives(at.result, jvp(at.chain, *at.given, along=along, **at.more).parts)
    rates, P = at.rates, at.mobility(jacobian)

    def one(tangents: dict[str, Array]) -> dict[str, Array]:
        free = jvp(at.chain, *at.given, along=tangents, **at.more).parts
        dw = rates.changes("", P, free[OBJECT_ACCELERATION][:, None])[0][:, 0]
        for name, x in tangents.items():
            if name in rates.by:
                dw = dw + rates.changes(name, P, np.zeros((6, 6)))[0] @ x
        pressed = jvp(at.chain, *at.given, along={OBJECT_WRENCH: dw}, **at.more).parts
        return {name: free[name] + pressed[name] for name in free}

    if isinstance(given, dict):
        return finite_derivatives(at.result, one(given))
    each = [one(tangents) for tangents in given]
    return finite_derivatives(at.result, {name: np.array([x[name] for x in each]) for name in results_of(chain)})


def touching_jacobian(
    jacobian: OfForward,
    chain: ClosedChain,
    state: State,
    tau: Any,
    inputs: Inputs | None,
    of: Sequence[str],
    by: Sequence[str],
    more: dict[str, Any],
) -> Derivatives:
    """Return the Jacobian; `jacobian` is that of chains without contacts, `more` its further arguments."""
    require_names("forward_dynamics_jacobian", of, (*results_of(chain), TOUCH_FORCE))
    require_names("forward_dynamics_jacobian", by, arguments_of(chain))
    at = _point(chain, state, tau, inputs, more, TOUCH_FORCE in of)
    own = [*dict.fromkeys([*(name for name in of if name != TOUCH_FORCE), OBJECT_ACCELERATION])]
    free = jacobian(at.chain, *at.given, of=own, by=[*dict.fromkeys([*by, OBJECT_WRENCH])], **at.more)
    count = 0 if at.result.touch_gap is None else len(at.result.touch_gap)
    found = {}
    for b in by:
        shape = free[OBJECT_ACCELERATION, b].shape[1:]
        alpha = free[OBJECT_ACCELERATION, b].reshape(6, -1)
        dw, forces = np.zeros_like(alpha), np.zeros((3 * count, alpha.shape[1]))
        if at.rates is not None:
            dw, forces = at.rates.changes(b, free[OBJECT_ACCELERATION, OBJECT_WRENCH], alpha)
        for o in of:
            if o == TOUCH_FORCE:
                found[o, b] = forces.reshape(count, 3, *shape)
            else:
                pressed = free[o, OBJECT_WRENCH].reshape(-1, 6) @ dw
                found[o, b] = free[o, b] + pressed.reshape(free[o, b].shape)
    return finite_derivatives(at.result, found)
