"""Code on disk: loaded when whole, rebuilt when not, never from a folder that others may write."""

import ctypes
import os
import stat
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from holdfast.compiler import cache
from holdfast.compiler.lowering import lowered
from holdfast.compiler.targets import cpu
from holdfast.compiler.trace import trace
from tests.compiler.programs import ArrayKernel, compile_program, schedule_of

X = np.array([0.3, -1.2, 2.0])
PROGRAM = trace(lambda x: (np.sin(x) @ x / (x @ x + 1.0),), [(3,)])
EXPECTED = np.sin(X) @ X / (X @ X + 1.0)


@pytest.fixture(autouse=True, scope="module")
def builtins():
    """What calls bound kernels is machine code too, made once in a process: not here, where kernels are counted."""
    compile_program(PROGRAM).bind()


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty cache, which the next compilation makes."""
    path = tmp_path / "cache"
    monkeypatch.setenv("HOLDFAST_CACHE", str(path))
    return path


@pytest.fixture
def compilations(monkeypatch):
    """A list that grows with every compilation."""
    made = []
    compiled = cpu._compiled
    monkeypatch.setattr(cpu, "_compiled", lambda text, *more: made.append(text) or compiled(text, *more))
    return made


def answer() -> float:
    """Return the program's result by a new kernel."""
    return float(compile_program(PROGRAM)(X)[0])


def test_once(place, compilations):
    """The second kernel is loaded; a changed program is another entry."""
    first = answer()
    assert answer() == first == pytest.approx(EXPECTED, rel=1e-14)
    assert len(compilations) == 1
    assert stat.S_IMODE(place.stat().st_mode) == 0o700
    (entry,) = place.iterdir()
    assert stat.S_IMODE(entry.stat().st_mode) == 0o600
    compile_program(trace(lambda x: (x * 2.0,), [(3,)]))
    assert len(list(place.iterdir())) == len(compilations) == 2


def test_corruption(place, compilations):
    """60 truncated, zeroed and flipped entries: each is seen, rebuilt, and answers right."""
    first = answer()
    (entry,) = place.iterdir()
    whole = entry.read_bytes()
    random = np.random.default_rng(0)
    for trial in range(60):
        damaged = bytearray(whole)
        at = int(random.integers(len(whole)))
        if trial % 3 == 0:
            del damaged[at:]
        elif trial % 3 == 1:
            end = at + int(random.integers(1, 400))
            damaged[at:end] = bytes(len(damaged[at:end]))
        else:
            damaged[at] ^= 1 << int(random.integers(8))
        entry.write_bytes(damaged)
        before = len(compilations)
        assert answer() == first
        assert len(compilations) == before + (bytes(damaged) != whole)
        assert entry.read_bytes() == whole


def test_another_entry_under_its_name(place, compilations):
    """Whole code of another program is not taken for this one's."""
    answer()
    (entry,) = place.iterdir()
    compile_program(trace(lambda x: (x.sum(),), [(3,)]))
    (other,) = set(place.iterdir()) - {entry}
    entry.write_bytes(other.read_bytes())
    assert answer() == pytest.approx(EXPECTED, rel=1e-14)
    assert len(compilations) == 3


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o707, 0o701])
def test_open_folder(place, compilations, mode):
    """A folder that others may enter is not used."""
    place.mkdir()
    place.chmod(mode)
    answer(), answer()
    assert len(compilations) == 2 and not list(place.iterdir())


def test_links(place, tmp_path, compilations):
    """Neither a folder nor an entry is followed through a symbolic link."""
    answer()
    (entry,) = place.iterdir()
    elsewhere = tmp_path / "entry"
    entry.rename(elsewhere)
    entry.symlink_to(elsewhere)
    answer()
    assert len(compilations) == 2 and not entry.is_symlink()
    real = place.rename(tmp_path / "real")
    place.symlink_to(real)
    assert cache.folder() is None


def test_strangers_folder(place, monkeypatch):
    """Nor one that belongs to somebody else."""
    assert cache.folder() == place
    monkeypatch.setattr(os, "getuid", lambda: 12345678)
    assert cache.folder() is None


def test_off(place, monkeypatch, compilations):
    """HOLDFAST_CACHE=off; by default it lies with the user's other caches."""
    monkeypatch.setenv("HOLDFAST_CACHE", "off")
    answer(), answer()
    assert len(compilations) == 2 and not place.exists()
    monkeypatch.setenv("HOLDFAST_CACHE", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(place))
    assert cache.folder() == place / "holdfast"


def test_unusable_place(place):
    """A cache that cannot be written is no error."""
    place.write_text("a file")
    assert answer() == pytest.approx(EXPECTED, rel=1e-14)


def test_size_cap(place, monkeypatch):
    """What was unused for longest goes first."""
    monkeypatch.setattr(cache, "SIZE_CAP", 1000)
    for k, name in enumerate("abc"):
        cache.store(name, bytes(300))
        os.utime(place / f"{name}.code", ns=(k, k))
    assert cache.load("a") is None and cache.load("b") == bytes(300)
    cache.store("d", bytes(300))  # b was used since c was written
    assert {path.name for path in place.iterdir()} == {"b.code", "d.code"}


def test_many_writers(place):
    """Writers at the same time leave one whole entry and nothing else."""
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: cache.store("k", bytes(10000)), range(200)))
    assert cache.load("k") == bytes(10000)
    assert [path.name for path in place.iterdir()] == ["k.code"]


def test_keys():
    """Parts are kept apart."""
    assert cache.key_of("ab", "c") != cache.key_of("a", "bc")


class Source:
    """What makes a module's text, counting how often."""

    def __init__(self, result=42, **notes):
        self.calls, self.notes = 0, notes
        self.text = f"define i64 @run() {{\n  ret i64 {result}\n}}"

    def __call__(self):
        self.calls += 1
        return self.text, self.notes


def run(code: cpu.Code) -> int:
    """Return what a module's function returns."""
    return ctypes.CFUNCTYPE(ctypes.c_int64)(code.address)()


def test_under_a_key(place, compilations):
    """Found under its key, code comes back with its notes, and its text is not made."""
    source = Source(arena=7, operations=12345678901)
    first = cpu.Code(source, "run", key="chain")
    again = cpu.Code(source, "run", key="chain")
    assert source.calls == len(compilations) == len(list(place.iterdir())) == 1
    assert run(first) == run(again) == 42
    assert first.notes == again.notes == source.notes
    other = Source(43)
    assert run(cpu.Code(other, "run", key="chain")) == 42 and other.calls == 0
    assert run(cpu.Code(other, "run", key="another chain")) == 43 and other.calls == 1


def test_without_a_key(place, compilations):
    """The text stands for itself: made each time, once, and compiled once."""
    source = Source(arena=7)
    for calls in (1, 2):
        assert run(cpu.Code(source, "run")) == 42 and source.calls == calls
    assert run(cpu.Code(source.text, "run")) == 42
    assert len(compilations) == 1


def test_made_once_without_a_cache(place, monkeypatch, compilations):
    """With a key or without."""
    monkeypatch.setenv("HOLDFAST_CACHE", "off")
    for key in ("", "chain"):
        source = Source()
        cpu.Code(source, "run", key=key)
        assert source.calls == 1


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "notes"])
def test_corruption_under_a_key(place, compilations, damage):
    """The text is made again, and the entry with it."""
    source = Source(arena=7)
    cpu.Code(source, "run", key="chain")
    (entry,) = place.iterdir()
    whole = entry.read_bytes()
    at = whole.index(b"arena") if damage == "notes" else len(whole) // 2
    flipped = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]
    entry.write_bytes({"cut": whole[:at], "empty": b""}.get(damage, flipped))
    again = cpu.Code(source, "run", key="chain")
    assert source.calls == len(compilations) == 2
    assert run(again) == 42 and again.notes == {"arena": 7}
    assert entry.read_bytes() == whole
    cpu.Code(source, "run", key="chain")
    assert source.calls == 2


def test_kernel_under_a_key(place, compilations):
    """A kernel that was compiled before does not ask for its schedule: alone, bound, in a batch, and in counts."""
    schedule = schedule_of(lowered(PROGRAM))
    asked = []
    batch = np.stack([X, 2.0 * X, -X])

    def answers(lanes: int = 4) -> tuple[float, ...]:
        kernel = ArrayKernel(schedule.externals, lambda: asked.append(1) or schedule, "chain", lanes)
        bound = kernel.bind()
        bound.arrays["in0"][:] = X
        bound.run()
        counts = (kernel.operation_count, kernel.lanes)
        return (*counts, float(kernel(X)[0]), float(bound.arrays["out0"]), *kernel(batch)[0].tolist())

    first = answers()
    assert first[2:] == pytest.approx([EXPECTED] * 3 + [first[5], EXPECTED], rel=1e-14)
    assert len(asked) == 1 and len(compilations) == 2
    assert answers() == first
    assert len(asked) == 1 and len(compilations) == 2
    assert answers(2)[2:] == first[2:]
    assert len(asked) == 2 and len(compilations) == 4
