"""Folders that holdfast 0.1 wrote are read, number for number; they are not continued."""

import json
import shutil
from pathlib import Path

import pytest

import holdfast as hf
from holdfast.io.result_folder import ResultWriter
from tests.simulation.rollout.problems import swinging_law

OLD = Path(__file__).parents[1] / "data" / "folders_0_1"
EXPECTED = json.loads((OLD / "expected.json").read_text())


@pytest.mark.parametrize("name", ["scene_run", "saved_run"])
def test_results(name):
    """A scene's run with a robot from a file, and a run made in Python whose base moved."""
    found = hf.load_result(OLD / name)
    assert found.complete and found.note == ""
    assert found.trajectory.t.tolist() == EXPECTED[name]["t"]
    assert found.trajectory.q.tolist() == EXPECTED[name]["q"]
    assert found.setting.chain.joint_names() == found.meta.joints
    assert ("arm1" in found.setting.base_motion) == (name == "saved_run")
    assert found.summary().samples == len(EXPECTED[name]["t"])


def test_damaged_results(tmp_path):
    """Chunks that were exchanged, or are damaged, are named; a run cannot be resumed, but replaced."""
    folder = shutil.copytree(OLD / "saved_run", tmp_path / "run")
    first, second = folder / "chunk_0000.npz", folder / "chunk_0001.npz"
    contents = first.read_bytes(), second.read_bytes()
    second.write_bytes(contents[0])
    first.write_bytes(contents[1])
    assert "chunk_0001.npz does not continue the previous chunks" in hf.load_result(folder).note
    first.write_bytes(contents[0])
    second.write_bytes(contents[0][:-9])
    assert "chunk_0001.npz is damaged" in hf.load_result(folder).note
    meta = json.loads((folder / "meta.json").read_text()) | {"complete": False}
    (folder / "meta.json").write_text(json.dumps(meta))
    made = hf.load_result(folder).meta
    with pytest.raises(hf.errors.ResultError, match=r"written by holdfast 0\.1: it can be read, but not resumed"):
        ResultWriter.resume(folder, made, (folder / "scene.toml").read_text())
    hf.load_result(OLD / "saved_run").save(folder, overwrite=True)
    assert hf.load_result(folder).meta.format_version == 3
    assert hf.load_result(folder).trajectory.q.tolist() == EXPECTED["saved_run"]["q"]


def test_record(tmp_path):
    """Arrays, statuses and systems; saved again, a record has the present format.

    The rollout is of the record's own chain: last digits of a random one belong to the processor's BLAS.
    """
    chain = hf.io.load_record(OLD / "record").systems.chain
    swinging = hf.compile_rollout(chain, swinging_law(chain.joint_count))
    for folder in (OLD / "record", hf.io.load_record(OLD / "record").save(tmp_path / "again")):
        found = hf.io.load_record(folder, swinging)
        assert found.note == "" and found.t.tolist() == EXPECTED["record"]["t"]
        assert found["q"].tolist() == EXPECTED["record"]["q"]
        assert [[one.name for one in row] for row in found["status"]] == EXPECTED["record"]["status"]
    folder = shutil.copytree(OLD / "record", tmp_path / "record")
    found.save(folder, overwrite=True)
    assert not (folder / "record.npz").exists()
    shutil.copytree(OLD / "record", folder, dirs_exist_ok=True)
    (folder / "record.json").unlink()
    (folder / "record.npz").write_bytes(b"PK")
    with pytest.raises(hf.errors.ResultError, match=r"record\.npz is damaged"):
        hf.io.load_record(folder)


def test_sweep(tmp_path):
    """Its columns are read with any installation; no run is computed in its folder, and none of its is lost."""
    pytest.importorskip("pyarrow", reason="needs pyarrow: pip install 'holdfast[parquet]'")
    folder = shutil.copytree(OLD / "sweep", tmp_path / "sweep")
    plan = json.loads((folder / "sweep.json").read_text())
    plan["plan"]["versions"]["numpy"] = "1.0"
    (folder / "sweep.json").write_text(json.dumps(plan))
    found = hf.sweeps.load_sweep(folder)
    for title, numbers in EXPECTED["sweep"].items():
        assert found.column(title).tolist() == numbers
    with pytest.raises(hf.errors.ResultError, match=r"cannot be repeated with identical bits, since .*versions differ"):
        found.run(1)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(hf.errors.ResultError, match="versions differ"):
        hf.sweeps.sweep_scene(hf.sweeps.of_scene.kept_scene(folder), folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
