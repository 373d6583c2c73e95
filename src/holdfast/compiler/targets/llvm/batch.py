"""The LLVM module that runs a schedule for a batch, one system in each lane.

    void batch(i64 *table, i64 begin, i64 end, i64 count, i64 repeats, double *arena)

The function runs the blocks begin <= b < end, each of `lanes` systems; if the schedule has carried arrays, each block
is run `repeats` times in a row. `table` holds the address and the stride of every external array in order; the stride
is the number of doubles from one system to the next, or 0 if all systems share the array. Lanes beyond the last
system repeat it: they compute and write the same bits again, so a tail needs no code of its own.
"""

from __future__ import annotations

import math

from holdfast.compiler.schedule import FIRST_BAD, NOT_FINITE, Role, Schedule
from holdfast.compiler.targets.layout import Layout
from holdfast.compiler.targets.llvm.functions import constant, declarations, number_type
from holdfast.compiler.targets.llvm.module import Module
from holdfast.compiler.targets.llvm.templates import filled
from holdfast.compiler.targets.llvm.transposition import transpositions

_WAYS: dict[Role, tuple[str, ...]] = {
    "input": ("to_lanes",),
    "parameter": ("to_lanes",),
    "output": ("from_lanes",),
    "carried": ("to_lanes", "from_lanes"),
}


def batch_module(schedule: Schedule, lanes: int) -> tuple[str, int]:
    """Return the module's source and the number of doubles of working memory that a thread needs."""
    layout = Layout(schedule, lanes, systems=lanes)
    module = Module(layout)
    addresses: list[str] = []
    alike, strides = [], "0"
    for k, (name, external) in enumerate(schedule.externals.items()):
        addresses += [
            f"  %address{k} = getelementptr ptr, ptr %table, i64 {2 * k}",
            f"  %external{k} = load ptr, ptr %address{k}",
            f"  %at{k} = getelementptr i64, ptr %table, i64 {2 * k + 1}",
            f"  %stride{k} = load i64, ptr %at{k}",
            f"  %lanes{k} = getelementptr double, ptr %arena, i64 {layout.external_areas[name].start}",
        ]
        if external.role == "parameter":
            alike.append(f"  %strides{k} = or i64 {strides}, %stride{k}")
            strides = f"%strides{k}"
    prepare = _moved("to_lanes", schedule, "parameter")
    module.calls(schedule.prepare, prepare, "prepare")
    compute = [*_moved("to_lanes", schedule, "input"), *_moved("to_lanes", schedule, "carried")]
    if schedule.names("carried"):
        repeated: list[str] = []
        module.calls(schedule.calls, repeated, "repeat")
        compute.append(filled("batch_repeated", calls=repeated))
    else:
        module.calls(schedule.calls, compute, "compute")
    if schedule.status is not None:
        compute.append(_status(schedule, schedule.status, lanes))
    compute += [*_moved("from_lanes", schedule, "output"), *_moved("from_lanes", schedule, "carried")]
    moves = [(way, e.size) for e in schedule.externals.values() for way in _WAYS[e.role] if e.size]
    declared = [*declarations(lanes), *transpositions(moves, lanes)]
    if schedule.status is not None:
        nan = constant(math.nan, lanes)
        values = {"lanes": lanes, "T": number_type(lanes), "align": 8 * lanes, "nan": nan, "zero": constant(0.0, lanes)}
        declared.append(filled("batch_guard", **values))
    function = filled(
        "batch",
        lanes=lanes,
        scratch=layout.total,
        addresses=addresses + alike,
        strides=strides,
        prepare=prepare,
        compute=compute,
    )
    return "\n".join([*declared, *module.tables, *module.functions, function]), layout.total + module.scratch


def _moved(function: str, schedule: Schedule, role: Role) -> list[str]:
    return [
        f"  call void @{function}.{external.size}(ptr %external{k}, i64 %stride{k}, i64 %first, i64 %last,"
        f" ptr %lanes{k})"
        for k, external in enumerate(schedule.externals.values())
        if external.role == role and external.size
    ]


def _status(schedule: Schedule, status: str, lanes: int) -> str:
    """Return the code that sets the status of systems with non-finite results and blanks results of bad status."""
    T, zero = number_type(lanes), constant(0.0, lanes)
    index = {name: k for k, name in enumerate(schedule.externals)}
    guarded = [(index[name], schedule.externals[name].size) for name in schedule.guarded]
    sums: list[str] = []
    total = zero
    for k, size in guarded:
        sums.append(f"  %sum{k} = call {T} @differences(ptr %lanes{k}, i64 {size}, {T} {total})")
        total = f"%sum{k}"
    return filled(
        "batch_status",
        lanes=lanes,
        T=T,
        align=8 * lanes,
        zero=zero,
        sums=sums,
        total=total,
        status=f"%lanes{index[status]}",
        not_finite=constant(NOT_FINITE, lanes),
        first_bad=constant(FIRST_BAD, lanes),
        blank=[f"  call void @blank(ptr %lanes{k}, i64 {size}, <{lanes} x i1> %bad)" for k, size in guarded],
    )
