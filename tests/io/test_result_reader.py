"""Whatever became of a result folder: what is whole is read, and the rest is said; nothing else is ever raised."""

import json

import numpy as np
import pytest

from holdfast.errors import ResultError
from holdfast.io.result_reader import load_result
from holdfast.simulation import trajectory
from holdfast.simulation.trajectory import stacked
from tests.io.recorded import filled, same_bits
from tests.io.signing import as_0_1, resigned


def test_half_written_run_is_read_up_to_the_last_flush(tmp_path):
    """A writer that died: the last flush is there, and the note says how far it got and what is left over."""
    _, given = filled(tmp_path / "run", 5, 7)
    (tmp_path / "run" / "chunk_0002.npz.part").write_bytes(b"half")
    found = load_result(tmp_path / "run")
    same_bits(found.trajectory, stacked(given))
    assert not found.complete
    assert found.note == "incomplete, up to t = 1.1 s of 30.0 s: interrupted, or still running"
    (tmp_path / "run" / "chunk_0002.npz").write_bytes(b"never named")
    assert load_result(tmp_path / "run").note == found.note + "; chunk_0002.npz is not part of the run"


def test_damaged_and_missing_chunks(tmp_path):
    """What comes before a damaged or missing chunk is read, and the note names it."""
    w, given = filled(tmp_path / "run", 2, 2, 2)
    w.finish(None)
    chunk = tmp_path / "run" / "chunk_0001.npz"
    whole = chunk.read_bytes()
    chunk.write_bytes(whole[: len(whole) // 2])
    found = load_result(tmp_path / "run")
    assert not found.complete
    assert "chunk_0001.npz is damaged" in found.note
    same_bits(found.trajectory, stacked(given[:2]))
    chunk.unlink()
    assert "chunk_0001.npz is missing" in load_result(tmp_path / "run").note
    (tmp_path / "run" / "chunk_0000.npz").write_bytes(b"")
    with pytest.raises(ResultError, match=r"expected at least one whole chunk of samples, but chunk_0000.npz is dam"):
        load_result(tmp_path / "run")


def test_a_chunk_that_would_fill_the_memory(tmp_path):
    """A chunk that unpacks to 100 MB is called damaged before it is unpacked; so is one that is a folder."""
    _, given = filled(tmp_path / "run", 2, 2)
    chunk = tmp_path / "run" / "chunk_0001.npz"
    with np.load(chunk) as file:
        arrays = dict(file) | {"more": np.zeros(12_500_000)}
    np.savez_compressed(chunk, **arrays)
    assert "chunk_0001.npz is damaged" in load_result(tmp_path / "run").note
    resigned(tmp_path / "run")
    assert chunk.stat().st_size < 1e6
    found = load_result(tmp_path / "run")
    assert "chunk_0001.npz is damaged: it unpacks to more than the size of the file" in found.note
    same_bits(found.trajectory, stacked(given[:2]))
    chunk.unlink()
    chunk.mkdir()
    assert "chunk_0001.npz is not a file" in load_result(tmp_path / "run").note


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: None, "no such folder"),
        (lambda folder: folder.mkdir(), "meta.json is missing; is this a result folder"),
        (lambda folder: (folder.mkdir(), (folder / "meta.json").write_text("{")), "not valid JSON"),
        (lambda folder: (folder.mkdir(), (folder / "meta.json").write_text("[]")), "Expected `object`, got `array`"),
        (lambda folder: (folder.mkdir(), (folder / "meta.json").write_text("{}")), "expected format 'holdfast-result'"),
        (lambda folder: (filled(folder, 2), resigned(folder, format_version=1)), "version 3, got .* version 1"),
        (lambda folder: (filled(folder, 2), (folder / "meta.json").unlink()), "meta.json is missing; .* --overwrite"),
        (lambda folder: (filled(folder, 2), resigned(folder, chunks=[1])), r"expected chunks of 2 samples .* \[1\]"),
        (lambda folder: (filled(folder, 2), resigned(folder, chunks=[2.5])), r"Expected `int`.*chunks\[0\]"),
        (lambda folder: (filled(folder, 2), resigned(folder, chunks=[3], samples=3)), "holds shape .* expected 3"),
        (lambda folder: (filled(folder, 2), resigned(folder, chunks=[], samples=0)), "ended before its first flush"),
    ],
)
def test_no_result_there(make, message, tmp_path):
    """A folder that holds no result, or whose parts contradict each other, is refused by name."""
    make(tmp_path / "run")
    with pytest.raises(ResultError, match=message):
        load_result(tmp_path / "run")


def test_another_scene_in_the_folder(tmp_path):
    """A scene.toml that was edited, or lost, is not passed off as the one that was simulated; samples are read."""
    w, _ = filled(tmp_path / "run", 2)
    w.finish(None)
    (tmp_path / "run" / "scene.toml").write_text("name = ")
    found = load_result(tmp_path / "run")
    assert found.complete
    assert found.note.startswith("scene.toml is damaged, or another file") and "--overwrite" in found.note
    with pytest.raises(ResultError, match=r"scene.toml is damaged.*; the samples can be read without it"):
        _ = found.setting
    (tmp_path / "run" / "scene.toml").unlink()
    assert load_result(tmp_path / "run").note.startswith("scene.toml is missing")


def test_arrays_that_come_and_go(tmp_path, monkeypatch):
    """A result of another version of holdfast says which arrays it lacks, or has beyond this one's."""
    filled(tmp_path / "run", 2)
    names = trajectory.array_names()
    with monkeypatch.context() as later:
        later.setattr("holdfast.io.result_reader.array_names", lambda: [*names, "heat", "noise"])
        with pytest.raises(ResultError, match=r"written by holdfast .*, which had no heat, noise; try that version"):
            load_result(tmp_path / "run")
    resigned(tmp_path / "run", units=json.loads((tmp_path / "run/meta.json").read_text())["units"] | {"heat": "J"})
    assert "its heat are ignored" in load_result(tmp_path / "run").note


def test_results_from_before_there_were_trunks(tmp_path):
    """Without the arrays of a trunk a result is one of a chain without a trunk."""
    _, given = filled(tmp_path / "run", 2)
    chunk = tmp_path / "run" / "chunk_0000.npz"
    np.savez(chunk, **{name: x for name, x in np.load(chunk).items() if name not in trajectory.TRUNK_FIELDS})
    units = json.loads((tmp_path / "run/meta.json").read_text())["units"]
    as_0_1(tmp_path / "run", units={name: unit for name, unit in units.items() if name not in trajectory.TRUNK_FIELDS})
    same_bits(load_result(tmp_path / "run").trajectory, stacked(given))


def test_chunks_of_other_shapes(tmp_path):
    """A chunk of another run in between is not joined to this one."""
    filled(tmp_path / "run", 2, 2)
    chunk = tmp_path / "run" / "chunk_0001.npz"
    arrays = dict(np.load(chunk))
    np.savez(chunk, **arrays | {"q": arrays["q"][:, :3]})
    resigned(tmp_path / "run")
    found = load_result(tmp_path / "run")
    assert found.samples == 2
    assert "chunk_0001.npz does not continue the previous chunks" in found.note
