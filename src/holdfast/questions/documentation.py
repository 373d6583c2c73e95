"""Documentation of compiled questions, made from the rows of their arrays: docstrings, type stubs, and a page."""

from __future__ import annotations

import textwrap
from collections.abc import Container, Iterable, Mapping

from holdfast.questions.arrays import ARRAYS, BASE_MOTION, INTERNAL, POSE_ARRAYS, TRUNK_BASE_MOTION, Row
from holdfast.questions.question import QUESTIONS, Question

WIDTH = 118
_POSES = {rotations: pose for pose, (rotations, _) in POSE_ARRAYS.items()}  # what users pass for them


def docstring(question: Question) -> str:
    """Return the docstring of a compiled question."""
    lines = [f"Return {question.summary}.", ""]
    lines += ["Args:", *_entries((name, _given(ARRAYS[name])) for name in question.inputs)]
    further = [
        ("out", "an earlier answer with arrays, to be overwritten."),
        ("threads", "how many threads share a batch; None: as many as make it faster."),
        ("**parameters", f"for this call, {_parameters(question)}"),
    ]
    lines += [*_entries(further), "", "Returns:", *_wrapped(_results(question), 4), "", "Raises:"]
    lines += _entries([("StateError", "A name, shape or number is wrong, or the question has no answer.")])
    return "\n".join(lines)


def parameters_of(question: Question) -> list[str]:
    """Return the names by which users pass a question's run-time parameters."""
    named = dict.fromkeys(_POSES.get(name, name) for name in question.parameters)
    return [name for name in named if name not in INTERNAL]


def _given(row: Row) -> str:
    shape = _shape(row)
    many = f"(batch, {shape[1:].removesuffix(',)').removesuffix(')')})"
    return f"{shape} or {many} {row.text.removeprefix(shape).strip()}."


def _parameters(question: Question) -> str:
    names, also = parameters_of(question), []
    if "links" in question.depends_on:
        also.append("those of the links, if `compile` was asked for them")
    if "base_R" in question.parameters:
        also.append("with a floating base, required, floating_pose and what moves with it")
    if {*BASE_MOTION} & {*question.parameters}:
        also.append(f"with a trunk that stands {' and '.join(_trunk_motion(question))}")
    listed = f"any of {', '.join(f'{name} {_shape(ARRAYS[name])}' for name in names)}" if names else "none"
    return f"{'; '.join([listed, *also])}."


def _trunk_motion(question: Question) -> Iterable[str]:
    pairs = zip(BASE_MOTION, TRUNK_BASE_MOTION, strict=True)
    return (of_trunk for of_arm, of_trunk in pairs if of_arm in question.parameters)


def _shape(row: Row) -> str:
    return row.text[: row.text.index(")") + 1] if row.text.startswith("(") else "()"


def _results(question: Question) -> str:
    rows = [row for row in question.rows.values() if not row.of]
    texts = [row.text if len(rows) == 1 else f"{row.name}: {row.text}" for row in rows]
    form = "a number" if question.returns == "Any" else question.returns
    return f"{'; '.join(texts)}. As {form}, with a leading axis for a batch."


def _entries(entries: Iterable[tuple[str, str]]) -> list[str]:
    return [line for name, text in entries for line in _wrapped(f"{name}: {text}", 4, 8)]


def _wrapped(text: str, indent: int, further: int | None = None) -> list[str]:
    rest = " " * (indent if further is None else further)
    return textwrap.wrap(text, WIDTH - 8, initial_indent=" " * indent, subsequent_indent=rest)


def class_name(question: Question) -> str:
    """Return the name of a question's class in the stub, such as `_KineticEnergy`."""
    return f"_{''.join(part.capitalize() for part in question.name.split('_'))}"


def stub() -> str:
    """Return the stub of `holdfast.compiled.answers`: the questions as attributes of compiled chains."""
    lines = [
        '"""The questions that a compiled chain answers; made by `make stubs` from `holdfast.questions`."""',
        "",
        "from typing import Any",
        "",
        "from holdfast.compiled.function import Function",
        "from holdfast.compiled.result import CompiledResult",
        "from holdfast.dynamics.consistency import GraspResidual",
        "from holdfast.dynamics.kinematics import Frames",
        "from holdfast.forces.elastic_distribution import ElasticDistribution",
        "from holdfast.forces.margins import JointMargins",
        "from holdfast.spatial.scalar import Array",
        "",
    ]
    for _, question in sorted(QUESTIONS.items()):
        arguments = ", ".join(f"{name}: Any" for name in question.inputs)
        body = textwrap.indent(f'"""{docstring(question)}\n"""', " " * 8)
        lines += [
            f"class {class_name(question)}(Function):",
            "    def __call__(",
            f"        self, {arguments}, *, out: Any = None, threads: int | None = None, **parameters: Any",
            f"    ) -> {question.returns}:",
            body,
            "",
        ]
    lines += ["class Answers:", '    """The questions as attributes."""', ""]
    lines += [f"    {name}: {class_name(question)}" for name, question in sorted(QUESTIONS.items())]
    return "\n".join([*lines, ""])


# Sphinx drops the first parameter of what it takes for a method.
_CALLS = ("vjp(*given, by=..., **cotangents)", "jvp(*given, along)", "jacobian(*given, of=..., by=...)")


def page(public: Mapping[str, str], differentiable: Container[str]) -> str:
    """Return the page of all questions, in Markdown.

    Args:
        public: public names of the functions that answer them on floats, by question.
        differentiable: the questions whose functions on floats have derivatives.
    """
    lines = [
        "# Questions",
        "",
        "A question about a chain is answered by a function, such as `hf.dynamics.kinetic_energy(chain, state)`, and",
        "by a compiled chain, for one system or a batch: `fast.kinetic_energy(q, qd, object_pose, object_twist)`.",
        "Both have `.vjp`, `.jvp` and `.jacobian` by the arguments in the last row; compiled ones also have `.bind`",
        "and `.export`. `make stubs` makes this page.",
    ]
    for name, question in sorted(QUESTIONS.items()):
        returned = [f"`{row.name}`: {row.text}" for row in question.rows.values()]
        rows = {
            "takes": "<br>".join(f"`{given}`: {ARRAYS[given].text}" for given in question.inputs),
            "parameters": ", ".join(f"`{given}`" for given in parameters_of(question)) or "none",
            "results": "<br>".join(returned),
            "returns": f"`{question.returns}`",
            "derivatives by": ", ".join(f"`{given}`" for given in question.arguments) or "none",
        }
        lines += [
            "",
            f"## {name}",
            "",
            f"{question.summary[0].upper()}{question.summary[1:]}.",
            "",
            "| | |",
            "|---|---|",
        ]
        lines += [f"| {what} | {text.replace('|', chr(92) + '|')} |" for what, text in rows.items()]
        if (path := public.get(name)) is not None:
            calls = _CALLS if name in differentiable else ()
            documented = [f".. autofunction:: {path}", *(f".. automethod:: {path}.{call}" for call in calls)]
            lines += ["", "```{eval-rst}", *documented, "```"]
    return "\n".join([*lines, ""])
