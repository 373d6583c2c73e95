"""Chains with branches are drawn where their forests have them: links along the tree, objects, loops and arrows."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.tree.mechanism_terms import flat_state
from holdfast.errors import StateError
from holdfast.model.grasp_rows import grasp_rows
from holdfast.robots.visuals import arm_length, visuals_of
from holdfast.view.cameras import cameras, objects_outline
from holdfast.view.chain_scene import ChainScene
from holdfast.view.live import readout
from holdfast.view.page import page, panel_data, plots
from holdfast.view.playback import playback_of_run
from holdfast.view.plots import figures
from tests.longer import mostly_slow
from tests.systems.branched import Branched, branched_problems, palletiser
from tests.view.runs import off_axis
from tests.view.test_chain_scene import Notebook

NAMES = [*branched_problems()]


def simulated(p: Branched, **given):
    """Return a short run."""
    return hf.simulate(p.chain, p.state, lambda t, state, memory: (p.tau, memory), 6e-3, 2e-3, **given)


def body_nodes(chain: hf.ClosedChain, notebook: Notebook) -> list[str]:
    """Return the node of every body of a chain's forest, in order, by the last part of its name."""
    nodes = [name for name, what in notebook.drawn.items() if what == "frame"]
    found = ["/trunk"] if chain.floats else []
    for part, joints in chain.joints_of.items():
        root = "/trunk" if part == "trunk" else f"/arms/{part}"
        names = [joint.name or f"joint{k + 1}" for k, joint in enumerate(joints)]
        found += [next(n for n in nodes if n.startswith(f"{root}/") and n.endswith(f"/{name}")) for name in names]
    return found + ["/object" if name == "object" else f"/objects/{name}" for name in chain.free_objects]


@pytest.mark.parametrize("name", mostly_slow(NAMES, ("palletiser", "on a shoulder")))
def test_where_everything_is(name):
    """Composed along their names, the nodes are the bodies of the forest; arrows are the wrenches at the contacts."""
    p = branched_problems()[name]
    run, notebook = simulated(p), Notebook()
    playback = playback_of_run(p.chain, run, name, 1e3)
    scene = ChainScene(notebook, playback)
    assert len(playback) == len(run) == 4
    for k in (0, 3):
        scene.show(k)
        poses = p.chain.forest.poses(flat_state(p.chain, run.state(k))[0])
        for node, pose in zip(body_nodes(p.chain, notebook), poses, strict=True):
            placed = notebook.world_pose(node)
            assert np.abs(placed.R - pose.R).max() < 1e-7  # single precision is what a viewer takes
            assert placed.p == pytest.approx(pose.p, abs=1e-12)
        for i, row in enumerate(grasp_rows(p.chain)):
            contact = poses[row.body] @ row.grasp.frame
            assert playback.tip[k, i] == pytest.approx(contact.p, abs=1e-12)
            drawn = notebook.pointed[f"/forces/{row.name.replace('/', chr(0x2215))}"][0]
            force = scene.scale.force * run.grasp_wrench[k, i, 3:]
            assert drawn == pytest.approx(np.array([contact.p, contact.p + force]), abs=1e-12)


@pytest.mark.parametrize("name", mostly_slow(NAMES, ("palletiser", "on a shoulder")))
def test_views(name):
    """Every view but the one near the objects has all bodies, contacts and objects in the picture."""
    p = branched_problems()[name]
    playback = playback_of_run(p.chain, simulated(p), name, 1e3)
    views = cameras(playback)
    assert ("object" in [view.name for view in views]) == bool(p.chain.free_objects)
    poses = p.chain.forest.poses(flat_state(p.chain, playback.state(0))[0])
    points = np.array([*(pose.p for pose in poses), *playback.tip[0], *objects_outline(playback, 0)])
    for view in views[:4]:
        assert off_axis(view, points).max() < np.sqrt(2.0) * np.tan(np.radians(35.0) / 2)


@pytest.mark.parametrize("name", mostly_slow(NAMES, ("palletiser",)))
def test_figures_and_pages(name):
    """Figures have a column for each grasp and loop; pages and notebooks show the run."""
    p = branched_problems()[name]
    run = simulated(p)
    drawn = figures(p.chain, run)
    assert {"grasp_wrenches", "joint_torques", "closure_and_energy"} <= set(drawn)
    titles = [panel.get_title() for panel in drawn["grasp_wrenches"].axes if panel.get_title()]
    assert titles == [f"{row.name} ({row.grasp.kind})" for row in grasp_rows(p.chain)]
    playback = run.playback(1e3)
    labels = [curve["label"] for curve in plots(playback)[0]["curves"]]
    assert labels == run.rows
    assert "internal" not in panel_data(playback, ChainScene(Notebook(), playback).scale)["notes"][0]
    assert all(row in readout(playback, 0) for row in run.rows)
    assert "<img" in run._repr_html_()
    assert page(playback).startswith("<!doctype html>")


def test_torques_of_drives_only():
    """Joints without a drive have no torque to show."""
    p = palletiser()
    legend = figures(p.chain, simulated(p))["joint_torques"].axes
    labels = [text.get_text() for panel in legend if panel.get_legend() for text in panel.get_legend().get_texts()]
    assert labels == ["turn", "shoulder"]


def test_solids_along_the_tree():
    """A link with fingers has a rod to each of them, and the fingers of a built-in robot are drawn beside its links."""
    finger = hf.Link(0.1, com=[0, 0, 0.02], inertia=1e-4 * np.eye(3))
    panda = hf.robots.panda()
    slides = [hf.Joint("prismatic", [0, side, 0], hf.Pose.translation(0, 0, 0.165)) for side in (1, -1)]
    joints, links = [*panda.joints, *slides], [*panda.links, finger, finger]
    pads = {"pad": (7, hf.Pose.translation(0, 0, 0.04))}
    arm = hf.Arm(joints, links, parents=[None, *range(6), 6, 6], frames=pads)
    solids, own = visuals_of(arm), visuals_of(panda)
    assert len(solids) == 10 and len(solids[8]) == len(solids[9]) == 2
    assert [len(one) for one in solids[:8]] == [len(one) for one in own]
    assert arm_length(arm) < arm_length(panda) + 0.3
    assert hf.robots.built_in.home_of(arm) is None


def test_another_chain():
    """A run of other grasps is refused by name."""
    p = branched_problems()["grippers"]
    run = simulated(p)
    other = palletiser().chain
    with pytest.raises(StateError, match="expected one of this chain with 4 joints, got 16"):
        playback_of_run(other, run)
