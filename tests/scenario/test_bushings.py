"""Bushings in scenes: slack, or stretched from an anchor; run, drawn, and resumed to the bit."""

import tomllib

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.dynamics import potential_energy
from holdfast.scenario.build import load_scene
from holdfast.view.chain_scene import ChainScene
from holdfast.view.playback import playback_of_run
from tests.scenario.test_anchors import loaded
from tests.scenario.test_build import TEXT, refusal
from tests.simulation.test_checkpoint import on_disk
from tests.view.test_chain_scene import Notebook

SOFT = """kind = "bushing"
stiffness = [8, 8, 8, 2000, 2000, 3000]
damping = [0.1, 0.1, 0.1, 30, 30, 30]"""
PUSHED = """
[[wrenches]]
force = [0, 40, 20]
"""
FULL = """kind = "bushing"
stiffness = [
  [9, 1, 0, 0, 0, 20],
  [1, 8, 0, 0, 0, 0],
  [0, 0, 7, 0, 0, 0],
  [0, 0, 0, 2000, 0, 0],
  [0, 0, 0, 0, 2000, 0],
  [20, 0, 0, 0, 0, 3000],
]"""


def soft(bushing: str = SOFT) -> str:
    """Return the scene of two Pandas, the right one of which holds by a bushing."""
    before, after = TEXT.split('[[grasps]]\narm = "right"')
    assert 'kind = "rigid"' in after
    return before + '[[grasps]]\narm = "right"' + after.replace('kind = "rigid"', bushing, 1)


@pytest.mark.parametrize("bushing", [SOFT, FULL], ids=["along the axes", "6 x 6"])
def test_slack(tmp_path, bushing):
    """The arm is led to where its bushing is slack."""
    found = loaded(tmp_path, soft(bushing))
    grasp = found.chain.grasps["right"]
    given = tomllib.loads(bushing)["stiffness"]
    assert grasp.kind == "bushing" and np.array_equal(grasp.stiffness, given)
    made = np.array(grasp.of_kind.bushing.stiffness)
    assert np.array_equal(made, np.diag(given) if made.ndim != np.ndim(given) else given)
    wrench = hf.forward_dynamics(found.chain, found.state, np.zeros(14))["right"].grasp_wrench
    assert np.abs(wrench).max() < 1e-6


def test_stretched_from_an_anchor(tmp_path):
    """An anchor stays where the scene has it, its bushing stretched by how far that is from its grasp."""
    text = f"""
simulation = {{ duration = 0.05, step = 0.01 }}
object = {{ mass = 2, box = [0.2, 0.1, 0.6], pose = {{ position = [0, 0, 1] }} }}

[[arms]]
name = "pin"
anchor = true
base = {{ position = [0, 0.02, 1.3] }}

[[grasps]]
arm = "pin"
position = [0, 0, 0.3]
{SOFT}
"""
    found = loaded(tmp_path, text)
    weight = potential_energy(found.chain.without_grasp("pin"), found.state)
    assert potential_energy(found.chain, found.state) - weight == pytest.approx(0.5 * 2000 * 0.02**2, rel=1e-12)
    slack = loaded(tmp_path, text.replace("base = { position = [0, 0.02, 1.3] }\n", ""))
    assert potential_energy(slack.chain, slack.state) == pytest.approx(weight, rel=1e-12)


@pytest.mark.parametrize(
    ("bushing", "said"),
    [
        ('kind = "bushing"', "$.grasps[1]: a bushing grasp needs a stiffness"),
        ('kind = "rigid"\nstiffness = [1, 1, 1, 1, 1, 1]', "$.grasps[1]: a rigid grasp has no stiffness"),
        ('kind = "bushing"\nstiffness = [1, 1, 1]', "expected shape (6,) or (6, 6), got shape (3,)"),
        ('kind = "bushing"\nstiffness = [1, [1], 1]', "$.grasps[1]"),
        ('kind = "bushing"\nstiffness = [1, 1, 1, 1, 1, -1]', "expected numbers >= 0 on the diagonal"),
    ],
)
def test_what_is_refused(tmp_path, bushing, said):
    """On one line, with its place."""
    assert said in refusal(tmp_path / "scene.toml", soft(bushing))


@pytest.mark.slow
def test_a_run(tmp_path, monkeypatch, capsys):
    """From the command line; the folder is drawn and exported, a coil in the pictures from tip to contact."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(soft().replace("duration = 2.0", "duration = 0.05") + PUSHED)
    assert main(["simulate", "scene.toml", "--out", "run"]) == 0
    for command in (["plot", "run"], ["view", "run", "--export", "page.html"], ["export", "run"]):
        assert main(command) == 0, capsys.readouterr().err
    chain, run = load_scene(tmp_path / "scene.toml").chain, hf.load_result("run").trajectory
    assert np.abs(run.grasp_wrench[-1, 1]).max() > 0.1 and np.abs(run.imbalance).max() < 1e-6
    playback, notebook = playback_of_run(chain, run, "run"), Notebook()
    ChainScene(notebook, playback).show(len(playback) - 1)
    lines = notebook.pointed["/springs/0"]
    contact = hf.Pose.from_wxyz_xyz(playback.object_pose[-1]) @ chain.grasps["right"].frame
    assert lines[0, 0] == pytest.approx(playback.tip[-1, 1]) and lines[-1, 1] == pytest.approx(contact.p)


@pytest.mark.slow
def test_goes_on_to_the_same_bits(tmp_path):
    """A checkpoint keeps stiffness and damping: the rest of the run is what it was."""
    (tmp_path / "scene.toml").write_text(soft(FULL))
    scene, kept = load_scene(tmp_path / "scene.toml"), []
    given = (scene.chain, scene.state, scene.controller, 0.01, 0.002)
    whole = hf.simulate(*given, on_checkpoint=kept.append)
    rest = hf.simulate(*given, start=on_disk(kept[2]))
    assert rest.q.tobytes() == whole.q[3:].tobytes() and rest.grasp_wrench.tobytes() == whole.grasp_wrench[3:].tobytes()
