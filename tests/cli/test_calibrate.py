"""`holdfast calibrate`: a table of postures of a scene, and its answer."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf

SCENE = Path(__file__).parents[2] / "examples" / "two_pandas.toml"


def written(folder: Path, spoiled: float) -> Path:
    """Return a table of postures around the initial state of the scene."""
    scenario = hf.load_scene(SCENE)
    random, chain, state = np.random.default_rng(0), scenario.chain, scenario.state
    head, rows = [f"q {name} [rad]" for name in chain.joint_names()], []
    for k in range(8):
        at = state.object_frame
        pose = hf.Pose.from_rpy(*random.uniform(-0.2, 0.2, 3)) @ hf.Pose(at.R, [0, 0, 0])
        moved = hf.Pose(pose.R, at.p + random.uniform(-0.05, 0.05, 3))
        q = hf.close(chain, hf.State(state.q, 0 * state.qd, moved.wxyz_xyz), hold_object=True).q
        rows.append(q + (spoiled if k == 0 else 0.0))
    path = folder / f"postures{spoiled}.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in [head, *(row.tolist() for row in rows)]))
    return path


@pytest.mark.slow
def test_a_table_of_postures(tmp_path, cli):
    good, bad = written(tmp_path, 0.0), written(tmp_path, 0.05)
    options = ["--model", SCENE, "--noise", "1e-4", "1e-4", "1e-4", "--held-out", good]
    out = cli("calibrate", good, *options).out
    assert "misfit" in out
    assert "held out" in out
    answer = json.loads(cli("calibrate", good, *options, "--seek", "bases", "--format", "json").out)
    assert len(answer["values"]) == 6
    assert max(map(abs, answer["values"].values())) < 1e-5
    assert answer["notes"] == []
    assert "calibration.html" in cli("calibrate", good, *options, "--seek", "bases", "--out", tmp_path / "out").out
    page = (tmp_path / "out" / "calibration.html").read_text()
    assert "Good fit" in page and page.count("data:image/png") == 2 and "http" not in page
    assert "times the given noise" in cli("calibrate", bad, *options, code=3).out
    assert "try hf.calibrate" in cli("calibrate", good, *options, "--seek", "sensors", code=2).err
