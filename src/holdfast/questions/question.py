"""A question about a chain as one value, declared once, at the foot of the file of its algorithm.

From it follow the derivatives of the reference (`derivatives`), the machine code (`holdfast.compiled`), exported C, JAX
functions, documentation, and the tests that every question must pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_kinds import GraspKind
from holdfast.questions.arrays import (
    ARRAYS,
    CONTACTS,
    DISTRIBUTED,
    FLOATING,
    FLOATING_RESULT,
    LIMITS,
    Row,
    Shape,
    arguments_of,
)
from holdfast.questions.case import VariedCase
from holdfast.spatial.scalar import Array

Dependence = Literal["grasps", "links", "forces", "bushings", "limits", "world"]
Found = Mapping[str, Array]
Show = Callable[[Found], Any]  # the results of one system or a batch -> what a user gets


class ResultPart(NamedTuple):
    """Entries of a result that depend on much the same.

    Attributes:
        entries: of the result, flat.
        arm: the row of the arm to which they belong; None for a trunk.
    """

    entries: slice
    arm: int | None


def _first(chain: ClosedChain) -> Show:
    """Return what shows the only result, which is a number if it has no axes."""

    def shown(found: Found) -> Any:
        (x,) = found.values()
        return x if x.ndim else float(x)

    return shown


def _settled(chain: ClosedChain, given: Found, found: Found) -> Found:
    return found


@dataclass(frozen=True, eq=False)
class Question:
    """A question about a chain, its state and its inputs.

    Attributes:
        name: its name, that of the function that answers it.
        compute: returns the results for a case, in the vocabulary of `spatial.scalar`, so that it runs on floats and
            is traced; after them the arrays of `feasibility`.
        results: the results, in order: names in `ARRAYS`, or rows of the question's own.
        summary: what it returns, as a phrase that begins with a noun.
        inputs: names of the arrays that compiled calls take, in order.
        parameters: names of the run-time parameters of machine code.
        optional: names of those that exist only on request.
        iterative: whether `compute` takes the number of its iterations, `iterations`.
        arguments: names of all arrays by which it can be differentiated, for any chain; none if it cannot.
        by: those by which it is differentiated unless others are requested.
        of: the results whose Jacobian is returned unless others are requested; all if there are none here.
        depends_on: what else decides which machine code it needs: the kinds of the "grasps" and which "limits" they
            have, the inertias of the "links", "forces" that act on links and between bodies, the forces or the energy
            of "bushings", contacts with the "world".
        unlimited: whether a result may be infinite, as a margin without a limit is.
        parts: the parts of a result of a chain, in order; None if it has none. Those of arms in the world depend on
            nothing of other arms.
        of_object: whether parts depend on the object and on their grasps.
        feasibility: further arrays that `compute` returns, by name with their shapes. They are not differentiated, but
            show whether the question has an answer.
        restricted: returns a case in which arguments on which the answer does not depend are constants; it is what is
            differentiated.
        require: refuses inputs, of one system or a batch, that the question does not admit; None if it admits all.
        differentiable: refuses parameters, of one system or a batch, at which there are no derivatives; it takes what
            is asked, for the message. None if there always are some.
        settle: takes the given inputs and the results with the arrays of `feasibility`, of one system or a batch;
            returns the results, and raises a StateError or writes NaN where there is no answer.
        returns: the type of that, for type checkers and documentation.
        shown: returns a function that makes what a user gets of the results for a chain.
    """

    name: str
    compute: Callable[[VariedCase], tuple[Any, ...]]
    results: tuple[str | Row, ...]
    summary: str = ""
    inputs: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    iterative: bool = False
    arguments: tuple[str, ...] = ()
    by: tuple[str, ...] = ()
    of: tuple[str, ...] = ()
    depends_on: tuple[Dependence, ...] = ("links",)
    unlimited: bool = False
    parts: Callable[[ClosedChain, str], Sequence[ResultPart]] | None = None
    of_object: bool = False
    feasibility: Callable[[ClosedChain], Mapping[str, Shape]] = lambda chain: {}
    restricted: Callable[[VariedCase], VariedCase] = lambda case: case
    require: Callable[[ClosedChain, Found], None] | None = None
    differentiable: Callable[[str, Found], None] | None = None
    settle: Callable[[ClosedChain, Found, Found], Found] = _settled
    returns: str = "Array"
    shown: Callable[[ClosedChain], Show] = _first

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle a declared question: by its name."""
        return _declared, (self.name,)

    @property
    def rows(self) -> dict[str, Row]:
        """The rows of the results, by name."""
        rows = [ARRAYS[row] if isinstance(row, str) else row for row in self.results]
        return {row.name: row for row in rows}

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the results."""
        return tuple(row if isinstance(row, str) else row.name for row in self.results)

    @property
    def shows_one(self) -> bool:
        """Whether a user gets its only result as it is, an array or a number."""
        return self.shown is _first

    def shapes(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of the results that a chain has, by name, and then of the arrays of `feasibility`."""
        own = {name: row.shape(chain) for name, row in self.rows.items() if row.exists(chain)}
        return {**own, **self.feasibility(chain)}

    def names_at(self, chain: ClosedChain) -> tuple[str, ...]:
        """Return the names of the results that a chain has."""
        return tuple(name for name, row in self.rows.items() if row.exists(chain))

    def shape(self, chain: ClosedChain, result: str) -> Shape:
        """Return the shape of a result."""
        return self.rows[result].shape(chain)

    def arguments_at(self, chain: ClosedChain) -> tuple[str, ...]:
        """Return the names of its arguments that exist for a chain."""
        return tuple(name for name in self.arguments if name in (*self.own(chain), *arguments_of(chain)))

    def parts_of(self, chain: ClosedChain, result: str) -> Sequence[ResultPart]:
        """Return the parts of a result of a chain; one if it has none."""
        whole = ResultPart(slice(0, math.prod(self.shape(chain, result))), None)
        return [whole] if self.parts is None else self.parts(chain, result)

    def by_place(self, chain: ClosedChain) -> bool:
        """Return whether it depends on where this chain's arms and object are because of forces between them."""
        return "forces" in self.depends_on and bool(chain.springs or chain.bushings)

    def by_name(self, chain: ClosedChain) -> list[str]:
        """Return the inputs that only some chains have; calls give them by name.

        They are the pose of a floating base, its twist and acceleration if other velocities or accelerations are among
        the inputs, and the pose and twist of the object if forces depend on them.
        """
        found = ["object_pose", "object_twist"] if self.by_place(chain) else []
        if chain.floats and "base_R" in self.parameters:
            found += FLOATING if {"qd", "object_twist"} & {*self.inputs} else FLOATING[:1]
            found += [FLOATING_RESULT] if "qdd" in self.inputs else []
        return found

    def own(self, chain: ClosedChain) -> tuple[str, ...]:
        """Return the arrays that it is given besides the state, the inputs and the parameters of every chain."""
        given = (
            name for name in (*self.inputs, *self.by_name(chain)) if not ARRAYS[name].field or name == FLOATING_RESULT
        )
        return *given, *(name for name in self.parameters if name in (LIMITS, CONTACTS, "about", *DISTRIBUTED))


QUESTIONS: dict[str, Question] = {}  # all that machine code answers; see `derivatives.declare`


def _declared(name: str) -> Question:
    return QUESTIONS[name]


def by_joints(chain: ClosedChain, result: str) -> list[ResultPart]:
    """Return the parts, by arms, of a result with one entry for each joint."""
    rows = {name: row for row, name in enumerate(chain.arms)}
    return [ResultPart(entries, rows.get(name)) for name, entries in chain.joints.items()]


def arm_parts(chain: ClosedChain, size: Callable[[int, GraspKind | None], int]) -> dict[str, slice]:
    """Return each arm's entries of a result that lists the arms' parts one after the other.

    Args:
        chain: the chain.
        size: returns the number of entries of an arm, of its number of joints and the kind of its grasp.
    """
    found, end = {}, 0
    for name, arm in chain.arms.items():
        kind = chain.grasps[name].of_kind if name in chain.grasps else None
        begin, end = end, end + size(arm.joint_count, kind)
        found[name] = slice(begin, end)
    return found


def of_arms(size: Callable[[int, GraspKind | None], int]) -> Callable[[ClosedChain], Shape]:
    """Return the shape of a result that lists the arms' parts one after the other; see `arm_parts`."""
    return lambda chain: (max((part.stop for part in arm_parts(chain, size).values()), default=0),)


def by_arm(shape: Callable[[int], Shape], show: Callable[[Array], Any] = lambda x: x) -> Callable[[ClosedChain], Show]:
    """Return what shows the arms' parts of a single result by arm name.

    Args:
        shape: the shape of an arm's part, of its number of joints.
        show: what a user gets of a part, (..., *shape).
    """

    def of_chain(chain: ClosedChain) -> Show:
        parts = arm_parts(chain, lambda N, _: math.prod(shape(N)))
        rows = [(name, parts[name], shape(arm.joint_count)) for name, arm in chain.arms.items()]

        def shown(found: Found) -> dict[str, Any]:
            (x,) = found.values()
            lead = x.shape[:-1]
            return {name: show(x[..., part].reshape((*lead, *of_arm))) for name, part, of_arm in rows}

        return shown

    return of_chain
