"""Rows to lanes and back: every size, every tail, rows that are shared, and nothing beside them touched."""

import ctypes
import functools

import numpy as np
import pytest

from holdfast.compiler.kernel import aligned
from holdfast.compiler.targets import cpu
from holdfast.compiler.targets.llvm.transposition import transpositions

SIZES = range(1, 21)
LANES = [2, 4, 8]
UNTOUCHED = -7.0
_MOVE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)


@functools.cache
def code(lanes: int) -> cpu.Code:
    """Return all functions for so many lanes, under names that can be called."""
    names = [f"{way}.{size}" for way in ("to_lanes", "from_lanes", "checked", "streamed") for size in SIZES]
    lines = transpositions([(name.split(".")[0], int(name.split(".")[1])) for name in names], lanes)
    given = "ptr %rows, i64 %stride, i64 %first, i64 %last, ptr %lanes"
    for name in names:
        lines.append(f"define void @call.{name}({given}) {{")
        if name.startswith(("checked", "streamed")):  # the sum is written behind the area
            V, behind = f"<{lanes} x double>", -(-int(name.split(".")[1]) // lanes) * lanes * lanes
            lines.append(f"  %sum = call {V} @{name}({given})")
            lines.append(f"  %at = getelementptr double, ptr %lanes, i64 {behind}")
            lines.append(f"  store {V} %sum, ptr %at, align 8")
        else:
            lines.append(f"  call void @{name}({given})")
        lines += ["  ret void", "}"]
    return cpu.Code("\n".join(lines), *(f"call.{name}" for name in names))


def move(way: str, size: int, lanes: int, rows: np.ndarray, stride: int, first: int, last: int, area: np.ndarray):
    """Call one of them."""
    function = _MOVE(code(lanes).addresses[f"call.{way}.{size}"])
    function(rows.ctypes.data, stride, first, last, area.ctypes.data)


def numbers(rows: int, stride: int) -> np.ndarray:
    """Return rows of different numbers, at an address that is a multiple of eight bytes and no more."""
    block = aligned(rows * stride + 1)[1:]
    block[:] = np.arange(1.0, rows * stride + 1.0)
    return block.reshape(rows, stride)


def area_of(size: int, lanes: int) -> np.ndarray:
    """Return what a batch has for an array in lanes, and one square behind it."""
    area = aligned((-(-size // lanes) + 1) * lanes * lanes)
    area[:] = UNTOUCHED
    return area.reshape(-1, lanes)


@pytest.mark.parametrize("lanes", LANES)
def test_to_lanes(lanes):
    """Lane j is row min(first + j, last), for every number of rows left and for rows apart."""
    for size, stride in [(size, size + more) for size in SIZES for more in (0, 3)]:
        for left in range(1, lanes + 2):
            rows = numbers(left + 2, stride)
            area = area_of(size, lanes)
            move("to_lanes", size, lanes, rows, stride, 2, left + 1, area)
            expected = rows[np.minimum(2 + np.arange(lanes), left + 1), :size].T
            assert np.array_equal(area[:size], expected), (size, stride, left)
            assert (area[-(-size // lanes) * lanes :] == UNTOUCHED).all(), (size, stride, left)


@pytest.mark.parametrize("lanes", LANES)
def test_one_row_for_all(lanes):
    """Stride 0: a parameter that all systems share."""
    for size in SIZES:
        rows, area = numbers(1, size), area_of(size, lanes)
        move("to_lanes", size, lanes, rows, 0, 3, 50, area)
        assert np.array_equal(area[:size], np.repeat(rows.T, lanes, axis=1)), size


@pytest.mark.parametrize("lanes", LANES)
def test_from_lanes(lanes):
    """Back again, over these rows and nothing else; lanes beyond the last row hold its numbers once more."""
    for size, stride in [(size, size + more) for size in SIZES for more in (0, 3)]:
        for left in range(1, lanes + 2):
            rows = aligned((left + 3) * stride + 1)[1:].reshape(-1, stride)
            rows[:] = UNTOUCHED
            used, area = min(left, lanes), area_of(size, lanes)
            values = np.random.default_rng(left).normal(size=(used, size))
            area[:size] = values[np.minimum(np.arange(lanes), used - 1)].T
            move("from_lanes", size, lanes, rows, stride, 2, left + 1, area)
            expected = np.full_like(rows, UNTOUCHED)
            expected[2 : 2 + used, :size] = values
            assert np.array_equal(rows, expected), (size, stride, left)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("way", ["checked", "streamed"])
def test_sums(way, lanes):
    """Rows are written as without sums, which are 0 where all numbers are finite; streams fill up the register."""
    for size in SIZES:
        filled = -(-size // lanes) * lanes
        rows, area = aligned((lanes + 2) * filled).reshape(-1, filled), area_of(size, lanes)
        values = np.random.default_rng(size).normal(size=(lanes, size))
        for bad, number in ((None, 0.0), (0, np.nan), (lanes - 1, np.inf), (1, -np.inf)):
            for column in range(size):
                rows[:], given = UNTOUCHED, values.copy()
                if bad is not None:
                    given[bad, column] = number
                area[:size] = given.T
                with np.errstate(invalid="ignore"):
                    move(way, size, lanes, rows, filled, 1, lanes, area)
                assert np.array_equal(rows[1:-1, :size], given, equal_nan=True), (size, bad, column)
                assert (rows[[0, -1]] == UNTOUCHED).all(), (size, bad, column)
                assert (rows[1:-1, size:] == (0.0 if way == "streamed" else UNTOUCHED)).all(), (size, bad, column)
                odd = np.isnan(area[filled])
                assert np.array_equal(odd, np.arange(lanes) == bad), (size, bad, column)
                assert not area[filled][~odd].any(), (size, bad, column)


@pytest.mark.parametrize("lanes", LANES)
def test_no_bit_is_lost(lanes):
    """NaN with its payload, infinities and zeros with their signs are moved, not computed with."""
    size = 3
    bits = np.array([0x7FF8000000000123, 0xFFF0000000000000, 0x8000000000000000], dtype=np.uint64)
    rows, area, back = aligned(size), area_of(size, lanes), aligned(size * lanes)
    rows.view(np.uint64)[:] = bits
    move("to_lanes", size, lanes, rows, 0, 0, lanes, area)
    move("from_lanes", size, lanes, back, size, 0, lanes - 1, area)
    assert np.array_equal(back.view(np.uint64), np.tile(bits, lanes))


def test_none():
    """Arrays without numbers need no function: a module has those that are asked for, once."""
    assert not [line for line in transpositions([], 4) if line.startswith("define")]
    asked = [("to_lanes", 3), ("to_lanes", 3), ("from_lanes", 9)]
    assert len([line for line in transpositions(asked, 4) if line.startswith("define")]) == 2
