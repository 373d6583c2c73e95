"""A rollout appends its record to a folder: the same bits as in memory, readable at any time and after any death."""

import os
import signal
import subprocess
import sys
import textwrap
import time
import tracemalloc

import numpy as np
import pytest

import holdfast as hf
from holdfast.io import record_folder
from tests.compiler.programs import same_bits
from tests.simulation.rollout.problems import elsewhere, problem, swinging

RECORDED = ("t", "q", "grasp_wrench", "status")
OPTIONS = {"every": 2, "record": RECORDED, "object_mass": np.array([1.0, 2.0, 3.0, 4.0]), "object_inertia": "scale"}


@pytest.fixture
def initial():
    """Return a rollout and four started systems, one of which stops at once."""
    chain, state = problem("one")
    starts = elsewhere(chain, state, 4)
    starts["q"][3] = np.nan
    rollout = swinging("one")
    return rollout, rollout.start(**starts)


@pytest.fixture
def at_once(monkeypatch):
    """Let every record be flushed by itself."""
    monkeypatch.setattr(record_folder, "LONGEST_WAIT", 0.0)


@pytest.mark.parametrize("patience", [0.0, 60.0])
def test_same_bits(initial, tmp_path, monkeypatch, patience):
    """In how many pieces it was written makes no difference, nor does reading it or saving it elsewhere."""
    monkeypatch.setattr(record_folder, "LONGEST_WAIT", patience)
    rollout, systems = initial
    kept = rollout.run(systems, 0.013, 0.001, **OPTIONS)
    record = rollout.run(systems, 0.013, 0.001, folder=tmp_path / "new" / "record", **OPTIONS)
    loaded = hf.io.load_record(tmp_path / "new" / "record", rollout)
    again = hf.io.load_record(loaded.save(tmp_path / "again"), rollout)
    for one in (record, loaded, again):
        assert repr(one) == repr(kept) and same_bits(one.t, kept.t) and same_bits(one.stopped, kept.stopped)
        assert all(np.array_equal(one[name], kept[name], equal_nan=name != "status") for name in RECORDED)
        assert same_bits(one.systems.work, kept.systems.work)
        assert same_bits(one.trajectory(1).grasp_wrench, kept.trajectory(1).grasp_wrench)
        parts = [(part.t, part["q"]) for part in one.parts()]
        assert len(parts) == (7 if patience == 0.0 else 2)
        assert same_bits(np.concatenate([q for _, q in parts]), kept["q"])


@pytest.mark.usefixtures("at_once")
def test_readable_meanwhile(initial, tmp_path):
    """After each step the folder has all records so far; of these a system becomes a run."""
    rollout, systems = initial
    kept, seen = rollout.run(systems, 0.008, 0.001, **OPTIONS), []

    def look(t):
        if t > 0.0015:
            seen.append(hf.io.load_record(tmp_path, rollout))

    rollout.run(systems, 0.008, 0.001, folder=tmp_path, progress=look, **OPTIONS)
    assert [len(one.t) for one in seen] == [2, 2, 3, 3, 4, 4, 4]  # the last is written with the end
    assert "incomplete, up to t = 0.004 s" in seen[2].note and seen[2].note in repr(seen[2])
    half = seen[2].trajectory(0)
    assert same_bits(half.q, kept.trajectory(0).q[:3])
    assert hf.io.load_record(tmp_path).note == ""


def test_interrupted(initial, tmp_path):
    """Ctrl-C leaves every record so far; wrong arguments leave nothing, and an earlier record as it was."""
    rollout, systems = initial

    def stop(t):
        if t > 0.0055:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rollout.run(systems, 0.01, 0.001, folder=tmp_path / "record", progress=stop, **OPTIONS)
    left = hf.io.load_record(tmp_path / "record")
    assert len(left.t) == 4 and "incomplete, up to t = 0.006 s" in left.note
    with pytest.raises(hf.ResultError, match="holds an earlier record; try overwrite=True"):
        rollout.run(systems, 0.01, 0.001, folder=tmp_path / "record")
    for place in ("record", "new"):
        with pytest.raises(hf.StateError, match="object_mass"):
            rollout.run(systems, 0.01, 0.001, folder=tmp_path / place, overwrite=True, object_mass="heavy")
    assert len(hf.io.load_record(tmp_path / "record").t) == 4 and not (tmp_path / "new").exists()
    rollout.run(systems, 0.002, 0.001, folder=tmp_path / "record", overwrite=True, record=())
    names = sorted(path.name for path in (tmp_path / "record").iterdir())
    assert names == [
        "model.json", "record.json", "records_000000.npz", "records_000001.npz", "systems_000002.npz"]  # fmt: skip


@pytest.mark.usefixtures("at_once")
def test_another_writer(initial, tmp_path):
    """Two rollouts in one folder are refused before their records mix."""
    rollout, systems = initial

    def disturb(t):
        if 0.0015 < t < 0.0025:
            rollout.run(systems, 0.003, 0.001, folder=tmp_path, overwrite=True)

    with pytest.raises(hf.ResultError, match="another process has written to it"):
        rollout.run(systems, 0.01, 0.001, folder=tmp_path, progress=disturb)
    assert hf.io.load_record(tmp_path).note == ""


def test_changed_while_read(initial, tmp_path):
    """Arrays that are asked for when their folder has gone say so."""
    rollout, systems = initial
    record = rollout.run(systems, 0.003, 0.001, folder=tmp_path, record=["q"])
    (tmp_path / "records_000000.npz").unlink()
    with pytest.raises(hf.ResultError, match="changed while it was read"):
        record["q"]
    with pytest.raises(KeyError, match="was not recorded"):
        record["qd"]


@pytest.mark.slow
def test_memory_does_not_grow(initial, tmp_path, monkeypatch):
    """Ten times the records take as much memory, less their times."""
    monkeypatch.setattr(record_folder, "LARGEST_PIECE", 2**16)
    rollout, systems = initial
    peaks = []
    for k, duration in enumerate((0.01, 0.2, 2.0)):  # the first is not measured
        tracemalloc.start()
        rollout.run(systems, duration, 0.001, folder=tmp_path / str(k), least_margin=-1e9)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    record = hf.io.load_record(tmp_path / "2")
    assert sum(x.nbytes for x in record.arrays.values()) > 1.5e6
    assert peaks[2] - peaks[1] < 2e5


@pytest.mark.slow
def test_killed(initial, tmp_path):
    """kill -9 at any moment leaves whole records, those of an undisturbed rollout."""
    program = """
        import holdfast as hf
        from holdfast.io import record_folder
        from tests.simulation.rollout.problems import elsewhere, problem, swinging
        record_folder.LONGEST_WAIT = 0.0
        chain, state = problem("one")
        rollout = swinging("one")
        rollout.run(rollout.start(**elsewhere(chain, state, 4)), 1000.0, 0.001, folder="record", record=["q"])
    """
    chain, state = problem("one")
    rollout = swinging("one")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    for k in range(3):
        place = tmp_path / str(k)
        place.mkdir()
        one = subprocess.Popen([sys.executable, "-c", textwrap.dedent(program)], cwd=place, env=environment)
        while not list(place.glob("record/records_00001*")):
            assert one.poll() is None
            time.sleep(0.01)
        time.sleep(0.01 * k)
        one.send_signal(signal.SIGKILL)
        one.wait()
        record = hf.io.load_record(place / "record", rollout)
        assert len(record.t) >= 10 and "incomplete" in record.note
        kept = rollout.run(rollout.start(**elsewhere(chain, state, 4)), len(record.t) * 0.001, 0.001, record=["q"])
        assert same_bits(record["q"], kept["q"][: len(record.t)])


def test_options_first(initial, tmp_path):
    """A wrong option is refused before anything is written."""
    rollout, systems = initial
    with pytest.raises(hf.ModelError, match="largest_drift: expected a number"):
        rollout.run(systems, 0.002, 0.001, largest_drift="1", folder=tmp_path / "record")
    assert not list(tmp_path.iterdir())
