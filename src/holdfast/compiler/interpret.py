"""A Python interpreter of programs and schedules, which defines what they mean.

Machine code must agree with it bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from holdfast.compiler import schedule as schedules
from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.errors import CompileError
from holdfast.compiler.lowering import lowered
from holdfast.compiler.program import Program
from holdfast.compiler.schedule import Call, Schedule
from holdfast.compiler.stage import Wire


def interpret(program: Program, *inputs: object, fused: bool = True) -> tuple[np.ndarray, ...]:
    """Return what a program computes for one system.

    Args:
        program: the program.
        inputs: one array for each of its input shapes.
        fused: whether products and sums are fused to fma operations (`fuse`).
    """
    program = lowered(program, fused)
    arrays = [np.asarray(x, dtype=float) for x in inputs]
    if tuple(a.shape for a in arrays) != program.input_shapes:
        raise CompileError(
            f"interpret: expected arrays of shapes {program.input_shapes}, got {tuple(a.shape for a in arrays)}"
        )
    found = _run(program, [float(x) for a in arrays for x in a.flat])
    return tuple(np.array(x, dtype=float).reshape(o.shape) for x, o in zip(found, program.outputs, strict=True))


def _run(program: Program, given: list[float]) -> list[list[float]]:
    """Return the entries of every output."""
    values: list[float] = []
    for kind, args, value in program.instructions:
        if kind == "input":
            value = given[len(values)]
        elif kind != "constant":
            value = OPERATIONS[kind](*(values[a] for a in args))
        values.append(value)
    return [[values[p] for p in output.places] for output in program.outputs]


def interpret_schedule(schedule: Schedule, given: Mapping[str, object]) -> dict[str, np.ndarray]:
    """Return the outputs of a schedule for one system, by name.

    Args:
        schedule: the schedule.
        given: inputs and parameters by name.
    """
    numbers = {name: [math.nan] * e.size for name, e in schedule.externals.items()}
    for name in schedule.names("input", "parameter"):
        numbers[name] = [float(x) for x in np.asarray(given[name], dtype=float).flat]
    numbers |= {name: [math.nan] * (i.items * i.size) for name, i in schedule.internals.items()}
    memory: dict[tuple[str, int, int], list[float]] = {}
    for call in (*schedule.prepare, *schedule.calls):
        for item in call.items:
            _call(schedule, call, item, numbers, memory)
    _guard(schedule, numbers)
    return {name: np.array(numbers[name]).reshape(schedule.externals[name].shape) for name in schedule.names("output")}


def _call(
    schedule: Schedule,
    call: Call,
    item: int,
    numbers: dict[str, list[float]],
    memory: dict[tuple[str, int, int], list[float]],
) -> None:
    """Run one phase of a stage for one item."""
    group = schedule.groups[call.group]
    stage = group.stage

    def entries(wire: Wire, size: int) -> slice:
        internal = schedule.internals.get(wire.array)
        start = wire.places[item] * (internal.size if internal else 1)
        return slice(start, start + size)

    given: list[float] = []
    for k, phase in enumerate(stage.inputs):
        for port in phase:
            wire = group.wires[port]
            size = stage.size(port)
            given += numbers[wire.array][entries(wire, size)] if k <= call.phase else [math.nan] * size
    for k in range(call.phase):
        given += memory.get((call.group, item, k), [])  # a phase without memory may not have been called at all
    *results, memory[call.group, item, call.phase] = _run(stage.pieces.programs[call.phase], given)
    for port, result in zip(stage.outputs[call.phase], results, strict=True):
        if port in group.wires:
            wire = group.wires[port]
            numbers[wire.array][entries(wire, len(result))] = result


def _guard(schedule: Schedule, numbers: dict[str, list[float]]) -> None:
    """Set the status if a guarded output is not finite, and replace guarded outputs of bad status by NaN."""
    if schedule.status is None:
        return
    if not all(math.isfinite(x) for name in schedule.guarded for x in numbers[name]):
        numbers[schedule.status] = [schedules.NOT_FINITE]
    if numbers[schedule.status][0] >= schedules.FIRST_BAD:
        for name in schedule.guarded:
            numbers[name] = [math.nan] * len(numbers[name])
