"""The LLVM module that runs a schedule for a batch, one system in each lane.

    void batch(i64 *table, i64 begin, i64 end, i64 count, i64 repeats, double *arena)

The function runs the blocks begin <= b < end, each of `lanes` systems; if the schedule has carried arrays, each block
is run `repeats` times in a row. `table` holds the address and the stride of every external array in order; the stride
is the number of doubles from one system to the next, or 0 if all systems share the array. Lanes beyond the last
system repeat it: they compute and write the same bits again, so a tail needs no code of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from holdfast.compiler.schedule import FIRST_BAD, NOT_FINITE, ExternalRole, Schedule
from holdfast.compiler.targets.layout import Layout
from holdfast.compiler.targets.llvm.functions import Module, constant, declarations, filled, number_type
from holdfast.compiler.targets.llvm.transposition import transpositions

_ROW = 64  # results of so many numbers go past the caches,
_LARGE = 2**17  # if they are so many doubles in all: memory then need not be read before it is written

_WAYS: dict[ExternalRole, tuple[str, ...]] = {
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
        if name in schedule.guarded and external.size >= _ROW:
            addresses.append(
                filled("batch_streamed", k=k, size=external.size, lanes=lanes, mask=lanes - 1, large=_LARGE)
            )
        if external.role == "parameter":
            alike.append(f"  %strides{k} = or i64 {strides}, %stride{k}")
            strides = f"%strides{k}"
    prepare = _moved("to_lanes", schedule, "parameter")
    module.calls(schedule.prepare, prepare, "prepare")
    compute = [*_moved("to_lanes", schedule, "input"), *_moved("to_lanes", schedule, "carried")]
    guarded = [name for name in schedule.guarded if schedule.externals[name].size]
    if schedule.names("carried"):
        repeated: list[str] = []
        module.calls(schedule.calls, repeated, "repeat")
        compute.append(filled("batch_repeated", calls=repeated))
        long = []
    else:
        last, label = _last_calls(schedule), "compute"
        long = [name for name in guarded if schedule.externals[name].size >= _ROW and name in last]
        for k, call in enumerate(schedule.calls):
            label = module.calls([call], compute, label)
            compute += _sums(schedule, [name for name in long if last.get(name) == k], lanes)
    if schedule.status is not None:
        compute += _sums(schedule, [name for name in guarded if name not in long], lanes)
        compute.append(_status(schedule, schedule.status, guarded, lanes))
    compute += [*_moved("from_lanes", schedule, "output", but=guarded), *_moved("from_lanes", schedule, "carried")]
    moves = [(way, e.size) for e in schedule.externals.values() for way in _WAYS[e.role] if e.size]
    sizes = [schedule.externals[name].size for name in guarded]
    moves += [("checked", size) for size in sizes] + [("streamed", size) for size in sizes if size >= _ROW]
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


def _moved(function: str, schedule: Schedule, role: ExternalRole, but: Sequence[str] = ()) -> list[str]:
    return [
        f"  call void @{function}.{external.size}{_arguments(k)}"
        for k, (name, external) in enumerate(schedule.externals.items())
        if external.role == role and external.size and name not in but
    ]


def _arguments(k: int) -> str:
    return f"(ptr %external{k}, i64 %stride{k}, i64 %first, i64 %last, ptr %lanes{k})"


def _last_calls(schedule: Schedule) -> dict[str, int]:
    """Return which call writes to an array last, for arrays that are written to."""
    found: dict[str, int] = {}
    for k, call in enumerate(schedule.calls):
        group = schedule.groups[call.group]
        found |= {group.wires[port].array: k for port in group.stage.outputs[call.phase]}
    return found


def _sums(schedule: Schedule, names: Sequence[str], lanes: int) -> list[str]:
    """Return the code that copies results from lanes while the caches hold them, and sums up x - x on the way."""
    lines = []
    for k, (name, external) in enumerate(schedule.externals.items()):
        if name in names:
            function = f"%copy{k}" if external.size >= _ROW else f"@checked.{external.size}"
            lines.append(f"  %sum{k} = call {number_type(lanes)} {function}{_arguments(k)}")
    return lines


def _status(schedule: Schedule, status: str, guarded: Sequence[str], lanes: int) -> str:
    """Return the code that sets the status of systems with non-finite results and blanks results of bad status."""
    T, zero = number_type(lanes), constant(0.0, lanes)
    index = {name: k for k, name in enumerate(schedule.externals)}
    sums: list[str] = []
    total = zero
    for k in (index[name] for name in guarded):
        sums.append(f"  %total{k} = fadd {T} {total}, %sum{k}")
        total = f"%total{k}"
    blank: list[str] = []
    for name in guarded:
        k, size = index[name], schedule.externals[name].size
        blank.append(f"  call void @blank(ptr %lanes{k}, i64 {size}, <{lanes} x i1> %bad)")
        blank.append(f"  call void @from_lanes.{size}{_arguments(k)}")
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
        blank=blank,
    )
