"""Derivatives of the functions that solve nothing: each is a text that runs on numbers which record their making.

A function's text takes a `VariedCase` and returns arrays. Made linear (`spatial.differentiation`) it gives gradients
backward, rates forward, and a Jacobian by one gradient a row; what poses turn by and what arguments are called is as
in `forward_dynamics_vjp`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.forward_derivatives import POSES, symmetric
from holdfast.dynamics.closed.pose_tangents import by_motions
from holdfast.dynamics.derivatives import Derivatives, directions, gradient_shapes, require_names, with_link_wrenches
from holdfast.dynamics.varied_case import VariedCase
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.differentiation import linearised
from holdfast.spatial.linear import Linear
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import skew
from holdfast.state import Inputs, State

Shape = tuple[int, ...]


class Text(NamedTuple):
    """A function as it is differentiated.

    Attributes:
        name: the function's.
        arguments: what it depends on.
        results: names of what it returns.
        of: the text.
        unlimited: whether a result may be infinite, where nothing limits it.
    """

    name: str
    arguments: tuple[str, ...]
    results: tuple[str, ...]
    of: Callable[[VariedCase], tuple[Any, ...]]
    unlimited: bool = False


class LinearText(NamedTuple):
    """A text made linear at a case in some of its arguments.

    Attributes:
        text: the text.
        case: where.
        names: the arguments.
        numbers: what these are made of, by name.
        linear: the text made linear in `numbers`.
    """

    text: Text
    case: VariedCase
    names: tuple[str, ...]
    numbers: Mapping[str, Array]
    linear: Linear

    @property
    def shapes(self) -> dict[str, Shape]:
        """Of the results, by name."""
        return {name: of.shape for name, of in zip(self.text.results, self.linear.results, strict=True)}

    def gradient(self, cotangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the gradients of sum(cotangent . result) by the arguments; of poses by [turn; shift]."""
        bars = [cotangents.get(name, np.zeros(shape)) for name, shape in self.shapes.items()]
        found = dict(zip(self.numbers, self.linear.gradient(*bars), strict=True))
        for name in self.names:
            if name in POSES:
                R, p = _parts_of(name)
                found[name] = by_motions(found[R], self.numbers[R], found[p])
            elif name.endswith("inertia"):
                found[name] = symmetric(found[name])
        return {name: found[name] for name in self.names}

    def rates(self, tangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return how fast the results change while the arguments do, all of which are given."""
        given: dict[str, Array] = {}
        for name in self.names:
            if name in POSES:
                R, p = _parts_of(name)
                turns = tangents[name][..., :3].reshape(-1, 3)
                spun = np.array([skew(turn) for turn in turns]).reshape(self.numbers[R].shape)
                given |= {R: spun @ self.numbers[R], p: tangents[name][..., 3:]}
            else:
                given[name] = tangents[name]
        return dict(zip(self.text.results, self.linear.rates(*[given[name] for name in self.numbers]), strict=True))


def case_of(chain: ClosedChain, state: State, inputs: Inputs | None, own: Mapping[str, Array]) -> VariedCase:
    """Return what a text is given."""
    return VariedCase(chain, state, with_link_wrenches(chain, inputs), own)


def text_vjp(
    text: Text, case: VariedCase, result: Any, by: Sequence[str], cotangents: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return gradients of sum(cotangent . result) by some arguments; a few times the text's cost."""
    what = f"{text.name}_vjp"
    require_names(what, cotangents, text.results)
    with np.errstate(all="ignore"):
        at = linear_text(text, case, by, what)
        bars = {name: checks.numbers(x, at.shapes[name], name, StateError) for name, x in cotangents.items()}
        return _found(text, what, result, at.gradient(bars))


def text_jvp(text: Text, case: VariedCase, result: Any, along: Mapping[str, ArrayLike]) -> Derivatives:
    """Return how fast the results change while arguments do, in one direction or several."""
    what = f"{text.name}_jvp"
    checks.instance(along, Mapping, f"{what}: along", StateError)
    with np.errstate(all="ignore"):
        at = linear_text(text, case, tuple(along), what)
        given = directions(what, along, argument_shapes(case))
        if isinstance(given, dict):
            return _found(text, what, result, at.rates(given))
        found = [at.rates(one) for one in given]
    parts = {name: [one[name] for one in found] for name in text.results}
    return _found(
        text, what, result, {name: np.reshape(x, (len(given), *at.shapes[name])) for name, x in parts.items()}
    )


def text_jacobian(text: Text, case: VariedCase, result: Any, of: Sequence[str], by: Sequence[str]) -> Derivatives:
    """Return the Jacobian, one gradient a row."""
    what = f"{text.name}_jacobian"
    require_names(what, of, text.results)
    parts: dict[tuple[str, str], Array] = {}
    with np.errstate(all="ignore"):
        at, shapes = linear_text(text, case, by, what), argument_shapes(case)
        for name in of:
            shape = at.shapes[name]
            rows = [at.gradient({name: e.reshape(shape)}) for e in np.eye(int(np.prod(shape)))]
            parts |= {(name, x): np.reshape([row[x] for row in rows], (*shape, *shapes[x])) for x in by}
    return _found(text, what, result, parts)


def linear_text(text: Text, case: VariedCase, by: Sequence[str], what: str) -> LinearText:
    """Return a text made linear.

    Raises:
        StateError: an argument that it does not depend on.
    """
    require_names(what, by, text.arguments)
    names = tuple(dict.fromkeys(by))
    numbers = case.numbers([part for name in names for part in _parts_of(name)])

    def of(*given: Array) -> tuple[Any, ...]:
        return text.of(case.varied(dict(zip(numbers, given, strict=True))))

    return LinearText(text, case, names, numbers, linearised(of, *numbers.values()))


def require_no_trunk(what: str, chain: ClosedChain) -> None:
    """Refuse a chain whose derivatives are not there yet.

    Raises:
        MethodNotApplicable: saying why.
    """
    checks.instance(chain, ClosedChain, "chain")
    if chain.trunk is not None:
        raise MethodNotApplicable(f"{what}: derivatives of a chain with a trunk are not there yet")


def argument_shapes(case: VariedCase) -> dict[str, Shape]:
    """Return the shapes of gradients by every argument."""
    return gradient_shapes(case.chain) | {name: x.shape for name, x in case.own.items()}


def _found(text: Text, what: str, result: Any, parts: Mapping[Any, Array]) -> Derivatives:
    """Return derivatives that are finite.

    Raises:
        StateError: naming those that are not.
    """
    finite = np.where(np.isposinf(result), 0.0, result) if text.unlimited else result
    for name, x in {"result": finite, **parts}.items():
        if not np.isfinite(x).all():
            raise StateError(f"{what}: {name}: expected finite numbers, got an overflow; try smaller ones")
    return Derivatives(result, parts)


def _parts_of(name: str) -> tuple[str, ...]:
    """Return the numbers that an argument is made of."""
    return (f"{name.removesuffix('_pose')}_R", f"{name.removesuffix('_pose')}_p") if name in POSES else (name,)
