"""Gradients, rates and Jacobians of questions that need no linear solve, on floats; see `linearised_function`.

A Jacobian is computed with one gradient per row.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ParamSpec, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.names import wrong_call
from holdfast.questions.arrays import ARRAYS, Shape, gradient_shapes, value_of
from holdfast.questions.case import VariedCase
from holdfast.questions.linearised_function import LinearisedFunction, linearised_function
from holdfast.questions.question import QUESTIONS, Question
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, shaped_inputs

P = ParamSpec("P")
R = TypeVar("R", covariant=True)
Returned = TypeVar("Returned")


@dataclass(frozen=True, eq=False)
class Derivatives(Frozen):
    """Derivatives of a question: `found.q` or `found["q"]`, or for a Jacobian `found["qdd", "q"]`.

    Attributes:
        result: the answer, such as a `ForwardResult`.
        parts: all derivatives by name, or by result and argument.
    """

    result: Any
    parts: Mapping[Any, Array]

    def __repr__(self) -> str:
        """Return names and shapes of the derivatives."""
        names = {key: key if isinstance(key, str) else f"{key[0]} by {key[1]}" for key in self.parts}
        return f"<Derivatives: {', '.join(f'{names[key]} {np.shape(x)}' for key, x in self.parts.items())}>"

    def __getitem__(self, name: Any) -> Array:
        """Return the derivatives with the given name, or those of a result with respect to an argument."""
        if name not in self.parts:
            raise StateError(f"no derivative {name!r}; there are {', '.join(map(str, self.parts))}")
        return self.parts[name]

    def __getattr__(self, name: str) -> Array:
        """Return the derivatives with the given name."""
        if name.startswith("_") or name not in self.parts:
            raise AttributeError(f"no derivative '{name}'.{checks.did_you_mean(name, [str(x) for x in self.parts])}")
        return self.parts[name]


class Asked(Protocol[P, R]):
    """A function that answers a question, with its derivatives.

    Attributes:
        question: the question.
    """

    question: Question
    __name__: str

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return the answer."""
        ...

    def vjp(self, *given: Any, by: Sequence[str] = ..., **cotangents: Any) -> Derivatives:
        """Return the gradients of sum(cotangent . result), at a few times the cost of the answer."""
        ...

    def jvp(self, *given: Any, along: Mapping[str, ArrayLike], **arguments: Any) -> Derivatives:
        """Return the rates of the results for given rates of the arguments, in one direction or several."""
        ...

    def jacobian(self, *given: Any, of: Sequence[str] = ..., by: Sequence[str] = ..., **arguments: Any) -> Derivatives:
        """Return the Jacobian."""
        ...


def asked(function: Callable[P, Returned]) -> Asked[P, Returned]:
    """Mark a function as the answer to a question, which `declare` gives its derivatives at the foot of the file."""
    return cast(Any, function)


def declare(
    question: Question,
    function: Asked[..., Any] | None = None,
    own: Callable[..., Mapping[str, ArrayLike]] | None = None,
) -> Question:
    """Add a question to `QUESTIONS`, and give the function that answers it on floats `vjp`, `jvp` and `jacobian`.

    Args:
        question: the question.
        function: that function; None if only machine code answers the question.
        own: returns the arrays that the question is given besides chain, state and inputs, of the function's arguments
            by name; by default those of the same names.
    """
    assert question.name not in QUESTIONS, f"a second question of the name {question.name}"
    QUESTIONS[question.name] = question
    if function is not None:
        attach(question, function, own)
    return question


def attach(question: Question, function: Asked[..., Any], own: Callable[..., Mapping[str, ArrayLike]] | None) -> None:
    """Give the function that answers a question on floats its derivatives; arguments as in `declare`."""
    signature = inspect.signature(function)

    along = inspect.Parameter("along", inspect.Parameter.KEYWORD_ONLY)
    with_along = signature.replace(parameters=[*signature.parameters.values(), along])

    def case(called: dict[str, Any]) -> tuple[VariedCase, Any]:
        serial_chain(called["chain"], "chain")
        with np.errstate(all="ignore"):
            result = function(**called)
        return asked_case(question, called, own), result

    def vjp(*given: Any, by: Sequence[str] = question.by, **more: Any) -> Derivatives:
        cotangents = {name: more.pop(name) for name in question.names if name in more}
        called = bound_arguments(f"{question.name}.vjp", signature, given, more)
        return function_vjp(question, *case(called), by, cotangents)

    def jvp(*given: Any, along: Mapping[str, ArrayLike] | None = None, **more: Any) -> Derivatives:
        more |= {} if along is None else {"along": along}
        called = bound_arguments(f"{question.name}.jvp", with_along, given, more)
        directions = called.pop("along")
        return function_jvp(question, *case(called), directions)

    def jacobian(
        *given: Any, of: Sequence[str] = question.of or question.names, by: Sequence[str] = question.by, **more: Any
    ) -> Derivatives:
        called = bound_arguments(f"{question.name}.jacobian", signature, given, more)
        return function_jacobian(question, *case(called), of, by)

    for kind, derivative in {"vjp": vjp, "jvp": jvp, "jacobian": jacobian}.items():
        derivative.__module__, derivative.__name__ = function.__module__, kind
        derivative.__qualname__, derivative.__doc__ = f"{question.name}.{kind}", derivative_docstring(question, kind)
        setattr(function, kind, derivative)
    function.question = question


def derivative_docstring(question: Question, kind: str) -> str:
    """Return the docstring of a question's derivatives."""
    results, arguments = ", ".join(question.names), ", ".join(question.arguments)
    summary, further, returns = {
        "vjp": (
            f"Return the gradients of sum(cotangent . result) of `{question.name}`: theta_bar = (dz/dtheta)^T z_bar.",
            f"by: the arguments: {arguments}.\n    **cotangents: cotangents by result: {results}, in their shapes.",
            "The gradients by argument, in the shape of the argument; `result` is the answer.",
        ),
        "jvp": (
            f"Return the rates of the results of `{question.name}`: z_dot = (dz/dtheta) theta_dot.",
            "along: rates of the arguments by name, in the shapes of their gradients, or (d, ...) for d directions.\n"
            f"        Arguments: {arguments}.",
            f"The rates by result: {results}, with a leading axis if there are several directions.",
        ),
        "jacobian": (
            f"Return the Jacobian dz/dtheta of `{question.name}`.",
            f"of: the results: {results}.\n    by: the arguments: {arguments}.",
            "`found[of, by]`, with the axes of the result and then those of the argument's gradient.",
        ),
    }[kind]
    return (
        f"{summary}\n\nNames of arguments and derivatives by poses are as in `forward_dynamics_vjp`.\n\nArgs:\n"
        f"    *given: the arguments of `{question.name}`.\n    {further}\n\nReturns:\n    {returns}\n\nRaises:\n"
        "    StateError: A name, shape or number is wrong.\n"
    )


def bound_arguments(
    what: str, signature: inspect.Signature, given: tuple[Any, ...], by_name: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of a call by name.

    Raises:
        CallError: one is unknown, missing, or given twice.
    """
    if wrong := wrong_call(signature, what, given, by_name):
        raise wrong
    bound = signature.bind(*given, **by_name)
    bound.apply_defaults()
    return bound.arguments


def asked_case(
    question: Question, called: Mapping[str, Any], own: Callable[..., Mapping[str, ArrayLike]] | None = None
) -> VariedCase:
    """Return the arguments of a call, by name, as a case; see `declare`."""
    chain = called["chain"]
    serial_chain(chain, "chain")
    if own is None:
        fields = {row.field: name for name, row in ARRAYS.items() if row.field}
        further = {name: x for name, x in called.items() if name not in ("chain", "state", "inputs") and x is not None}
        named = {fields.get(name, name): x for name, x in further.items()}
    else:
        named = own(**called)
    arrays = {name: value_of(name, chain) for name in question.own(chain) if ARRAYS[name].value is not None}
    arrays |= {name: checks.numbers(x, ARRAYS[name].shape(chain), name, StateError) for name, x in named.items()}
    return VariedCase(chain, called["state"], with_link_wrenches(chain, called.get("inputs")), arrays)


def with_link_wrenches(chain: ClosedChain, inputs: Inputs | None) -> Inputs:
    """Return the inputs as arrays, with zero link wrenches if none are given."""
    given = shaped_inputs(chain, inputs)
    if given.link_wrenches is not None:
        return given
    return replace(given, link_wrenches=np.zeros(ARRAYS["link_wrench"].shape(chain)))


def function_vjp(
    question: Question, case: VariedCase, result: Any, by: Sequence[str], cotangents: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return the gradients of sum(cotangent . result) by some arguments, at a few times the cost of the function."""
    what = f"{question.name}.vjp"
    cotangents = cotangents or unit_cotangent(question, case.chain)
    require_names(what, cotangents, question.names_at(case.chain))
    with np.errstate(all="ignore"):
        at = _linear(question, case, by, what)
        checked = {name: checks.numbers(x, at.shapes[name], name, StateError) for name, x in cotangents.items()}
        return _found(question, what, result, at.gradient(checked))


def unit_cotangent(question: Question, chain: ClosedChain) -> dict[str, float]:
    """Return the cotangent 1 of the only result of a question, if that is a number, such as an energy."""
    shapes = [question.shape(chain, name) for name in question.names]
    return {question.names[0]: 1.0} if shapes == [()] else {}


def function_jvp(question: Question, case: VariedCase, result: Any, along: Mapping[str, ArrayLike]) -> Derivatives:
    """Return the rates of the results for given rates of the arguments, in one direction or several."""
    what = f"{question.name}.jvp"
    checks.instance(along, Mapping, f"{what}: along", StateError)
    with np.errstate(all="ignore"):
        at = _linear(question, case, tuple(along), what)
        given = directions(what, along, argument_shapes(case))
        if isinstance(given, dict):
            return _found(question, what, result, at.rates(given))
        found = [at.rates(one) for one in given]
    parts = {name: np.reshape([one[name] for one in found], (len(given), *shape)) for name, shape in at.shapes.items()}
    return _found(question, what, result, parts)


def function_jacobian(
    question: Question, case: VariedCase, result: Any, of: Sequence[str], by: Sequence[str]
) -> Derivatives:
    """Return the Jacobian, computed with one gradient per row."""
    what = f"{question.name}.jacobian"
    require_names(what, of, question.names_at(case.chain))
    parts: dict[tuple[str, str], Array] = {}
    with np.errstate(all="ignore"):
        at, shapes = _linear(question, case, by, what), argument_shapes(case)
        for name in of:
            shape = at.shapes[name]
            rows = at.rows(name, np.eye(int(np.prod(shape))))
            parts |= {(name, x): np.reshape(rows[x], (*shape, *shapes[x])) for x in by}
    return _found(question, what, result, parts)


def argument_shapes(case: VariedCase) -> dict[str, Shape]:
    """Return the shapes of the gradients with respect to every argument."""
    return gradient_shapes(case.chain) | {name: x.shape for name, x in case.own.items()}


def _linear(question: Question, case: VariedCase, by: Sequence[str], what: str) -> LinearisedFunction:
    """Return the linearisation of a question.

    Raises:
        StateError: the question does not have one of the arguments.
    """
    require_names(what, by, question.arguments_at(case.chain))
    if question.differentiable is not None:
        question.differentiable(what, case.own)
    return linearised_function(question, case, by)


def _found(question: Question, what: str, result: Any, parts: Mapping[Any, Array]) -> Derivatives:
    """Return the derivatives after checking that they are finite.

    Raises:
        StateError: some are not; the message names them.
    """
    values = np.concatenate([np.zeros(0), *map(np.ravel, _arrays_of(result))])
    finite = np.where(np.isposinf(values), 0.0, values) if question.unlimited else values
    for name, x in {"result": finite, **parts}.items():
        if not np.isfinite(x).all():
            raise StateError(f"{what}: {name}: expected finite numbers, got an overflow; try smaller ones")
    return Derivatives(result, parts)


def finite_derivatives(result: Any, parts: Mapping[Any, Array]) -> Derivatives:
    """Return derivatives that are finite.

    Raises:
        StateError: naming those that are not.
    """
    for name, x in parts.items():
        checks.finite(x, f"derivatives: {' by '.join(name) if isinstance(name, tuple) else name}")
    return Derivatives(result, parts)


def _arrays_of(result: Any) -> list[Any]:
    """Return the arrays of a result, which may be nested in tuples and mappings."""
    if isinstance(result, Frozen):  # its numbers were checked where it was made
        return []
    if isinstance(result, Mapping | tuple):
        parts = result.values() if isinstance(result, Mapping) else result
        return [x for part in parts for x in _arrays_of(part)]
    return [result]


def directions(
    what: str, along: Mapping[str, ArrayLike], shapes: Mapping[str, Shape]
) -> dict[str, Array] | list[dict[str, Array]]:
    """Return a direction in the arguments, or a list of directions if an argument has a leading axis.

    Raises:
        StateError: an argument has a wrong shape, or the numbers of directions differ; the message gives them.
    """
    given = {name: checks.numbers(x, None, name, StateError) for name, x in along.items()}
    counts = set()
    for name, x in given.items():
        if x.shape != shapes[name] and x.shape[1:] != shapes[name]:
            raise StateError(
                f"{what}: {name}: expected shape {checks.shapes_with_rows(shapes[name], 'd')}, got {x.shape}"
            )
        counts |= {len(x)} if x.ndim > len(shapes[name]) else set()
    if len(counts) > 1:
        raise StateError(f"{what}: expected one number of directions, got {', '.join(map(str, sorted(counts)))}")
    if not counts:
        return given
    (count,) = counts
    return [{n: x[k] if x.ndim > len(shapes[n]) else x for n, x in given.items()} for k in range(count)]


def require_names(what: str, names: Any, known: Sequence[str]) -> None:
    """Refuse unknown names, a name that is given twice, and an empty list of names.

    Raises:
        StateError: a name is unknown, or there are none; the message lists the known ones.
    """
    if not checks.is_listed(names) or not isinstance(names, Collection) or not len(names):
        raise StateError(f"{what}: expected some of {', '.join(known)}, got {checks.short(names)}")
    for name in names:
        if not isinstance(name, str) or name not in known:
            raise StateError(f"{what}: no {checks.short(name)}.{checks.did_you_mean(str(name), known)}")
    if len(set(names)) < len(names):
        raise StateError(f"{what}: expected each name once, got {', '.join(names)}")
