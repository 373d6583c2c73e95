"""A record of a rollout goes to a folder and comes back to the bit; what fails leaves the earlier one in place."""

import io

import numpy as np
import pytest

import holdfast as hf
from holdfast.io import record_folder, result_folder
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
    with pytest.raises(hf.StateError, match="rollout="):
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
    with pytest.raises(hf.ResultError, match="holds an earlier record; try overwrite=True"):
        record.save(folder)
    (folder / "notes.txt").write_text("mine")
    record.save(folder, overwrite=True)
    assert (folder / "notes.txt").read_text() == "mine"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").touch()
    with pytest.raises(hf.ResultError, match="expected a new or empty folder"):
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

    monkeypatch.setattr(record_folder, "arrays_text", fail)
    with pytest.raises((hf.ResultError, KeyboardInterrupt, MemoryError)):
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
            with pytest.raises(hf.ResultError, match=rf"{name}.* damaged"):
                hf.io.load_record(folder, rollout)
            file.write_bytes(whole[: k // 2])
            with pytest.raises(hf.ResultError, match=rf"{name}.* damaged.* overwrite=True"):
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
            with pytest.raises(hf.ResultError):
                load({n: x for n, x in arrays.items() if n != name})
        odd = {"t", "stopped", "last.begin", "record.q", "record.status", "last_arrays.q", "last_arrays.code"}
        for name in odd & arrays.keys():
            with pytest.raises(hf.ResultError, match="damaged"):
                load(arrays | {name: np.append(arrays[name].ravel(), 7.5)})
        with pytest.raises(hf.ResultError, match="damaged"):
            load(arrays | {"t": np.array([small_case()], dtype=object)})
        file.write_bytes(whole)
        resigned(folder)
    file.unlink()
    with pytest.raises(hf.ResultError, match=r"records_000000\.npz is missing; 3 of 3 records are lost"):
        hf.io.load_record(folder)
    (folder / "record.json").unlink()
    with pytest.raises(hf.ResultError, match=r"record\.json is missing; is this a record folder"):
        hf.io.load_record(folder)
    with pytest.raises(hf.ResultError, match="nowhere: no such folder"):
        hf.io.load_record(tmp_path / "nowhere")


def test_another_rollout(made, tmp_path):
    """One of another chain is refused."""
    _, record = made
    with pytest.raises(hf.ResultError, match="another chain"):
        hf.io.load_record(record.save(tmp_path / "record"), swinging("legs"))


def test_a_run_half_way(made, tmp_path, monkeypatch):
    """`run.save(overwrite=True)` that fails leaves the earlier result whole; one that succeeds keeps others' files."""
    _, record = made
    run = record.trajectory(0)
    folder = run.save(tmp_path / "run")
    (folder / "notes.txt").write_text("mine")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with monkeypatch.context() as patched:
        patched.setattr(result_folder, "chunk_text", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left")))
        with pytest.raises(hf.ResultError, match="run: cannot be written: No space left"):
            run.save(folder, overwrite=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert list(tmp_path.iterdir()) == [folder]
    record.trajectory(1).save(folder, overwrite=True)
    assert same_bits(hf.load_result(folder).trajectory.q, record.trajectory(1).q)
    assert (folder / "notes.txt").read_text() == "mine"
    assert list(tmp_path.iterdir()) == [folder]
    monkeypatch.chdir(folder)
    with pytest.raises(hf.ResultError, match="it contains the working directory"):
        run.save(".", overwrite=True)


@pytest.mark.parametrize("folder", [None, 3, "", "a\0b", "x" * 5000, "/proc/none", "/dev/null/x"])
def test_no_folder(made, folder):
    """What cannot be a folder's name is refused, by a record and by a run."""
    for one in (made[1], made[1].trajectory(0)):
        with pytest.raises(hf.ResultError):
            one.save(folder)


def test_no_rollout(made, tmp_path):
    """Neither is what is no rollout taken for one."""
    with pytest.raises(hf.ModelError, match="load_record: rollout"):
        hf.io.load_record(made[1].save(tmp_path / "record"), "rollout")  # pyright: ignore[reportArgumentType]
