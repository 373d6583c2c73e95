"""A page of a run within limits: bars of what is used of them, and commanded beside actual internal forces."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, RestToRest, cooperative_law
from holdfast.forces import ForceLimits
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.view.chain_scene import ChainScene
from holdfast.view.markers import arrow_scale
from holdfast.view.page import bars, panel_data, plots
from holdfast.view.playback import playback_of_instant
from tests.control.two_pandas import rubber_pandas
from tests.view.test_chain_scene import Notebook

BOX_LIFT = Path(__file__).parents[2] / "examples" / "box_lift.toml"


@pytest.fixture(scope="module")
def within():
    """The playback of a run at 80 % of the effort and a margin of 20 N, with a weaker wish."""
    chain, state = rubber_pandas(0.8)
    path = RestToRest(state.object_frame, displacement=[0, 0, 0.02], duration=0.2)
    motion = ObjectImpedance(path, np.repeat([20.0, 400.0], 3), np.repeat([8.0, 100.0], 3))
    limits = ForceLimits(effort=0.8, least_margin={"left": 20.0})
    law = cooperative_law(chain, motion, InternalForce(5.0), limits=limits)
    return hf.simulate(chain, state, law, 0.2, 0.01).playback(50.0, controller=law)


@pytest.mark.slow
def test_bars(within):
    """Torques are shares of the effort limits; the grip is full at the margin that is kept, or at the onset of slip."""
    left, right = bars(within)
    assert [bar["label"] for bar in left["bars"]] == [*"1234567", "grip"]
    assert left["allowed"] == right["allowed"] == 80.0
    limits = np.array([joint.effort_limit for joint in within.chain.joints_of["right"]])
    shares = 100 * np.abs(within.tau[:, within.chain.joints["right"]] / limits)
    assert np.transpose([bar["values"] for bar in right["bars"][:7]]) == pytest.approx(shares, rel=1e-2, abs=1e-9)
    for group, i, demanded in ((left, 0, 20.0), (right, 1, 0.0)):
        hold = 0.8 * np.abs(within.wrench[:, i, 3])  # the contacts' normals are along x
        used = 100 * (hold - within.margin[:, i]) / (hold - demanded)
        assert group["bars"][7]["values"] == pytest.approx(used, rel=1e-2)
    assert left["bars"][7]["values"] == pytest.approx([100.0] * len(within), abs=0.2)  # the force is the least
    free = replace(within, limits=None)
    assert [group["allowed"] for group in bars(free)] == [100.0, 100.0]
    assert (np.array(bars(free)[0]["bars"][7]["values"]) < np.array(left["bars"][7]["values"])).all()
    bare = replace(within.chain, grasps={name: hf.Grasp("rigid", g.frame) for name, g in within.chain.grasps.items()})
    assert [len(group["bars"]) for group in bars(replace(within, chain=bare))] == [7, 7]


@pytest.mark.slow
def test_commanded_beside_actual(within):
    """The wish of 5 N has its own arrows and curves; without a known controller there are none."""
    found = {plot["title"]: plot["curves"] for plot in plots(within)}
    names = ["left", "right", "left, commanded", "right, commanded"]
    assert [curve["label"] for curve in found["internal force [N]"]] == names
    assert found["internal force [N]"][2]["values"] == pytest.approx([5.0] * len(within))
    assert min(found["internal force [N]"][0]["values"]) > 15.0
    assert [curve["label"] for curve in found["force on the object [N]"]] == names[:2]
    assert "commands" in panel_data(within, arrow_scale(within))["notes"][0]
    notebook = Notebook()
    scene = ChainScene(notebook, within)
    scene.show(3)
    for i, name in enumerate(within.chain.names):
        (actual,), (commanded,) = (notebook.pointed[f"/{what}_force/{name}"] for what in ("internal", "commanded"))
        assert commanded[1] - commanded[0] == pytest.approx(scene.scale.force * within.commanded[3, i, 3:])
        assert np.linalg.norm(commanded[0] - within.tip[3, i]) > 1.5 * np.linalg.norm(actual[0] - within.tip[3, i])
    notebook = Notebook()
    ChainScene(notebook, replace(within, commanded=None))
    assert "/commanded_force/left" not in notebook.pointed
    unknown = {plot["title"] for plot in plots(replace(within, commanded=None))}
    assert "internal force [N]" not in unknown


@pytest.mark.slow
def test_before_a_run_and_after_a_release():
    """A scene's first moment shows the command, too; a hand that has let go commands nothing, nor do those left."""
    chain, state = rubber_pandas(0.8)
    law = cooperative_law(chain, ObjectImpedance(RestToRest(state.object_frame), 100.0, 20.0), InternalForce(30.0))
    one = playback_of_instant(evaluate(Environment(chain), law, 0.0, state, None), "still", law)
    assert np.linalg.norm(one.commanded[0, :, 3:], axis=1) == pytest.approx([30.0, 30.0])
    run = hf.simulate(chain, state, law, 0.02, 0.01, events=[hf.Release(0.01, "right")], on_slip="record")
    frames = run.playback(1e3, controller=law)
    assert np.linalg.norm(frames.commanded[0, 0]) == pytest.approx(30.0)
    assert np.abs(frames.commanded[-1]).max() < 1e-12
    assert run.playback(1e3).commanded is None
    assert run.playback(1e3, controller=lambda t, now, memory: law(t, now, memory)).commanded is None


@pytest.mark.slow
def test_of_a_scene(tmp_path, cli):
    """The folder of a scene's run knows its law."""
    cli("simulate", BOX_LIFT, "--out", tmp_path / "run", "--set", "simulation.duration=0.01", "--no-plots")
    shown = hf.load_result(tmp_path / "run").playback(1e3)
    assert (shown.limits.effort, shown.limits.least_margin) == (0.8, 2.0)
    assert shown.commanded.shape == shown.internal.shape and not shown.commanded.any()
