"""Copy rows of systems or items into lanes and back, by transposing square blocks in registers.

    void to_lanes.N(double *rows, i64 stride, i64 first, i64 last, double *lanes)
    void from_lanes.N(the same)
    <L x double> checked.N(the same): from_lanes, which returns the sum of x - x, 0 for finite numbers x
    <L x double> streamed.N(the same): checked, past the caches, for rows that begin at multiples of a register's width

Lane j is row min(first + j, last). The first N doubles of each row are copied; rows are `stride` doubles apart, or
0 if all systems share one row. Copying number by number took a quarter of a batch's time.

    void to_lanes.N.L(double *lanes, double *row0, ..., double *row[L - 1])
    void from_lanes.N.L(the same)

Lane j is row j, which may be anywhere. Several lanes may have the same row: the first of them is written last.
"""

from __future__ import annotations

from collections.abc import Iterable

_UNROLLED = 2  # up to so many square blocks are written one after the other; more become a loop
_CHECKED = ("checked", "streamed")
_SUMS = 4  # are added up side by side, because each addition waits for the one before


def transpositions(sizes: Iterable[tuple[str, int]], lanes: int) -> list[str]:
    """Return the source of the functions for pairs of a name in this file's text and a size, with declarations."""
    lines = [masked_load(lanes), "declare i64 @llvm.smin.i64(i64, i64)"]
    for name, size in sorted(set(sizes)):
        lines += _of_systems(name, size, lanes)
    return lines


def of_items(name: str, size: int, lanes: int) -> list[str]:
    """Return the source of the function for rows that lie anywhere, `name`.`size`.`lanes`."""
    rows = ", ".join(f"ptr %row{j}" for j in range(lanes))
    head = f"define internal void @{name}.{size}.{lanes}(ptr %lanes, {rows}) noinline nounwind {{"
    return [head, "entry:", *_squares(name, size, lanes)]


def masked_load(lanes: int) -> str:
    """Return the declaration of what rows shorter than a register are read by."""
    V = f"<{lanes} x double>"
    return f"declare {V} @llvm.masked.load.v{lanes}f64.p0(ptr, i32, <{lanes} x i1>, {V})"


def _of_systems(name: str, size: int, lanes: int) -> list[str]:
    result = f"<{lanes} x double>" if name in _CHECKED else "void"
    lines = [
        f"define internal {result} @{name}.{size}(ptr %rows, i64 %stride, i64 %first, i64 %last, ptr %lanes)"
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
    return [*lines, *_squares(name, size, lanes)]


def _squares(name: str, size: int, lanes: int) -> list[str]:
    """Return the body of a function, all blocks of the transposition, once the pointers to the rows are known."""
    V, checked = f"<{lanes} x double>", name in _CHECKED
    lines: list[str] = []
    whole, rest = divmod(size, lanes)
    sums = ["zeroinitializer"] * _SUMS if checked else []
    if whole > _UNROLLED:
        own = [f"%sum{k}" for k in range(len(sums))]
        squared, sums = _square(name, "q", "%e", lanes, lanes, own)
        lines += [
            "  br label %square",
            "square:",
            "  %e = phi i64 [ 0, %entry ], [ %e.next, %square ]",
            *(
                f"  {x} = phi {V} [ zeroinitializer, %entry ], [ {after}, %square ]"
                for x, after in zip(own, sums, strict=True)
            ),
            *squared,
            f"  %e.next = add i64 %e, {lanes}",
            f"  %more = icmp slt i64 %e.next, {whole * lanes}",
            "  br i1 %more, label %square, label %tail",
            "tail:",
        ]
    else:
        for k in range(whole):
            squared, sums = _square(name, f"q{k}", str(k * lanes), lanes, lanes, sums)
            lines += squared
    if rest:  # the last block overlaps the one before it, if there is one, or writes zeros beyond the row
        start, width = (size - lanes, lanes) if whole and name != "streamed" else (whole * lanes, rest)
        squared, sums = _square(name, "t", str(start), lanes, width, sums)
        lines += squared
    if not checked:
        return [*lines, "  ret void", "}"]
    total, *others = sums
    for k, x in enumerate(others):
        lines.append(f"  %total{k} = fadd {V} {total}, {x}")
        total = f"%total{k}"
    return [*lines, f"  ret {V} {total}", "}"]


def _square(name: str, tag: str, entry: str, lanes: int, width: int, sums: list[str]) -> tuple[list[str], list[str]]:
    """Return lines that transpose a block, `width` entries from `entry` on of `lanes` rows, and the updated sums."""
    V = f"<{lanes} x double>"
    lines = [f"  %{tag}.first = mul i64 {entry}, {lanes}"]
    for j in range(lanes):
        lines.append(f"  %{tag}.r{j} = getelementptr double, ptr %row{j}, i64 {entry}")
        lines.append(f"  %{tag}.f{j} = add i64 %{tag}.first, {j * lanes}")
        lines.append(f"  %{tag}.l{j} = getelementptr double, ptr %lanes, i64 %{tag}.f{j}")
    values = []
    mask = f"<{', '.join(f'i1 {int(j < width)}' for j in range(lanes))}>"
    for j in range(lanes):
        if j >= width and name != "to_lanes":
            values.append("zeroinitializer")
            continue
        if name != "to_lanes":
            text = f"load {V}, ptr %{tag}.l{j}, align {8 * lanes}"
        elif width == lanes:
            text = f"load {V}, ptr %{tag}.r{j}, align 8"
        else:
            text = (
                f"call {V} @llvm.masked.load.v{lanes}f64.p0(ptr %{tag}.r{j}, i32 8,"
                f" <{lanes} x i1> {mask}, {V} zeroinitializer)"
            )
        lines.append(f"  %{tag}.v{j} = {text}")
        values.append(f"%{tag}.v{j}")
    sums = list(sums)
    for j, value in enumerate(values[:width] if sums else []):
        k = j % len(sums)
        lines.append(f"  %{tag}.d{j} = fsub {V} {value}, {value}")
        lines.append(f"  %{tag}.s{j} = fadd {V} {sums[k]}, %{tag}.d{j}")
        sums[k] = f"%{tag}.s{j}"
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
                turned[target] = f"%{tag}.t{step}.{target}"
                lines.append(f"  {turned[target]} = shufflevector {V} {a}, {V} {b}, {_order(order)}")
        values, step = turned, 2 * step
    for j, value in reversed(list(enumerate(values))):
        if name == "to_lanes":
            if j < width:
                lines.append(f"  store {V} {value}, ptr %{tag}.l{j}, align {8 * lanes}")
        elif name == "streamed":
            lines.append(f"  store {V} {value}, ptr %{tag}.r{j}, align {8 * lanes}, !nontemporal !{{i32 1}}")
        elif width == lanes:
            lines.append(f"  store {V} {value}, ptr %{tag}.r{j}, align 8")
        else:
            lines += _part(f"%{tag}.p{j}", value, f"%{tag}.r{j}", lanes, width)
    return lines, sums


def _part(name: str, value: str, row: str, lanes: int, width: int) -> list[str]:
    """Return the lines that store the first `width` numbers of a vector, in pieces of 2^k numbers.

    Masked stores would be slow on some processors.
    """
    lines, start = [], 0
    while start < width:
        size = 1 << ((width - start).bit_length() - 1)
        piece = f"{name}.{start}"
        order = _order([start + k for k in range(size)])
        lines += [
            f"  {piece} = shufflevector <{lanes} x double> {value}, <{lanes} x double> poison, {order}",
            f"  {piece}.at = getelementptr double, ptr {row}, i64 {start}",
            f"  store <{size} x double> {piece}, ptr {piece}.at, align 8",
        ]
        start += size
    return lines


def _order(places: list[int]) -> str:
    return f"<{len(places)} x i32> <{', '.join(f'i32 {k}' for k in places)}>"
