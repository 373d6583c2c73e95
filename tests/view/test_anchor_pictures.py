"""Anchors are drawn where they stand, beside arms, on a trunk and alone; what the pictures are as large as."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.robots.visuals import arm_length, chain_length
from holdfast.view.chain_scene import ChainScene
from holdfast.view.playback import playback_of_run
from holdfast.view.plots import figures
from tests.laws.test_anchors import pendulum, still
from tests.simulation.runs import limp
from tests.systems.anchored import by_anchor
from tests.systems.as_chain import Problem
from tests.systems.trunk_runs import swaying
from tests.view.test_chain_scene import Notebook


def shown(p: Problem, motion=None):
    """Return a run of a problem, its playback, and what is drawn."""
    run = hf.simulate(p.chain, p.state, limp, 0.02, 0.01, inputs=p.inputs, base_motion=motion, scheme="dop853")
    playback, notebook = playback_of_run(p.chain, run, "run", 1e3, motion or {}), Notebook()
    return run, playback, notebook, ChainScene(notebook, playback)


@pytest.mark.slow
@pytest.mark.parametrize("alone", [True, False])
def test_where_it_stands(alone):
    """Its node and its tip are where the base is, and move with it; its foot and its name are there."""
    p, name = (pendulum("ball"), "pin") if alone else (still(1, "ball"), "pin1")
    base = p.chain.arms[name].base
    run, playback, notebook, scene = shown(p, {name: swaying(base)})
    for k in (0, len(run) - 1):
        scene.show(k)
        there, _, _ = swaying(base)(run.t[k])
        node = notebook.world_pose(f"/arms/{name}")
        assert node.p == pytest.approx(there.p, abs=1e-12)
        i = p.chain.names.index(name)
        assert (node @ p.chain.arms[name].tip).p == pytest.approx(playback.tip[k, i], abs=1e-9)
    drawn = [part.removeprefix(f"/arms/{name}/") for part in notebook.drawn if part.startswith(f"/arms/{name}/")]
    assert {"(own)", "(hand)", "(name)"} <= set(drawn)
    assert len(figures(p.chain, run)) >= 2


def test_sizes():
    """An anchor does not count among the arms' lengths; where there are none, the object's size does."""
    p = still(1, "ball")
    lengths = [arm_length(arm) for arm in p.chain.arms.values() if arm.joints]
    assert chain_length(p.chain) == max(lengths)
    box = hf.HeldObject.box(1.0, 0.1, 0.2, 0.3)
    assert chain_length(replace(pendulum().chain, held_object=box)) == pytest.approx(0.3, rel=1e-12)


@pytest.mark.slow
def test_on_a_trunk():
    """On a trunk it has no foot, and is inside the body that carries it."""
    _, p = by_anchor(0)
    _, playback, notebook, scene = shown(replace(p, state=p.state.at_rest()))
    scene.show(0)
    assert "/arms/arm2/(own)" not in notebook.drawn and "/arms/arm2/(hand)" in notebook.drawn
    contact = hf.Pose.from_wxyz_xyz(playback.object_pose[0]) @ p.chain.grasps["arm2"].frame
    assert np.abs(notebook.world_pose("/arms/arm2").p - contact.p).max() < 1e-6
