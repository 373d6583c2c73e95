"""A result folder is whole or absent, readable while it is written, and never overwrites by accident."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from holdfast import ResultError
from holdfast.io.result_folder import CHUNK, ResultWriter, run_meta
from holdfast.io.result_reader import load_result
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Trajectory, array_names, stacked
from tests.control.two_pandas import two_pandas

SHAPES = {"t": (), "q": (14,), "qd": (14,), "qdd": (14,), "tau": (14,), "object_pose": (7,), "object_twist": (6,),
          "object_acceleration": (6,), "grasp_wrench": (2, 6), "base_wrench": (2, 6), "position_gap": (2,),
          "velocity_gap": (2,), "kinetic": (), "potential": (), "work": (4,), "condition": ()}  # fmt: skip
EXAMPLE = Path(__file__).parents[2] / "examples" / "two_pandas.toml"


def samples(count):
    rng = np.random.default_rng(0)
    return [
        Trajectory(
            **{name: rng.normal(size=SHAPES[name]) for name in array_names() if name != "t"}, t=np.array(0.1 * k)
        )
        for k in range(count)
    ]


def writer(folder, **options):
    chain, _ = two_pandas()
    return ResultWriter(folder, run_meta(chain, "test", 30.0, 0.1), 'name = "test"\n', **options)


def filled(folder, count):
    w, given = writer(folder), samples(count)
    for one in given:
        w.add(one)
    return w, given


def test_round_trip(tmp_path):
    """Every array comes back bit for bit, with the scene, the names and the units."""
    chain, _ = two_pandas()
    w, given = filled(tmp_path / "a" / "run", 2 * CHUNK + 50)
    w.finish(summarise(chain, stacked(given)))
    found = load_result(tmp_path / "a" / "run")
    assert found.complete
    assert found.note == ""
    assert found.scene_text == 'name = "test"\n'
    for name in array_names():
        assert np.array_equal(getattr(found.trajectory, name), [getattr(one, name) for one in given])
    assert found.meta["joints"][:2] == ["left/joint1", "left/joint2"]
    assert set(found.meta["units"]) == set(array_names())
    assert json.loads((tmp_path / "a/run/summary.json").read_text())["samples"] == len(given)
    assert sorted(p.name for p in (tmp_path / "a/run").iterdir()) == [
        "chunk_0000.npz", "chunk_0001.npz", "chunk_0002.npz", "meta.json", "scene.toml", "summary.json"]  # fmt: skip


def test_nothing_before_the_first_flush(tmp_path):
    """A run that never got a sample leaves no folder; one that got a few leaves them at the end."""
    writer(tmp_path / "run").finish(None, stopped="nothing")
    assert not (tmp_path / "run").exists()
    w, _ = filled(tmp_path / "run", 3)
    assert not (tmp_path / "run").exists()
    w.finish(None, stopped="stopped after t = 0.2 s: singular")
    found = load_result(tmp_path / "run")
    assert not found.complete
    assert len(found.trajectory) == 3
    assert found.note == "incomplete, up to t = 0.2 s of 30.0 s: stopped after t = 0.2 s: singular"


def test_half_written_run_is_read_up_to_the_last_chunk(tmp_path):
    """A writer that simply ends: the last flush is there, and the note says how far it got."""
    _, given = filled(tmp_path / "run", 2 * CHUNK + 7)
    (tmp_path / "run" / "chunk_0002.npz.part").write_bytes(b"half")
    found = load_result(tmp_path / "run")
    assert len(found.trajectory) == 2 * CHUNK
    assert not found.complete
    assert found.note == f"incomplete, up to t = {given[2 * CHUNK - 1].t:.6g} s of 30.0 s: interrupted"


def test_damaged_and_missing_chunks(tmp_path):
    """What comes before a damaged or missing chunk is read, and the note names it."""
    w, _ = filled(tmp_path / "run", 3 * CHUNK)
    w.finish(None)
    chunk = tmp_path / "run" / "chunk_0001.npz"
    whole = chunk.read_bytes()
    chunk.write_bytes(whole[: len(whole) // 2])
    found = load_result(tmp_path / "run")
    assert len(found.trajectory) == CHUNK
    assert "chunk_0001.npz is damaged" in found.note
    chunk.unlink()
    assert "chunk_0001.npz is missing" in load_result(tmp_path / "run").note
    (tmp_path / "run" / "chunk_0000.npz").write_bytes(b"")
    with pytest.raises(ResultError, match=r"chunk_0000.npz is damaged"):
        load_result(tmp_path / "run")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: None, "no such folder"),
        (lambda folder: folder.mkdir(), "meta.json: cannot be read"),
        (lambda folder: (folder.mkdir(), (folder / "meta.json").write_text("{")), "not valid JSON"),
        (lambda folder: (folder.mkdir(), (folder / "meta.json").write_text("[]")), "not valid JSON"),
        (lambda folder: (folder.mkdir(), (folder / "meta.json").write_text("{}")), "expected format 'holdfast-result'"),
    ],
)
def test_no_result_there(make, message, tmp_path):
    """A folder that holds no result is refused by name."""
    make(tmp_path / "run")
    with pytest.raises(ResultError, match=message):
        load_result(tmp_path / "run")


def test_other_peoples_folders_are_left_alone(tmp_path):
    """A non-empty folder is refused, and `overwrite` replaces results only, file by file."""
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "scene.toml").write_text("precious")
    for overwrite in (False, True):
        with pytest.raises(ResultError, match=r"found 'scene.toml' in it"):
            writer(mine, overwrite=overwrite)
    filled(tmp_path / "run", 3 * CHUNK)
    (tmp_path / "run" / "notes.txt").write_text("keep")
    with pytest.raises(ResultError, match="try --overwrite"):
        writer(tmp_path / "run")
    again = writer(tmp_path / "run", overwrite=True)
    assert len(load_result(tmp_path / "run").trajectory) == 3 * CHUNK  # untouched until there is something new
    again.add(samples(1)[0])
    again.finish(None)
    assert len(load_result(tmp_path / "run").trajectory) == 1
    assert (tmp_path / "run" / "notes.txt").read_text() == "keep"


def test_unusable_places(tmp_path):
    """A file where the folder should be."""
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultError, match="cannot be a result folder"):
        writer(tmp_path / "file")
    w, _ = filled(tmp_path / "file" / "run", 3)
    with pytest.raises(ResultError, match="cannot be written"):
        w.flush()


def test_failed_flush_can_be_repeated(tmp_path, monkeypatch):
    """A flush that a full disk broke off loses nothing: the next one writes the same samples."""
    w, given = filled(tmp_path / "run", 5)
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", lambda *paths: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(ResultError, match="No space left on device"):
            w.flush()
    w.finish(None)
    assert np.array_equal(load_result(tmp_path / "run").trajectory.t, [one.t for one in given])


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_killed_run_is_readable(tmp_path):
    """SIGKILL in the middle of a simulation: what was flushed is there, in order and closed."""
    scene = tmp_path / "scene.toml"
    scene.write_text(EXAMPLE.read_text().replace("duration = 2.0", "duration = 50.0"))
    command = [sys.executable, "-c", "from holdfast.cli import main; main()", "simulate", str(scene)]
    command += ["--out", str(tmp_path / "run")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(600):
            if (tmp_path / "run" / "meta.json").exists() or process.poll() is not None:
                break
            time.sleep(0.1)
    finally:
        process.kill()
        process.wait()
    found = load_result(tmp_path / "run")
    assert not found.complete
    assert len(found.trajectory) >= CHUNK
    assert found.trajectory.position_gap[:, 1].max() <= 1e-12
    assert "interrupted" in found.note
