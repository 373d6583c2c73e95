"""Rows of systems to lanes and back, as square blocks turned over in registers.

    void to_lanes(double *rows, i64 stride, i64 first, i64 last, double *lanes, i64 size)
    void from_lanes(the same)

Lane j is row min(first + j, last); `stride` doubles lie between rows (0: one row for all), `size`
of them are moved. Element by element this took a quarter of a batch's time.
"""

from __future__ import annotations


def transpositions(lanes: int) -> list[str]:
    """Return the text of both functions for vectors of so many lanes."""
    V = f"<{lanes} x double>"
    return [
        f"declare {V} @llvm.masked.load.v{lanes}f64.p0(ptr, i32, <{lanes} x i1>, {V})",
        f"declare void @llvm.masked.store.v{lanes}f64.p0({V}, ptr, i32, <{lanes} x i1>)",
        "declare i64 @llvm.smin.i64(i64, i64)",
        *_function("to_lanes", lanes),
        *_function("from_lanes", lanes),
    ]


def _function(name: str, lanes: int) -> list[str]:
    lines = [
        f"define internal void @{name}(ptr %rows, i64 %stride, i64 %first, i64 %last, ptr %lanes, i64 %size)"
        " noinline nounwind {",
        "entry:",
    ]
    for j in range(lanes):
        lines += [
            f"  %i{j} = add i64 %first, {j}",
            f"  %k{j} = call i64 @llvm.smin.i64(i64 %i{j}, i64 %last)",
            f"  %s{j} = mul i64 %k{j}, %stride",
            f"  %row{j} = getelementptr double, ptr %rows, i64 %s{j}",
        ]
    lines += [
        f"  %rest = urem i64 %size, {lanes}",
        "  %whole = sub i64 %size, %rest",
        "  %short = icmp eq i64 %whole, 0",
        "  br i1 %short, label %tail, label %square",
        "square:",
        "  %e = phi i64 [ 0, %entry ], [ %e.next, %square ]",
        *_square(name, "q", "%e", lanes, None),
        f"  %e.next = add i64 %e, {lanes}",
        "  %more = icmp slt i64 %e.next, %whole",
        "  br i1 %more, label %square, label %tail",
        "tail:",
        "  %even = icmp eq i64 %rest, 0",
        "  br i1 %even, label %done, label %part",
        "part:",
        f"  %limit = insertelement <{lanes} x i64> poison, i64 %rest, i64 0",
        f"  %limits = shufflevector <{lanes} x i64> %limit, <{lanes} x i64> poison,"
        f" <{lanes} x i32> zeroinitializer",
        f"  %mask = icmp slt <{lanes} x i64> <{', '.join(f'i64 {j}' for j in range(lanes))}>, %limits",
        *_square(name, "p", "%whole", lanes, "%mask"),
        "  br label %done",
        "done:",
        "  ret void",
        "}",
    ]
    return lines


def _square(name: str, tag: str, entry: str, lanes: int, mask: str | None) -> list[str]:
    """Return what turns over the square of `lanes` rows from an entry on."""
    V = f"<{lanes} x double>"
    lines = [f"  %{tag}.first = mul i64 {entry}, {lanes}"]
    for j in range(lanes):
        lines.append(f"  %{tag}.r{j} = getelementptr double, ptr %row{j}, i64 {entry}")
        lines.append(f"  %{tag}.f{j} = add i64 %{tag}.first, {j * lanes}")
        lines.append(f"  %{tag}.l{j} = getelementptr double, ptr %lanes, i64 %{tag}.f{j}")
    values = []
    for j in range(lanes):
        if name == "from_lanes":
            text = f"load {V}, ptr %{tag}.l{j}, align {8 * lanes}"
        elif mask is None:
            text = f"load {V}, ptr %{tag}.r{j}, align 8"
        else:
            text = (
                f"call {V} @llvm.masked.load.v{lanes}f64.p0(ptr %{tag}.r{j}, i32 8,"
                f" <{lanes} x i1> {mask}, {V} zeroinitializer)"
            )
        lines.append(f"  %{tag}.v{j} = {text}")
        values.append(f"%{tag}.v{j}")
    step = 1
    while step < lanes:  # swap the off-diagonal blocks of size `step`
        turned = list(values)
        for i in range(lanes):
            if i & step:
                continue
            a, b = values[i], values[i + step]
            low = [k if not k & step else lanes + k - step for k in range(lanes)]
            high = [k + step if not k & step else lanes + k for k in range(lanes)]
            for target, order in ((i, low), (i + step, high)):
                indices = ", ".join(f"i32 {k}" for k in order)
                turned[target] = f"%{tag}.t{step}.{target}"
                lines.append(f"  {turned[target]} = shufflevector {V} {a}, {V} {b}, <{lanes} x i32> <{indices}>")
        values, step = turned, 2 * step
    for j, value in enumerate(values):
        if name == "to_lanes":
            lines.append(f"  store {V} {value}, ptr %{tag}.l{j}, align {8 * lanes}")
        elif mask is None:
            lines.append(f"  store {V} {value}, ptr %{tag}.r{j}, align 8")
        else:
            lines.append(
                f"  call void @llvm.masked.store.v{lanes}f64.p0({V} {value}, ptr %{tag}.r{j}, i32 8,"
                f" <{lanes} x i1> {mask})"
            )
    return lines
