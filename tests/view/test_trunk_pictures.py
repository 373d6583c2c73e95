"""A trunk is drawn where the dynamics has it, arms where they stand on it; a floating base moves, and is plotted."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.robots.visuals import equivalent_box
from holdfast.spatial import rotation
from holdfast.view.cameras import cameras, trunk_outline
from holdfast.view.chain_scene import ChainScene
from holdfast.view.figure_style import TRUNK_COLOUR, rgb
from holdfast.view.page import plots
from holdfast.view.playback import base_travel, playback_of_run
from holdfast.view.plots import figures
from tests.systems.trunk_runs import still_base, swaying
from tests.view.runs import off_axis
from tests.view.test_chain_scene import Notebook


@pytest.fixture(scope="module", params=["floating", "swaying", "base alone"])
def shown(request):
    """A chain on a trunk, a run of it, its playback, and what is drawn."""
    floats = request.param != "swaying"
    joints = 0 if request.param == "base alone" else 3
    p = still_base(4, joints, floating=floats, arms={"arms": 3, "grasps": "rigid", "joints": 7}, in_world=0.4)
    moving = {} if floats else {"trunk": swaying(p.chain.trunk.base)}
    run = hf.simulate(p.chain, p.state, lambda t, s, m: (p.tau, m), 0.03, 0.01, inputs=p.inputs, base_motion=moving)
    playback, notebook = playback_of_run(p.chain, run, "run", 1e3, moving), Notebook()
    return p.chain, run, playback, notebook, ChainScene(notebook, playback)


def frame_of(playback, k):
    return hf.Pose.from_wxyz_xyz(playback.trunk_pose[k])


@pytest.mark.parametrize("k", [0, 3])
def test_where_everything_is(shown, k):
    """Composed along their names, the nodes of trunk and arms are at the bodies of the dynamics; tips at the grasps."""
    chain, run, playback, notebook, scene = shown
    assert len(playback) == len(run) == 4
    scene.show(k)
    here = replace(chain, trunk=replace(chain.trunk, base=frame_of(playback, k)))
    found = trunk_at_rest(here, run.state(k))
    names = [joint.name or f"joint{j + 1}" for j, joint in enumerate(chain.trunk.joints)]
    first = len(found.bodies) - len(names)
    nodes = ["/".join(["/trunk", *names[: j + 1 - first]]) for j in range(len(found.bodies))]
    for node, body in zip(nodes, found.bodies, strict=True):
        placed = notebook.world_pose(node)
        assert np.abs(placed.R - body.frame.R).max() < 1e-7  # single precision is what a viewer takes
        assert placed.p == pytest.approx(body.frame.p, abs=1e-12)
    for i, (name, arm) in enumerate(chain.arms.items()):
        base = found.mounts[name].frame if name in chain.mounts else arm.base
        assert playback.base_pose[k, i] == pytest.approx(base.wxyz_xyz, abs=1e-12)
        assert notebook.world_pose(f"/arms/{name}").p == pytest.approx(base.p, abs=1e-12)
        contact = hf.Pose.from_wxyz_xyz(playback.object_pose[k]) @ chain.grasps[name].frame
        assert playback.tip[k, i] == pytest.approx(contact.p, abs=1e-9)
        assert forward_kinematics(arm.at(base), run.q[k, chain.joints[name]]).tip.p == pytest.approx(
            playback.tip[k, i], abs=1e-12
        )


def test_the_base_moves(shown):
    """A floating base goes where the run has it, a swaying one where its motion takes it."""
    chain, run, playback, *_ = shown
    assert np.abs(playback.trunk_pose[-1] - playback.trunk_pose[0]).max() > 1e-4
    if chain.floats:
        assert playback.trunk_pose == pytest.approx(run.base_pose)


def test_what_is_drawn(shown):
    """Solids on every body, in the trunk's colour; the base frame's axes; no plate below what floats."""
    chain, _, _, notebook, _ = shown
    roots = {name for name, what in notebook.drawn.items() if what == "mesh" and name.startswith("/trunk")}
    names = [joint.name or f"joint{j + 1}" for j, joint in enumerate(chain.trunk.joints)]
    for j in range(len(names) + 1):
        node = "/".join(["/trunk", *names[:j]])
        carries = j == 0 or j < len(names) or any(k == len(chain.trunk.bodies) - 1 for k in chain.mounted_on.values())
        assert any(drawn.rpartition("/")[0] == node for drawn in roots) or not carries
    assert notebook.drawn["/trunk/(axes)"] == "frame"
    assert ("/trunk/(own)" in notebook.drawn) is not chain.floats
    for name in chain.names:
        assert (f"/arms/{name}/(own)" in notebook.drawn) is (name not in chain.mounts)
        assert notebook.drawn[f"/arms/{name}/(name)"] == name
    assert rgb(TRUNK_COLOUR) not in {notebook.colours[f"/forces/{name}"] for name in chain.names}
    assert "/ground" in notebook.drawn


def test_free_fall_has_no_ground():
    """Where nothing stands in the world and nothing falls, there is no floor to draw."""
    arms = {"arms": 2, "grasps": "rigid", "joints": 7, "gravity": (0, 0, 0)}
    p = still_base(7, 2, floating=True, arms=arms, in_world=0.0)
    run = hf.simulate(p.chain, p.state, lambda t, s, m: (p.tau, m), 0.01, 0.01)
    notebook = Notebook()
    ChainScene(notebook, playback_of_run(p.chain, run))
    assert "/ground" not in notebook.drawn


def test_cameras_see_the_trunk(shown):
    """Its links, and the box of a body that floats, are in every view of the whole chain."""
    chain, _, playback, *_ = shown
    for k in (0, len(playback) - 1):
        outline = trunk_outline(chain.trunk, playback, k)
        if chain.floats:
            edges, box = equivalent_box(chain.trunk.floating)
            corner = (frame_of(playback, k) @ box @ hf.Pose.translation(*edges / 2)).p
            assert np.linalg.norm(outline - corner, axis=1).min() < 1e-12
        for view in cameras(playback)[:4]:
            assert off_axis(view, outline).max() < np.sqrt(2) * np.tan(np.radians(17.5))


def test_curves_and_figures(shown):
    """The trunk's torques are beside those of the arms, and the base's way where it floats."""
    chain, run, playback, *_ = shown
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")
    drawn = figures(chain, run)
    titles = [panel.get_title() for panel in drawn["joint_torques"].axes if panel.get_title()]
    assert titles == [*(["trunk"] if chain.trunk.joint_count else []), *chain.names]
    assert ("base_motion" in drawn) is chain.floats
    away = [plot for plot in plots(playback) if plot["title"].startswith("floating base")]
    assert [len(plot["curves"]) for plot in away] == ([2] if chain.floats and len(playback) > 1 else [])
    if chain.floats:
        shift, turn, velocity, turning = drawn["base_motion"].axes
        for axis in range(3):
            assert shift.lines[axis].get_ydata() == pytest.approx(
                run.base_pose[:, 4 + axis] - run.base_pose[0, 4 + axis]
            )
            assert velocity.lines[axis].get_ydata() == pytest.approx(run.base_twist[:, 3 + axis])
            assert turning.lines[axis].get_ydata() == pytest.approx(run.base_twist[:, axis])
        last = rotation.exp(np.array([turn.lines[axis].get_ydata()[-1] for axis in range(3)]))
        attitudes = [rotation.from_quaternion(pose[:4]) for pose in run.base_pose]
        assert last @ attitudes[0] == pytest.approx(attitudes[-1], abs=1e-12)


def test_travel():
    """Shift and turn are from the first pose, along world axes."""
    poses = [hf.Pose.from_rpy(0.3, 0, 0, [1, 2, 3]), hf.Pose.from_rpy(0.3, 0, 0.4, [1, 2.5, 3])]
    found = base_travel(np.array([pose.wxyz_xyz for pose in poses]))
    assert found.shift[1] == pytest.approx([0, 0.5, 0])
    assert found.turn[1] == pytest.approx([0, 0, 0.4])
    assert not found.turn[0].any()
