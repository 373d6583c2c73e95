"""Code on disk: loaded when whole, rebuilt when not, never from a folder that others may write."""

import os
import stat
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from holdfast.compiler import cache, cpu
from holdfast.compiler.kernel import compile_program
from holdfast.compiler.trace import trace

X = np.array([0.3, -1.2, 2.0])
PROGRAM = trace(lambda x: (np.sin(x) @ x / (x @ x + 1.0),), [(3,)])
EXPECTED = np.sin(X) @ X / (X @ X + 1.0)


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
    monkeypatch.setattr(cpu, "_compiled", lambda text, machine: made.append(text) or compiled(text, machine))
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
    """300 truncated, zeroed and flipped entries: each is seen, rebuilt, and answers right."""
    first = answer()
    (entry,) = place.iterdir()
    whole = entry.read_bytes()
    random = np.random.default_rng(0)
    for trial in range(300):
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
