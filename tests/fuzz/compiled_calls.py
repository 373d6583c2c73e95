"""Sound calls of machine code."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Any

import jax
import numpy as np

import holdfast as hf
from holdfast.interop import jacobian_operator, to_jax
from holdfast.questions.arrays import ARRAYS, FLOATING, STATE
from holdfast.questions.question import QUESTIONS
from tests.fuzz.calls import Later, call, everything, fixed, shown
from tests.questions.every import direct

# Machine code.


@cache
def compiled() -> Any:
    """Return the machine code of the floating chain with everything."""
    return hf.compile(everything().chain)


def given_compiled(**more: Any) -> dict[str, Any]:
    """Return sound arguments of the machine code, and more of them."""
    names = (*STATE, *FLOATING, "tau")
    return {name: Later(lambda name=name: np.array(everything().arguments[name])) for name in names} | more


ACTING = {
    "object_wrench": np.ones(6),
    "gravity": np.array([0.0, 0.0, -9.81]),
    "object_mass": 2.0,
    "object_inertia": "scale",
    "threads": 1,
}


@call("compiled forward_dynamics", **given_compiled(**ACTING))
def _forward(**given: Any) -> Any:
    return compiled().forward_dynamics(**given)


call(
    "compiled batch",
    **{
        **given_compiled(**ACTING),
        "q": Later(lambda: np.tile(everything().state.q, (4, 1))),
        "gravity": np.tile([0.0, 0.0, -9.81], (4, 1)),
        "threads": 2,
    },
)(_forward)


@call("bind", **given_compiled(object_wrench=np.ones(6)))
def _bind(**given: Any) -> Any:
    compiled().bind(**given)  # a call checks nothing: see `BoundFunction`


@cache
def plain() -> Any:
    """Return the machine code of two arms on bases that stand."""
    return hf.compile(fixed().chain)


GIVEN = {
    **{name: Later(lambda name=name: np.array(fixed().arguments[name])) for name in ("q", "qd", "tau", "object_pose")},
    "object_twist": np.zeros(6),
}


@call("compiled forward_dynamics.vjp", **GIVEN, by=["q", "tau"], qdd=Later(lambda: np.array(fixed().tau)))
def _compiled_vjp(by: Any, **given: Any) -> Any:
    found = plain().forward_dynamics.vjp(by=by, **given)
    return [found[name] for name in by]


@call("compiled forward_dynamics.jacobian", **GIVEN, of=["qdd"], by=["q"])
def _compiled_jacobian(of: Any, by: Any, **given: Any) -> Any:
    found = plain().forward_dynamics.jacobian(of=of, by=by, **given)
    return [found[one] for one in product(of, by)]


def of_question(name: str) -> None:
    """Add a call of a question with machine code, and of its gradients by an input."""
    question = QUESTIONS[name]

    def ask(**given: Any) -> Any:
        return getattr(compiled(), name)(**given)

    def gradient(by: Any, **given: Any) -> Any:
        found = getattr(compiled(), name).vjp(by=by, **given)
        return [found[one] for one in by or ()]

    names = (*question.inputs, *question.by_name(everything().chain))
    given = {x: Later(lambda x=x: sound(x)) for x in names}
    call(f"compiled {name}", **given, threads=1)(ask)
    if question.arguments:
        first = question.names[0]
        cotangent = Later(lambda: np.ones(question.shape(everything().chain, first))[()])
        call(f"compiled {name}.vjp", **given, by=[question.by[0]], **{first: cotangent})(gradient)


def sound(name: str) -> np.ndarray:
    """Return an input of a question, of the chain with everything and its forward dynamics."""
    p, field = everything(), ARRAYS[name].field or name
    if name == "tau":
        return np.array(p.tau)
    return np.array(getattr(p.state if ARRAYS[name].role == "state" else alone(), field))


@cache
def alone() -> Any:
    """Return forward dynamics of the chain with everything on which nothing acts."""
    p = everything()
    return hf.forward_dynamics(p.chain, p.state, p.tau, check=False)


for _name in direct():
    of_question(_name)


call(
    "compile",
    chain=Later(lambda: fixed().chain),
    dtype="float64",
    method="auto",
    parameters=["link_inertia"],
    iterations=12,
    generic_rank=9,
)(shown(hf.compile))


@call("jacobian_operator", **GIVEN, of="qdd", by=["tau"])
def _operator(**given: Any) -> Any:
    return jacobian_operator(plain(), **given).shape


@call("to_jax", of=["qdd"], parameters=[], forward_mode=False)
def _jax(**given: Any) -> Any:
    with jax.enable_x64(True):
        return repr(to_jax(plain(), **given))
