"""The figure of contacts beside other simulators: its closed form, and that it draws what it is given."""

import numpy as np
import pytest
from benchmarks import contact_figure
from benchmarks.contact_scenes import EDGES, Course, G, body, gap_of, rate_on_paper, scenes, touching

import holdfast as hf


@pytest.mark.parametrize("lean", [0.3, 0.1, -0.3, 1.2])
def test_an_edge_strikes(lean):
    """The turning rate on paper is that of Newton's impact with all contacts together, sticking or slipping."""
    scene = next(one for one in scenes() if one.name == "edge")
    R = hf.Pose.from_rpy(0, lean, 0).R
    lowest = gap_of(hf.Pose(R, np.zeros(3)).wxyz_xyz, scene.normal, EDGES)
    scene = scene._replace(pose=hf.Pose(R, [0, 0, 5e-3 - lowest]))
    there = hf.Pose(R, [0, 0, -lowest])
    falls = -np.sqrt(scene.twist[5] ** 2 + 2 * G * 5e-3)
    chain = hf.ClosedChain({}, body(), {}, touching=touching(scene.normal, EDGES))
    hit = hf.touch(chain, hf.State([], [], there, [0, 0, 0, 0, 0, falls]))
    assert hit.state.object_twist[1] == pytest.approx(rate_on_paper(scene), rel=1e-9)
    assert np.abs(hit.state.object_twist[[0, 2, 4]]).max() < 1e-9


def test_what_is_shown():
    """A row for each simulator, a dash where it has no such scene; depth, creep and the rate after an impact."""
    steps = {scene.name: round(scene.duration / 1e-3) for scene in scenes()}

    def course(who, scene, count):
        pose = np.tile([1.0, 0, 0, 0, 0, 0, 0], (count, 1))
        pose[:, 4] = 1e-6 * np.arange(count)
        force = np.where(np.arange(count) < 10, 0.0, 9.81)
        twist = np.tile(np.arange(count)[:, None] / 10.0, (1, 6))
        return Course(who, scene, pose, twist, np.full(count, -2e-3), force, 3e-6)

    found = [course("holdfast", name, count) for name, count in {**steps, "arms": 80}.items()]
    found += [course("Drake 1.0, defaults", name, count) for name, count in steps.items()]
    ours, drake = contact_figure.table(found).splitlines()[2:]
    assert ours == "| holdfast | 1.0e+00 | 2.0e+00 | 2.0e+00 | 1.300 | 2.0e+00 | 3 | 3 |"
    assert drake.startswith("| Drake 1.0, defaults |") and drake.count("| - ") == 2
    made = contact_figure.figure(found)
    assert [len(panel.lines) for panel in made.axes] == [2, 2, 3, 1]
