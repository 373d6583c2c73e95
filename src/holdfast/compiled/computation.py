"""What machine code computes for a chain: a question, traced on the functions that the reference runs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import holdfast.questions
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, externals, traced, traced_chain, traced_inputs, traced_state
from holdfast.compiler.schedule import External, Schedule
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import TRUNK_BASE_MOTION, Shape, link_parameters, shapes
from holdfast.questions.case import VariedCase
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class Computation:
    """A computation of machine code for chains of one structure.

    Attributes:
        name: its name in the key of the cache; without a name, the traced code serves as the key.
        structure: the structure of the chains.
        externals: the arrays that it reads and writes, by name; those of `inputs` come first.
        schedule: returns its schedule.
        inputs: names of the arrays that a call gives in order.
        by_name: names of those that a call must give by name.
        fixed: the numbers of parameters that no call changes, by name.
        packages: packages whose functions it traces besides those of forward dynamics.
    """

    name: str
    structure: Structure
    externals: Mapping[str, External]
    schedule: Callable[[], Schedule]
    inputs: tuple[str, ...] = ()
    by_name: tuple[str, ...] = ()
    fixed: Mapping[str, Array] = field(default_factory=dict)
    packages: tuple[str, ...] = ()

    @property
    def has_status(self) -> bool:
        """Whether every system has a status, because its equations may have no solution."""
        return "status" in self.externals


def traced_case(question: Question, chain: ClosedChain, x: Given) -> VariedCase:
    """Return the traced arguments of a question."""
    given = (*question.own(chain), *(name for name in question.optional if name in x))
    own = {name: x[name] for name in given}
    return VariedCase(chain, traced_state(chain, x), traced_inputs(chain, x), own)


def structure_of(question: Question, chain: ClosedChain, options: Options) -> Structure:
    """Return the structure of a chain with the options on which a question depends; the others are reset."""
    needs = question.depends_on
    own = Options(
        "auto",
        options.link_inertia and "links" in needs,
        options.link_wrenches and "forces" in needs,
        base_motion=True,
        further=tuple(name for name in question.optional if name in options.further),
        iterations=options.iterations if question.iterative else None,
    )
    by_grasp = "grasps" in needs or _by_bushings(question, chain)
    return Structure(chain, own, by_grasp, "links" in needs, "limits" in needs)


def iterated(question: Question, options: Options) -> Question:
    """Return a question with the number of iterations that the options have."""
    if options.iterations is None:
        return question
    compute: Any = question.compute
    return replace(question, compute=partial(compute, iterations=options.iterations))


def computation(question: Question, chain: ClosedChain, options: Options) -> Computation:
    """Return the computation of a question that needs no linear solve with a status."""
    structure = structure_of(question, chain, options)
    arrays, asked = arrays_of(question, structure), iterated(question, structure.options)

    def outputs(x: Given) -> dict[str, Array]:
        traced_one = traced_chain(structure, x)
        found = asked.compute(traced_case(question, traced_one, x))
        return dict(zip(question.shapes(chain), found, strict=True))

    return Computation(
        question.name + source_key(question),
        structure,
        arrays,
        lambda: traced(arrays, outputs),
        question.inputs,
        tuple(question.by_name(chain)),
    )


def arrays_of(
    question: Question,
    structure: Structure,
    further: Mapping[str, Shape] | None = None,
    fixed: Mapping[str, Array] | None = None,
    found: Mapping[str, Shape] | None = None,
) -> dict[str, External]:
    """Return the arrays that a question's machine code reads and writes.

    Args:
        question: the question.
        structure: the structure of the chain.
        further: the shapes of further inputs, which come behind the question's.
        fixed: the numbers of further parameters.
        found: the shapes of all outputs; by default the question's.
    """
    chain, options = structure.chain, structure.options
    inputs, parameters = [*question.inputs, *(further or {})], list(question.parameters)
    placed = "base_R" in question.parameters
    if options.link_wrenches:
        inputs += ["link_wrench", *(["trunk_link_wrench"] if chain.trunk is not None else ())]
    parameters += link_parameters(chain) if options.link_inertia else ()
    parameters += options.further
    parameters += ("grasp_R", "grasp_p") if _by_bushings(question, chain) else ()
    inputs += question.by_name(chain)
    parameters += ("base_p",) if question.by_place(chain) else ()
    if chain.trunk is not None and placed:
        parameters += [name for name in ("base_R", "base_p") if name not in parameters]
        parameters += TRUNK_BASE_MOTION if "base_twist" in parameters and not chain.floats else ()
    of_fixed = {name: x.shape for name, x in (fixed or {}).items()}
    outputs = question.shapes(chain) if found is None else found
    known = {**shapes(chain), **(further or {}), **of_fixed, **outputs}
    return externals(inputs, [*parameters, *of_fixed], outputs, known)


def _by_bushings(question: Question, chain: ClosedChain) -> bool:
    """Return whether a question depends on a chain's grasps because some of them are bushings."""
    return "bushings" in question.depends_on and bool(chain.bushings)


def source_key(question: Question) -> str:
    """Return a key of the source of a question that is declared outside this library; "" for one of the library."""
    path = getattr(sys.modules.get(question.compute.__module__), "__file__", None)
    if path is None or Path(path).is_relative_to(Path(holdfast.questions.__file__).parents[1]):
        return ""
    import hashlib

    return f"/{hashlib.sha256(Path(path).read_bytes()).hexdigest()}"
