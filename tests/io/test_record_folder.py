"""A record of a rollout goes to a folder and comes back to the bit; what fails leaves the earlier one in place."""

import io
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
from holdfast.io import record_folder, result_meta, store
from tests.compiler.programs import same_bits
from tests.io.mutations import small_case
from tests.io.signing import resigned
from tests.simulation.rollout.problems import elsewhere, problem, swinging

RECORDED = ("q", "grasp_wrench", "status")


@pytest.fixture(scope="module")
def made():
    """Return a rollout and a record of four systems, one of which stops."""
    chain, state = problem("one")
    rollout = swinging("one")
    starts = elsewhere(chain, state, 4)
    starts["q"][3] = np.nan
    payload = {"object_mass": np.array([1.0, 2.0, 3.0, 4.0]), "object_inertia": "scale"}
    record = rollout.run(rollout.start(**starts), 0.006, 0.001, every=3, record=RECORDED, **payload)
    return rollout, record


def test_comes_back(made, tmp_path):
    """Every array, what became of the systems, and one of them as a run, with the payload given to `run`."""
    rollout, record = made
    folder = record.save(tmp_path / "new" / "record")
    plain = hf.io.load_record(str(folder))
    assert repr(plain) == repr(record)
    assert "1 broken, 3 running" in repr(plain)
    for name in ("q", "grasp_wrench"):
        assert same_bits(plain[name], record[name])
    assert (plain["status"] == record["status"]).all()
    assert same_bits(plain.t, record.t) and same_bits(plain.stopped, record.stopped)
    assert same_bits(plain.systems.work, record.systems.work)
    with pytest.raises(hf.errors.StateError, match="rollout="):
        plain.trajectory(1)
    run, expected = hf.io.load_record(folder, rollout).trajectory(1), record.trajectory(1)
    assert same_bits(run.q, expected.q) and same_bits(run.grasp_wrench, expected.grasp_wrench)


def test_goes_on(made, tmp_path):
    """Loaded systems are stepped on as those that were saved."""
    rollout, record = made
    again = hf.io.load_record(record.save(tmp_path / "record")).systems
    kept = record.systems.copy()
    for systems in (again, kept):
        rollout.step(systems, 0.001, steps=2)
    assert same_bits(again.q, kept.q)


def test_what_is_there(made, tmp_path):
    """Nobody's folder is touched, an earlier record only when told to."""
    _, record = made
    folder = record.save(tmp_path / "record")
    with pytest.raises(hf.errors.ResultError, match="holds an earlier record; try overwrite=True"):
        record.save(folder)
    (folder / "notes.txt").write_text("mine")
    record.save(folder, overwrite=True)
    assert (folder / "notes.txt").read_text() == "mine"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").touch()
    with pytest.raises(hf.errors.ResultError, match="expected a new or empty folder"):
        record.save(tmp_path / "other", overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "record"]


@pytest.mark.parametrize("cause", [OSError(28, "No space left on device"), KeyboardInterrupt(), MemoryError()])
def test_half_way(made, tmp_path, monkeypatch, cause):
    """The earlier record is there to the byte, and nothing else."""
    _, record = made
    folder = record.save(tmp_path / "record")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def fail(*_):
        raise cause

    monkeypatch.setattr(store, "arrays_text", fail)
    with pytest.raises((hf.errors.ResultError, KeyboardInterrupt, MemoryError)):
        record.save(folder, overwrite=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert list(tmp_path.iterdir()) == [folder]


def test_damage(made, tmp_path):
    """Whatever was done to a file is refused by name, and no object in it is unpickled."""
    rollout, record = made
    folder = record.save(tmp_path / "record")
    for name in ("record.json", "records_000000.npz", "systems_000001.npz", "model.json"):
        file = folder / name
        whole = file.read_bytes()
        for k in range(0, len(whole), len(whole) // 12):
            file.write_bytes(whole[:k] + bytes([whole[k] ^ 0xFF]) + whole[k + 1 :])
            with pytest.raises(hf.errors.ResultError, match=rf"{name}.* damaged"):
                hf.io.load_record(folder, rollout)
            file.write_bytes(whole[: k // 2])
            with pytest.raises(hf.errors.ResultError, match=rf"{name}.* damaged.* overwrite=True"):
                hf.io.load_record(folder)
        file.write_bytes(whole)
    for name in ("systems_000001.npz", "records_000000.npz"):
        file = folder / name
        whole = file.read_bytes()
        arrays = dict(np.load(io.BytesIO(whole)))

        def load(held, file=file):
            np.savez(file, **held)
            resigned(folder)
            hf.io.load_record(folder, rollout)

        for name in arrays:
            if name.partition(".")[0] in ("last_inputs", "first_inputs"):
                continue  # any of them may be there or not
            with pytest.raises(hf.errors.ResultError):
                load({n: x for n, x in arrays.items() if n != name})
        odd = {"t", "stopped", "last.begin", "record.q", "record.status", "last_arrays.q", "last_arrays.code"}
        for name in odd & arrays.keys():
            with pytest.raises(hf.errors.ResultError, match="damaged"):
                load(arrays | {name: np.append(arrays[name].ravel(), 7.5)})
        with pytest.raises(hf.errors.ResultError, match="damaged"):
            load(arrays | {"t": np.array([small_case()], dtype=object)})
        file.write_bytes(whole)
        resigned(folder)
    file.unlink()
    with pytest.raises(hf.errors.ResultError, match=r"records_000000\.npz is missing; 3 of 3 records are lost"):
        hf.io.load_record(folder)
    (folder / "record.json").unlink()
    with pytest.raises(hf.errors.ResultError, match=r"record\.json is missing; is this a record folder"):
        hf.io.load_record(folder)
    with pytest.raises(hf.errors.ResultError, match="nowhere: no such folder"):
        hf.io.load_record(tmp_path / "nowhere")


def test_another_rollout(made, tmp_path):
    """One of another chain is refused."""
    _, record = made
    with pytest.raises(hf.errors.ResultError, match="another chain"):
        hf.io.load_record(record.save(tmp_path / "record"), swinging("legs"))


def test_a_run_half_way(made, tmp_path, monkeypatch):
    """`run.save(overwrite=True)` that fails leaves the earlier result whole; one that succeeds keeps others' files."""
    _, record = made
    run = record.trajectory(0)
    folder = run.save(tmp_path / "run")
    (folder / "notes.txt").write_text("mine")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with monkeypatch.context() as patched:
        patched.setattr(result_meta, "chunk_text", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left")))
        with pytest.raises(hf.errors.ResultError, match="run: cannot be written: No space left"):
            run.save(folder, overwrite=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert list(tmp_path.iterdir()) == [folder]
    record.trajectory(1).save(folder, overwrite=True)
    assert same_bits(hf.load_result(folder).trajectory.q, record.trajectory(1).q)
    assert (folder / "notes.txt").read_text() == "mine"
    assert list(tmp_path.iterdir()) == [folder]
    monkeypatch.chdir(folder)
    with pytest.raises(hf.errors.ResultError, match="it contains the working directory"):
        run.save(".", overwrite=True)


@pytest.mark.parametrize("folder", [None, 3, "", "a\0b", "x" * 5000, "/proc/none", "/dev/null/x"])
def test_no_folder(made, folder):
    """What cannot be a folder's name is refused, by a record and by a run."""
    for one in (made[1], made[1].trajectory(0)):
        with pytest.raises(hf.errors.ResultError):
            one.save(folder)


def test_no_rollout(made, tmp_path):
    """Neither is what is no rollout taken for one."""
    with pytest.raises(hf.errors.ModelError, match="load_record: rollout"):
        hf.io.load_record(made[1].save(tmp_path / "record"), "rollout")  # pyright: ignore[reportArgumentType]


APPENDED = ("t", "q", "grasp_wrench", "status")
OPTIONS = {"every": 2, "record": APPENDED, "object_mass": np.array([1.0, 2.0, 3.0, 4.0]), "object_inertia": "scale"}


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
        assert all(np.array_equal(one[name], kept[name], equal_nan=name != "status") for name in APPENDED)
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
    with pytest.raises(hf.errors.ResultError, match="holds an earlier record; try overwrite=True"):
        rollout.run(systems, 0.01, 0.001, folder=tmp_path / "record")
    for place in ("record", "new"):
        with pytest.raises(hf.errors.StateError, match="object_mass"):
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

    with pytest.raises(hf.errors.ResultError, match="another process has written to it"):
        rollout.run(systems, 0.01, 0.001, folder=tmp_path, progress=disturb)
    assert hf.io.load_record(tmp_path).note == ""


def test_changed_while_read(initial, tmp_path):
    """Arrays that are asked for when their folder has gone say so."""
    rollout, systems = initial
    record = rollout.run(systems, 0.003, 0.001, folder=tmp_path, record=["q"])
    (tmp_path / "records_000000.npz").unlink()
    with pytest.raises(hf.errors.ResultError, match="changed while it was read"):
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
    with pytest.raises(hf.errors.ModelError, match="largest_drift: expected a number"):
        rollout.run(systems, 0.002, 0.001, largest_drift="1", folder=tmp_path / "record")
    assert not list(tmp_path.iterdir())
