"""The loop over a batch: systems are gathered into lanes, computed, and scattered back.

    void batch(i64 *table, i64 begin, i64 end, i64 count)

runs blocks begin <= b < end of `lanes` systems. `table` holds address and stride (doubles from one
system to the next, 0: shared by all) of every input, then of every output. Lanes beyond the last
system repeat it: they compute, and write, the same bits again, so a tail needs no code of its own.
"""

from __future__ import annotations

from collections.abc import Iterable


def batch_function(input_sizes: list[int], output_sizes: list[int], lanes: int) -> list[str]:
    """Return the text of `batch`; the module holds `block`, the computation on lanes.

    Args:
        input_sizes: numbers per system, of each input.
        output_sizes: the same of each output.
        lanes: systems in a block.
    """
    numbers = f"<{lanes} x double>"
    lines = [
        "define void @batch(ptr %table, i64 %begin, i64 %end, i64 %count) nounwind {",
        "entry:",
        f"  %in = alloca [{max(1, sum(input_sizes))} x {numbers}], align {8 * lanes}",
        f"  %out = alloca [{max(1, sum(output_sizes))} x {numbers}], align {8 * lanes}",
        "  %last = sub i64 %count, 1",
        "  %any = icmp slt i64 %begin, %end",
        "  br i1 %any, label %next, label %done",
        "next:",
        "  %b = phi i64 [ %begin, %entry ], [ %b.next, %step ]",
        f"  %first = mul i64 %b, {lanes}",
    ]
    for j in range(lanes):
        lines += [
            f"  %sum{j} = add i64 %first, {j}",
            f"  %row{j} = call i64 @llvm.smin.i64(i64 %sum{j}, i64 %last)",
        ]
    lines.append("  br label %start0")
    arrays = [(k, "in", size) for k, size in enumerate(input_sizes)]
    arrays += [(len(input_sizes) + k, "out", size) for k, size in enumerate(output_sizes)]
    place = {"in": 0, "out": 0}
    for k, side, size in arrays:
        lines.append(f"start{k}:")
        if k == len(input_sizes):
            lines.append("  call void @block(ptr %in, ptr %out)")
        lines += _copy(k, side, place[side], size, lanes)
        place[side] += size
    lines.append(f"start{len(arrays)}:")
    if not output_sizes:
        lines.append("  call void @block(ptr %in, ptr %out)")
    return [
        *lines,
        "  br label %step",
        "step:",
        "  %b.next = add i64 %b, 1",
        "  %more = icmp slt i64 %b.next, %end",
        "  br i1 %more, label %next, label %done",
        "done:",
        "  ret void",
        "}",
    ]


def _copy(k: int, side: str, place: int, size: int, lanes: int) -> Iterable[str]:
    """Yield the loop that copies array k, entry by entry, between its rows and the block's lanes."""
    if size == 0:
        yield f"  br label %start{k + 1}"
        return
    numbers = f"<{lanes} x double>"
    yield f"  %address.at{k} = getelementptr i64, ptr %table, i64 {2 * k}"
    yield f"  %stride.at{k} = getelementptr i64, ptr %table, i64 {2 * k + 1}"
    yield f"  %array{k} = load ptr, ptr %address.at{k}"
    yield f"  %stride{k} = load i64, ptr %stride.at{k}"
    for j in range(lanes):
        yield f"  %shift{k}.{j} = mul i64 %row{j}, %stride{k}"
        yield f"  %row{k}.{j} = getelementptr double, ptr %array{k}, i64 %shift{k}.{j}"
    yield f"  br label %copy{k}"
    yield f"copy{k}:"
    yield f"  %e{k} = phi i64 [ 0, %start{k} ], [ %e{k}.next, %copy{k} ]"
    yield f"  %slot{k} = add i64 %e{k}, {place}"
    yield f"  %at{k} = getelementptr {numbers}, ptr %{side}, i64 %slot{k}"
    if side == "out":
        yield f"  %lanes{k} = load {numbers}, ptr %at{k}, align {8 * lanes}"
    before = "poison"
    for j in range(lanes):
        yield f"  %entry{k}.{j} = getelementptr double, ptr %row{k}.{j}, i64 %e{k}"
        if side == "in":
            yield f"  %x{k}.{j} = load double, ptr %entry{k}.{j}, align 8"
            yield f"  %l{k}.{j} = insertelement {numbers} {before}, double %x{k}.{j}, i64 {j}"
            before = f"%l{k}.{j}"
        else:
            yield f"  %x{k}.{j} = extractelement {numbers} %lanes{k}, i64 {j}"
            yield f"  store double %x{k}.{j}, ptr %entry{k}.{j}, align 8"
    if side == "in":
        yield f"  store {numbers} {before}, ptr %at{k}, align {8 * lanes}"
    yield f"  %e{k}.next = add i64 %e{k}, 1"
    yield f"  %more{k} = icmp slt i64 %e{k}.next, {size}"
    yield f"  br i1 %more{k}, label %copy{k}, label %start{k + 1}"
