"""Anchors in scenes: where the scene says or where their grasps are; what runs, is kept, shown and exported of them."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.dynamics import closure
from tests.scenario.test_build import loaded, refusal
from tests.systems.problems import largest_gaps

SCENE = """
simulation = { duration = 0.05, step = 0.01, scheme = "dop853" }
object = { mass = 2, box = [0.2, 0.1, 0.6], pose = { position = [0, 0, 1], rpy = [0.3, 0, 0.2] } }

[[arms]]
name = "pin"
anchor = true

[[grasps]]
arm = "pin"
kind = "hinge"
position = [0, 0, 0.3]
"""
SWAYING = """base_motion = { shift = { amplitude = [0, 0.1, 0], frequency = [0, 2, 0] }}
"""
BESIDE_A_PANDA = (
    SCENE
    + """
[[arms]]
name = "right"
robot = "panda"
base = { position = [0.5, 0, 0.6], rpy = [0, 0, 3.141592653589793] }

[[grasps]]
arm = "right"
kind = "ball"
position = [0.1, 0, 0]
rpy = [0, -1.5707963267948966, 0]
"""
)


def test_where_its_grasp_is(tmp_path):
    """Without a base an anchor stands where its grasp touches the object; with one, there."""
    found = loaded(tmp_path, SCENE)
    pin, frame = found.chain.arms["pin"], found.chain.grasps["pin"].frame
    assert isinstance(pin, hf.Anchor)
    np.testing.assert_allclose(pin.base.p, (found.state.object_frame @ frame).p, rtol=1e-15)
    assert largest_gaps(closure(found.chain, found.state))[0] < 1e-14
    wxyz = ", ".join(map(repr, pin.base.wxyz_xyz[:4].tolist()))
    position = ", ".join(map(repr, pin.base.p.tolist()))
    said = f"anchor = true\nbase = {{ position = [{position}], quaternion = [{wxyz}] }}"
    again = loaded(tmp_path, SCENE.replace("anchor = true", said))
    np.testing.assert_allclose(again.chain.arms["pin"].base.p, pin.base.p, rtol=1e-15)


def test_beside_an_arm(tmp_path):
    """An arm is led to the object that the anchor holds."""
    found = loaded(tmp_path, BESIDE_A_PANDA)
    assert largest_gaps(closure(found.chain, found.state))[0] < 1e-9
    assert found.state.q.shape == (7,)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("anchor = true", "anchor = false", "$.arms[0]: expected one of robot, urdf, joints and anchor, got none"),
        ("anchor = true", 'anchor = true\nrobot = "panda"', "got robot and anchor"),
        ("anchor = true", "anchor = true\nq = [0.1]", "$.arms[0].q: expected 0 joint positions for a pin, got 1"),
        ("anchor = true", "anchor = true\nbase = { position = [0, 0, 1] }", "arm 'pin' misses its grasp by 0.3"),
        ("anchor = true", "anchor = 1", "$.arms[0].anchor: Expected `bool`, got `int`"),
    ],
)
def test_what_is_refused(tmp_path, old, new, said):
    """On one line, with its place."""
    if "misses" in said:
        with pytest.raises(hf.errors.ClosureError, match=said.replace(".", r"\.")):
            loaded(tmp_path, SCENE.replace(old, new))
        return
    assert said in refusal(tmp_path / "scene.toml", SCENE.replace(old, new))


@pytest.mark.slow
@pytest.mark.parametrize("text", [SCENE, BESIDE_A_PANDA], ids=["alone", "beside an arm"])
def test_run_kept_shown_and_exported(tmp_path, monkeypatch, capsys, text):
    """A scene whose anchor sways runs from the command line; its folder opens, resumes, is drawn and exported."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(text.replace("anchor = true\n", f"anchor = true\n{SWAYING}"))
    assert main(["simulate", "scene.toml", "--out", "run"]) == 0
    run = hf.load_result("run").trajectory
    assert np.abs(run.base_wrench[:, 0]).max() > 1
    assert np.abs(run.imbalance).max() < 1e-7 * run.kinetic.max()
    for command in (["plot", "run"], ["view", "run", "--export", "page.html"], ["export", "run"]):
        assert main(command) == 0, capsys.readouterr().err
    assert "pin" in (tmp_path / "page.html").read_text(encoding="utf-8")
