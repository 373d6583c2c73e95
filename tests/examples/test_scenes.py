"""The example scenes: what happens in them obeys the laws that they are about."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.scenario.build import Scenario, load_scene

EXAMPLES = Path(__file__).parents[2] / "examples"
# and how long they last [s]
SCENES = {"torso": 1.5, "hand_on_arm": 0.6, "free_flyer": 2.0, "box_lift": 1.0, "place_on_table": 0.8}


def simulated(name: str, duration: float) -> tuple[Scenario, hf.Trajectory]:
    """Return an example and its run up to a time."""
    scene = load_scene(EXAMPLES / f"{name}.toml")
    run = hf.simulate(scene.chain, scene.state, scene.controller, duration, scene.step, **scene.options)
    assert run.stopped is None
    assert run.position_gap[:, 1].max() < 1e-12
    return scene, run


def test_all_are_listed():
    """Each scene stands in the folder's README, and lasts as long as is said here."""
    readme = (EXAMPLES / "README.md").read_text()
    for name, duration in SCENES.items():
        assert f"]({name}.toml)" in readme
        assert load_scene(EXAMPLES / f"{name}.toml").duration == duration


@pytest.mark.slow
def test_torso():
    """Its springs drive waist and lean towards their set points; the floor bears all weights and what moves them."""
    scene, run = simulated("torso", 0.2)
    names = scene.chain.joint_names()
    waist, bend, lean = (run.q[-1, names.index(f"trunk/{name}")] for name in ("waist", "bend", "lean"))
    assert 0.2 < waist < 0.8 and 0.05 < lean < 0.15 and abs(bend) < 0.1
    carried = run.grasp_wrench[..., 3:].sum(axis=1) - 2.0 * (run.object_acceleration[:, 3:] - scene.chain.gravity)
    assert np.abs(carried).max() < 1e-10
    assert np.abs(run.momentum_imbalance).max() < 5e-3 * np.abs(run.momentum).max()
    assert np.abs(run.imbalance).max() < 2e-3 * np.abs(run.work).max()


@pytest.mark.slow
def test_hand_on_arm():
    """The torques turn the first joint at 4 rad/s^2 and hold all others; springs alone pinch the ball."""
    scene, run = simulated("hand_on_arm", 0.05)
    assert run.q[-1, 0] == pytest.approx(0.5 * 4.0 * 0.05**2, rel=0.02)
    assert np.abs(run.q[-1, 1:7] - run.q[0, 1:7]).max() < 2e-3
    assert not run.tau[:, 7:].any()
    inward = [grasp.frame.R[:, 2] for grasp in scene.chain.grasps.values()]
    for k in range(len(run)):
        R = hf.Pose.from_wxyz_xyz(run.object_pose[k]).R
        pressed = [(R @ n) @ f[3:] for n, f in zip(inward, run.grasp_wrench[k], strict=True)]
        assert pressed == pytest.approx([5.0] * 3, abs=0.5)
    assert run.margin.min() > 3.0


@pytest.mark.slow
def test_free_flyer():
    """Two hands grip in flight at a difference of velocities: energy is lost, momentum not at all."""
    scene = load_scene(EXAMPLES / "free_flyer.toml")
    early = [replace(event, t=t) for event, t in zip(scene.options["events"], (0.02, 0.04), strict=True)]
    options = {**scene.options, "events": early}
    run = hf.simulate(scene.chain, scene.state, scene.controller, 0.1, scene.step, **options)
    assert run.stopped is None
    chain = scene.chain
    arms = sum(link.mass for arm in chain.arms.values() for link in arm.links)
    ship = (chain.trunk.floating.mass + arms) * 0.025
    assert run.momentum[0, 3:] == pytest.approx([ship - 0.2 * chain.held_object.mass, 0, 0], abs=1e-12)
    size = np.linalg.norm(run.momentum[0])
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-6 * size
    assert [one.kind for one in run.occurrences] == ["attach", "attach"]
    assert all(one.energy_change < -1e-3 and not any(one.trunk_base_impulse) for one in run.occurrences)
    assert run.impact[-1] == pytest.approx(sum(one.energy_change for one in run.occurrences))
    assert run.holding[-1].all() and not run.holding[0].any()
    assert np.abs(run.imbalance).max() < 1e-3 * abs(run.impact[-1])


@pytest.mark.slow
def test_box_lift():
    """Each hand keeps the margin that was asked, and the drives their share, while the box rises along its path."""
    scene, run = simulated("box_lift", 0.1)
    assert np.abs(run.margin - 2.0).max() < 1e-5
    limits = np.array([joint.effort_limit for joint in scene.chain.all_joints])
    assert (np.abs(run.tau) <= 0.8 * limits * (1 + 1e-9)).all()
    x = run.t / 0.8
    height = 0.62 + 0.2 * (10 * x**3 - 15 * x**4 + 6 * x**5)
    assert np.abs(run.object_pose[:, 6] - height).max() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_to_the_end(name, tmp_path, cli):
    """From the command line to the page, without a word of complaint."""
    assert main(["simulate", str(EXAMPLES / f"{name}.toml"), "--out", str(tmp_path / "run")]) == 0
    assert "note:" not in cli("view", tmp_path / "run", "--export", tmp_path / "page.html").err
    run = hf.load_result(tmp_path / "run").trajectory
    assert run.t[-1] == SCENES[name]
    if name == "torso":  # it comes to rest at its set points, but for what its arms sag
        assert run.q[-1, :3] == pytest.approx([0.8, 0.0, 0.15], abs=0.1)
        assert np.abs(run.qd[-1]).max() < 0.1
    if name == "place_on_table":
        assert run.stopped is None and run.touch_gap.min() >= -1e-12
        assert run.touch_force[-1, :, 2].sum() == pytest.approx(3.0 * 9.81, rel=1e-9)
