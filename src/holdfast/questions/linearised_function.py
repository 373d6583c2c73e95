"""Linearisation of questions that need no linear solve, by running their code on numbers that record operations.

Such a question takes a `VariedCase` and returns arrays. Its linearisation (`spatial.differentiation`) gives gradients
in reverse mode and rates in forward mode. The names of the arguments and the derivatives by poses are as in
`forward_dynamics_vjp`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from holdfast.questions.arrays import POSES, Shape
from holdfast.questions.case import VariedCase
from holdfast.questions.question import Question
from holdfast.spatial.differentiation import bare, linearised
from holdfast.spatial.linear import Linear, arrays_of
from holdfast.spatial.pose import by_motions
from holdfast.spatial.scalar import Array, concatenate, each
from holdfast.spatial.symmetric import symmetric_part
from holdfast.spatial.vector import skew


class LinearisedFunction(NamedTuple):
    """The linearisation of a function in some of its arguments.

    Attributes:
        function: the function.
        case: the case at which it is linearised.
        names: names of the arguments.
        numbers: the numbers that make up these arguments, by name.
        linear: the linearisation in `numbers`.
        results: what the function returns there, by name, also what is not differentiated.
    """

    function: Question
    case: VariedCase
    names: tuple[str, ...]
    numbers: Mapping[str, Array]
    linear: Linear
    results: Mapping[str, Array]

    @property
    def _results(self) -> tuple[str, ...]:
        return self.function.names_at(self.case.chain)

    @property
    def shapes(self) -> dict[str, Shape]:
        """Shapes of the results, by name."""
        return {name: of.shape for name, of in zip(self._results, self.linear.results, strict=True)}

    def gradient(self, cotangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the gradients of sum(cotangent . result) by argument; for poses with respect to [turn; shift]."""
        given = [cotangents.get(name, np.zeros(shape)) for name, shape in self.shapes.items()]
        return self._by_arguments(self.linear.gradient(*given))

    def rows(self, result: str, units: Array) -> dict[str, Array]:
        """Return the gradients of every entry of a result, flat: its Jacobian, (entries, *shape) by argument.

        Args:
            result: its name.
            units: (m, m) identity, m at least the size of the result's parts; as numbers, so that rows are alike.
        """
        found = []
        for entries, _ in self.function.parts_of(self.case.chain, result):
            count = entries.stop - entries.start
            if not count:  # an anchor has no torques
                continue
            linear, varied = self.linear.of_entries(self._results.index(result), entries)
            row = gradient_of(linear)
            rows = each(row, units[:count, :count]) if count > 1 else [row(np.ones(1))]
            found += [self._row(varied, x) for x in rows]
        if not found:  # a result without entries, such as the torques of anchors alone
            return {name: np.zeros((0, *x.shape)) for name, x in self._row((), np.zeros(0)).items()}
        return {
            name: concatenate(row[name].ravel() for row in found).reshape(len(found), *found[0][name].shape)
            for name in self.names
        }

    def _row(self, varied: Sequence[int], entries: Array) -> dict[str, Array]:
        """Return gradients of which the entries at some places are given, the others zero."""
        flat: list[Any] = [0.0] * sum(x.size for x in self.numbers.values())
        for place, x in zip(varied, entries.tolist(), strict=True):
            flat[place] = x
        return self._by_arguments(arrays_of(flat, [x.shape for x in self.numbers.values()]))

    def _by_arguments(self, gradients: Sequence[Array]) -> dict[str, Array]:
        """Return gradients by the arguments, of those by the numbers that they are made of."""
        found = dict(zip(self.numbers, gradients, strict=True))
        for name in self.names:
            if name in POSES:
                R, p = _parts_of(name)
                found[name] = by_motions(found[R], self.numbers[R], found[p])
            elif name.endswith("inertia"):
                found[name] = symmetric_part(found[name])
        return {name: found[name] for name in self.names}

    def rates(self, tangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the rates of the results for given rates of the arguments; missing arguments are constant."""
        given: dict[str, Array] = {name: np.zeros(x.shape) for name, x in self.numbers.items()}
        for name, tangent in tangents.items():
            if name in POSES:
                R, p = _parts_of(name)
                turns = tangent[..., :3].reshape(-1, 3)
                spun = np.array([skew(turn) for turn in turns]).reshape(self.numbers[R].shape)
                given |= {R: spun @ self.numbers[R], p: tangent[..., 3:]}
            else:
                given[name] = tangent
        return dict(zip(self._results, self.linear.rates(*given.values()), strict=True))


def gradient_of(linear: Linear) -> Callable[[Array], Array]:
    """Return the gradient of a function of one array and one result as a function of the cotangent."""
    return lambda cotangent: linear.gradient(cotangent)[0]


def linearised_function(function: Question, case: VariedCase, by: Sequence[str]) -> LinearisedFunction:
    """Return the linearisation of a function in some of its arguments."""
    names = tuple(dict.fromkeys(by))
    numbers = case.numbers([part for name in names for part in _parts_of(name)])

    results: dict[str, Array] = {}

    def of(*given: Array) -> tuple[Any, ...]:
        found = function.compute(function.restricted(case.varied(dict(zip(numbers, given, strict=True)))))
        results.update({name: bare(x) for name, x in zip(function.shapes(case.chain), found, strict=True)})
        return found[: len(function.names_at(case.chain))]

    return LinearisedFunction(function, case, names, numbers, linearised(of, *numbers.values()), results)


def _parts_of(name: str) -> tuple[str, ...]:
    """Return the names of the numbers that make up an argument."""
    return (f"{name.removesuffix('_pose')}_R", f"{name.removesuffix('_pose')}_p") if name in POSES else (name,)
