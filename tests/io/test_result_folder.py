"""A result folder is whole at any moment, says how far it got, and is never replaced by accident."""

import contextlib
import json
import os

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ResultError
from holdfast.io import result_folder
from holdfast.io.result_folder import CHUNK
from holdfast.io.result_reader import load_result
from holdfast.simulation.events import Occurrence
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import array_names, stacked
from tests.compiler.programs import same_bits as same_array
from tests.control.two_pandas import two_pandas
from tests.io.recorded import SCENE, filled, same_bits, samples, writer
from tests.simulation.rollout.problems import problem


def test_round_trip(tmp_path):
    """Every array comes back bit for bit, with the scene, the names and the units."""
    chain, _ = two_pandas()
    w, given = filled(tmp_path / "a" / "run", 1, 30, 20)
    w.finish(summarise(chain, stacked(given)))
    found = load_result(tmp_path / "a" / "run")
    assert found.complete
    assert found.note == ""
    assert found.scene_text == SCENE
    assert found.samples == 51
    same_bits(found.trajectory, stacked(given))
    assert found.meta.joints[:2] == ["left/joint1", "left/joint2"]
    assert found.meta.joint_kinds == ["revolute"] * 14
    assert list(found.meta.units) == array_names()
    assert json.loads((tmp_path / "a/run/summary.json").read_text())["samples"] == len(given)
    assert sorted(p.name for p in (tmp_path / "a/run").iterdir()) == [
        "chunk_0000.npz", "chunk_0001.npz", "chunk_0002.npz", "meta.json", "scene.toml", "summary.json"]  # fmt: skip


def test_what_ended_the_run_is_in_the_log(tmp_path):
    """What happened after the last sample is kept at the end of the log, and told once."""
    w, given = filled(tmp_path / "run", 3)
    told = stacked(given).occurrences
    slip = Occurrence(0.21, "violation", "left", "it slips", "grasp")
    w.finish(None, stopped="it slips at t = 0.21 s", occurrences=(*told, slip))
    assert load_result(tmp_path / "run").trajectory.occurrences == (*told, slip)
    meta = json.loads((tmp_path / "run" / "meta.json").read_text())
    assert [one["name"] for one in meta["occurrences"]] == ["left"]


def test_plain_numpy_reads_it(tmp_path):
    """As docs/results.md says: without holdfast, the chunks one after the other are the run."""
    w, given = filled(tmp_path / "run", 3, 4)
    w.finish(None)
    meta = json.loads((tmp_path / "run" / "meta.json").read_text())
    chunks = [np.load(tmp_path / "run" / f"chunk_{k:04d}.npz") for k in range(len(meta["chunks"]))]
    q = np.concatenate([chunk["q"][:count] for chunk, count in zip(chunks, meta["chunks"], strict=True)])
    assert np.array_equal(q, stacked(given).q)
    log = json.loads(chunks[0]["occurrences"].item())
    assert [(line["sample"], line["kind"]) for line in log] == [(1, "attach"), (1, "violation")]
    for chunk in chunks:
        chunk.close()


def test_nothing_before_the_first_sample(tmp_path):
    """A run that never got a sample leaves no folder; one that got a few leaves them at the end."""
    writer(tmp_path / "run").finish(None, stopped="nothing")
    assert not (tmp_path / "run").exists()
    w = writer(tmp_path / "run")
    for one in samples(3):
        w.add(one)
    assert not (tmp_path / "run").exists()
    w.finish(None, stopped="stopped after t = 0.2 s: singular")
    found = load_result(tmp_path / "run")
    assert not found.complete
    assert len(found.trajectory) == 3
    assert found.note == "incomplete, up to t = 0.2 s of 30.0 s: stopped after t = 0.2 s: singular"


def test_the_parts_are_the_run(tmp_path):
    """Read chunk by chunk it is the same, and only one chunk is held at a time."""
    _, given = filled(tmp_path / "run", 3, 1, 5)
    found = load_result(tmp_path / "run")
    parts = list(found.parts())
    assert [len(part) for part in parts] == [3, 1, 5]
    for name in array_names():
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert np.array_equal(joined, getattr(stacked(given), name))
    (tmp_path / "run" / "chunk_0001.npz").unlink()
    with pytest.raises(ResultError, match=r"chunk_0001.npz is missing; changed while it was read; try again"):
        list(found.parts())


def test_other_peoples_folders_are_left_alone(tmp_path):
    """A non-empty folder is refused, and `overwrite` replaces results only, file by file."""
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "scene.toml").write_text("precious")
    for overwrite in (False, True):
        with pytest.raises(ResultError, match=r"found 'scene.toml' in it"):
            writer(mine, overwrite=overwrite)
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultError, match="cannot be a result folder"):
        writer(tmp_path / "file")
    with pytest.raises(ResultError, match="cannot be written"):
        filled(tmp_path / "file" / "run", 3)
    filled(tmp_path / "run", 2, 2)
    (tmp_path / "run" / "notes.txt").write_text("keep")
    with pytest.raises(ResultError, match=r"try --resume, --overwrite"):
        writer(tmp_path / "run")
    again = writer(tmp_path / "run", overwrite=True)
    assert load_result(tmp_path / "run").samples == 4  # untouched until there is something new
    again.add(samples(1)[0])
    again.finish(None)
    assert load_result(tmp_path / "run").samples == 1
    assert (tmp_path / "run" / "notes.txt").read_text() == "keep"
    assert not (tmp_path / "run" / "chunk_0001.npz").exists()


def out_of_space(*_):
    """Do what a full disk does."""
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("which", range(5))
def test_failed_flush_can_be_repeated(which, call, tmp_path, monkeypatch):
    """A flush that a full disk broke off anywhere loses nothing: the next one writes the same samples."""
    w, given = filled(tmp_path / "run", 2)
    more = samples(3, 2)
    for one in more:
        w.add(one)
    real, calls = getattr(os, call), []
    with monkeypatch.context() as patched:
        patched.setattr(os, call, lambda *a: calls.append(a) or (out_of_space if len(calls) > which else real)(*a))
        broken = which < {"fsync": 4, "replace": 2}[call]  # two files, and the folder after each
        with pytest.raises(ResultError, match="No space left on device") if broken else contextlib.nullcontext():
            w.flush()
    assert not list((tmp_path / "run").glob("*.part"))
    assert load_result(tmp_path / "run").samples in ((2, 5) if broken else (5,))
    w.finish(None)
    same_bits(load_result(tmp_path / "run").trajectory, stacked([*given, *more]))


class Forgetful:
    """A checkpoint whose memory cannot be written."""

    def to_data(self):
        """Refuse."""
        raise ResultError("now.memory: expected numbers, got lambda")


def test_when_it_flushes(tmp_path, monkeypatch):
    """The first sample at once, then when many wait, or few for long."""
    w, now = writer(tmp_path / "run"), [0.0]
    monkeypatch.setattr(result_folder.time, "monotonic", lambda: now[0])
    on_disk = []
    for k, one in enumerate(samples(CHUNK + 4)):
        now[0] = 6.0 if k == CHUNK + 3 else 0.0
        w.add(one)
        w.mark(Forgetful())
        on_disk.append(w.samples)
    assert on_disk == [1] * CHUNK + [CHUNK + 1] * 3 + [CHUNK + 4]


def test_a_memory_that_cannot_be_written(tmp_path):
    """It costs the run nothing but that it cannot go on, and the folder says why."""
    w = writer(tmp_path / "run")
    w.add(samples(1)[0])
    w.mark(Forgetful())
    assert load_result(tmp_path / "run").samples == 1
    with pytest.raises(ResultError, match=r"cannot be resumed: now.memory: expected numbers, got lambda"):
        type(w).resume(tmp_path / "run", w._meta, SCENE)


CHAIN, STATE = problem("one")
UP = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def hang(t, now, memory):
    """Exert nothing."""
    return np.zeros(CHAIN.joint_count), memory


def heave(t):
    """Move the base up, faster and faster."""
    base = CHAIN.arms["arm1"].base
    return hf.Pose(base.R, base.p + 0.05 * t**2 * UP[3:]), 0.1 * t * UP, 0.1 * UP


@pytest.mark.parametrize("moving", [False, True])
def test_same_as_saved(tmp_path, monkeypatch, moving):
    """Samples, options, summary and motions of bases are those that `run.save` writes."""
    monkeypatch.setattr(result_folder, "LONGEST_WAIT", 0.0)
    options = {"base_motion": {"arm1": heave}} if moving else {}
    run = hf.simulate(CHAIN, STATE, hang, 0.005, 0.001, folder=tmp_path / "on", **options)
    run.save(tmp_path / "saved")
    on, saved = (hf.load_result(tmp_path / name) for name in ("on", "saved"))
    assert on.complete and on.note == "" and on.chunks == (1,) * 6
    assert same_array(on.trajectory.q, run.q) and same_array(on.trajectory.grasp_wrench, saved.trajectory.grasp_wrench)
    assert (on.meta.options, on.meta.model_sha256) == (saved.meta.options, saved.meta.model_sha256)
    for name in ("summary.json", "model.json", *(["bases.npz"] if moving else [])):
        assert (tmp_path / "on" / name).read_bytes() == (tmp_path / "saved" / name).read_bytes()


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_ended_half_way(tmp_path, error):
    """Samples so far can be read meanwhile and afterwards; an earlier run is replaced only when told to."""
    seen = []

    def end(t):
        seen.append(hf.load_result(tmp_path / "run").samples)
        if t > 0.0025:
            raise error

    with pytest.raises(error):
        hf.simulate(CHAIN, STATE, hang, 0.005, 0.001, folder=tmp_path / "run", progress=end)
    left = hf.load_result(tmp_path / "run")
    assert seen == [1, 1, 1] and left.samples == 4 and "incomplete, up to t = 0.003 s of 0.005 s" in left.note
    with pytest.raises(hf.errors.ResultError, match="holds an earlier result; try overwrite=True"):
        hf.simulate(CHAIN, STATE, hang, 0.002, 0.001, folder=tmp_path / "run")
    assert len(hf.simulate(CHAIN, STATE, hang, 0.002, 0.001, folder=str(tmp_path / "run"), overwrite=True)) == 3
    assert hf.load_result(tmp_path / "run").samples == 3


def test_nothing_begun(tmp_path):
    """A run that is refused leaves no folder."""
    with pytest.raises(hf.errors.StateError):
        hf.simulate(CHAIN, STATE, lambda t, now, memory: (np.zeros(3), None), 0.005, 0.001, folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()
