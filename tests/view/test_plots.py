"""Figures render, every axis says its unit, nothing but safe colours is used, and curves are the run's numbers."""

import io
from dataclasses import replace

import numpy as np
import pytest

from holdfast import ClosedChain
from holdfast.simulation.events import Occurrence
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Trajectory, array_names
from holdfast.view import figure_style, plots
from holdfast.view.figure_style import usual_range
from holdfast.view.plots import figures, slips
from holdfast.view.summary_table import rows, summary_table
from tests.control.two_pandas import two_pandas
from tests.longer import mostly_slow
from tests.view.runs import lifted

SAFE = {figure_style.BLUE, figure_style.VERMILLION, figure_style.GREEN, figure_style.ORANGE, figure_style.PURPLE,
        figure_style.SKY, figure_style.BLACK, figure_style.OTHERS}  # fmt: skip
SHADES = {figure_style.joint_style(colour, k, 7)[0] for colour in figure_style.ARM_COLOURS for k in range(7)}
PER_ARM = ("load_share", "spin", "margin", "best_margin", "worst_margin", "lowest_margin", "lowest_margin_time",
           "holding")  # fmt: skip
SHAPES = {"object_pose": 7, "object_twist": 6, "object_acceleration": 6, "momentum": 6, "momentum_rate": 6,
          "base_impulse": 6, "work": 4, "position_gap": 2, "velocity_gap": 2, "lowest_joint_margin": 3,
          "lowest_joint_margin_time": 3, "lowest_joint": 3}  # fmt: skip


def made_up_run(chain, state, samples=50) -> Trajectory:
    """Return a run whose numbers mean nothing but have the right shapes."""
    rng, n, l = np.random.default_rng(1), chain.joint_count, len(chain.arms)
    arrays = {}
    for name in array_names():
        shape = (l,) if name in PER_ARM else (n,) if name in ("q", "qd", "qdd", "tau") else (l, 6)
        shape = () if name in ("t", "kinetic", "potential", "impact", "condition") else shape
        arrays[name] = np.zeros((samples, *((SHAPES[name],) if name in SHAPES else shape)))
    wave = np.linspace(0, 1, samples)[:, None]
    holds = np.array([name in chain.grasps for name in chain.names])
    wrench = holds[:, None] * wave[..., None] * rng.normal(size=(l, 6))
    return Trajectory(**arrays | {
        "t": wave[:, 0], "q": np.tile(state.q, (samples, 1)), "tau": wave * np.ones(n),
        "object_pose": np.tile(state.object_pose, (samples, 1)), "grasp_wrench": wrench,
        "internal_wrench": 0.5 * wrench, "load_share": wave * holds / max(holds.sum(), 1),
        "holding": np.tile(holds, (samples, 1)), "margin": np.where(holds, 1.0 - 2.0 * wave, np.inf),
        "position_gap": np.abs(rng.normal(size=(samples, 2))) * [1e-12, 0],
        "velocity_gap": 1e-12 * wave + np.zeros(2), "kinetic": wave[:, 0], "potential": -wave[:, 0],
        "work": wave * [0.5, -0.5, 0, 0], "condition": 1 + wave[:, 0],
    })  # fmt: skip


def chains():
    """Return two arms, six of which one holds nothing, and two that hold nothing."""
    chain, state = two_pandas("hinge", "ball")
    arms = {f"arm{k}": chain.arms["left"] for k in range(6)}
    many = ClosedChain(arms, chain.held_object, {f"arm{k}": chain.grasps["left"] for k in (0, 1, 2, 3, 5)})
    return {"two": chain, "six": many, "none": chain.without_grasp("left").without_grasp("right")}, state


@pytest.mark.parametrize(
    ("which", "samples"), mostly_slow([("two", 1), ("six", 30), ("none", 30)], [("two", 1), ("none", 30)])
)
def test_figures(which, samples, recwarn):
    """What has something to show is drawn, with a unit on every outer axis and no warning."""
    every, state = chains()
    chain = every[which]
    q = np.zeros(chain.joint_count)
    found = figures(chain, made_up_run(chain, type(state)(q, q, state.object_pose), samples))
    held = ["grasp_wrenches", "friction_margins", "joint_torques", "load_share", "closure_and_energy"]
    assert list(found) == (held if chain.grasps else ["joint_torques", "closure_and_energy"])
    for name, figure in found.items():
        drawn = [panel for panel in figure.axes if panel.lines and panel.axison]
        labels = {label for panel in drawn for label in (panel.get_xlabel(), panel.get_ylabel()) if label}
        assert labels, name
        assert all(label.endswith("]") for label in labels), labels
        assert drawn[0].get_ylabel(), name
        assert any(panel.get_xlabel() == "time [s]" for panel in drawn), name
        assert {line.get_color() for panel in drawn for line in panel.lines} <= SAFE | SHADES, name
        assert figure.get_figwidth() <= 2 * figure_style.COLUMN
        figure.draw_without_rendering()
    assert not recwarn.list


def test_arms_look_different():
    """Twenty arms differ; the first five even without their lines; danger and internal forces are nobody's colours."""
    styles = [figure_style.arm_style(i) for i in range(20)]
    assert len(set(styles)) == 20
    assert len({colour for colour, _ in styles[:5]}) == 5
    assert not {colour for colour, _ in styles} & {figure_style.DANGER, figure_style.INTERNAL_COLOUR}


def test_wrenches_are_the_runs():
    """A column of three panels per arm: force, moment, and the norms of the force's two parts; without moments two."""
    chain, run = lifted()
    assert [panel.get_ylabel() for panel in figures(chain, run)["grasp_wrenches"].axes[::2]] == [
        "force [N]",
        "|force| [N]",
    ]
    run = replace(run, grasp_wrench=run.grasp_wrench + np.array([0.1, 0.2, -0.3, 0.0, 0.0, 0.0]))
    left_force, right_force, left_moment, _, left_parts, _ = figures(chain, run)["grasp_wrenches"].axes
    assert [line.get_ydata()[-1] for line in left_force.lines] == pytest.approx(run.grasp_wrench[-1, 0, 3:])
    assert [line.get_ydata()[-1] for line in right_force.lines] == pytest.approx(run.grasp_wrench[-1, 1, 3:])
    assert [line.get_ydata()[-1] for line in left_moment.lines] == pytest.approx(run.grasp_wrench[-1, 0, :3])
    motion = run.grasp_wrench - run.internal_wrench
    assert [line.get_ydata()[-1] for line in left_parts.lines] == pytest.approx(
        [np.linalg.norm(motion[-1, 0, 3:]), np.linalg.norm(run.internal_wrench[-1, 0, 3:])]
    )


def test_instants_of_slip():
    """A run without a log has them by straight lines between samples, one with a log exactly."""
    chain, run = lifted()
    # mu (40 - 30 t) = m g / 2, linear in t
    t = (40.0 - 0.5 * 3.0 * 9.81 / 0.8) / 30.0
    # both at once: their order is rounding
    assert sorted(slips(chain, run)) == [("left", pytest.approx(t)), ("right", pytest.approx(t))]
    logged = (Occurrence(0.7, "violation", "left", "slips", "grasp"), Occurrence(0.8, "violation", "a/b", "", "rate"))
    run = replace(run, occurrences=logged)
    assert slips(chain, run) == [("left", 0.7)]
    (panel,) = figures(chain, run)["friction_margins"].axes
    assert [text.get_text() for text in panel.texts] == ["left gives way at 0.7 s"]
    assert [line.get_xdata()[0] for line in panel.lines if len(line.get_xdata()) == 2][-1] == 0.7


def test_torques_and_their_limits():
    """The lower panels show |tau| over the limit; no curve of a limited joint is missing."""
    chain, run = lifted()
    torque, _, share, _ = figures(chain, run)["joint_torques"].axes
    assert len(torque.lines) == 7
    limits = np.array([joint.effort_limit for joint in chain.arms["left"].joints])
    shown = [line.get_ydata()[0] for line in share.lines[:7]]
    assert shown == pytest.approx(100 * np.abs(run.tau[0, :7]) / limits)
    assert share.lines[7].get_ydata() == [100.0, 100.0]
    assert share.get_ylim()[1] > 100.0


def test_colour_by_arm_dash_by_joint():
    """Of two arms whose joints have names of their own no two curves look alike, and an arm's shades are of its hue."""
    chain, run = lifted("rigid", "rigid")
    named = {
        name: replace(arm, joints=[replace(joint, name=f"{name}_{k}_joint") for k, joint in enumerate(arm.joints)])
        for name, arm in chain.arms.items()
    }
    panels = plots.joint_torque_figure(replace(chain, arms=named), run).axes
    looks = [{(line.get_color(), str(line._unscaled_dash_pattern)) for line in panel.lines} for panel in panels[:2]]
    assert [len(found) for found in looks] == [7, 7]
    hues = [{np.argmax(figure_style.rgb(colour)) for colour, _ in found} for found in looks]
    assert hues == [{2}, {0}], "blues, and oranges"
    legends = [[text.get_text() for text in panel.get_legend().get_texts()] for panel in panels[2:]]
    assert legends == [[f"{name}_{k}_joint" for k in range(7)] for name in ("left", "right")]


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 48.0])
def test_a_spike_does_not_flatten_a_plot(share):
    """Other curves keep most of the axis, and the peak's number stands beside an arrow; without one all is shown."""
    chain, run = lifted("rigid", "rigid", 101)
    tau = run.tau.copy()
    tau[50, 5] += share * chain.arms["left"].joints[5].effort_limit
    figure = plots.joint_torque_figure(chain, replace(run, tau=tau))
    torque, _, used, _ = figure.axes
    assert used.get_ylim() == pytest.approx((0.0, 105.0))
    low, high = torque.get_ylim()
    assert np.abs(run.tau).max() < high < 2.0 * np.abs(run.tau).max() and low < run.tau.min()
    said = [text.get_text() for text in (*torque.texts, *used.texts) if text.get_text()]
    if share:
        assert [float(text.replace(",", "")) for text in said] == pytest.approx([tau[50, 5], 100 * share], rel=0.01)
        assert "beyond the axis" in figure.legends[0].get_texts()[0].get_text()
    else:
        assert not said and not figure.legends


def test_what_is_usual_is_never_cut():
    """A step, a ramp and a sine stay whole; of a curve that is zero but for a peak the peak is what there is to see."""
    t = np.linspace(0.0, 1.0, 200)
    for curve in (np.where(t > 0.9, 50.0, 1.0), t, np.sin(9 * t), np.where(t == t[70], 9.0, 0.0), np.full(200, np.nan)):
        assert usual_range([curve]) is None
    low, high = usual_range([np.sin(9 * t), np.where(t == t[70], -900.0, 0.1)])
    assert -2.0 < low < -1.0 and high == pytest.approx(1.0, abs=1e-3)


def test_shares_add_up():
    """What the arms carry sums to 100 %, and beside it stands the net force."""
    chain, run = lifted()
    share, force = figures(chain, run)["load_share"].axes
    assert sum(line.get_ydata() for line in share.lines) == pytest.approx(100.0)
    assert force.lines[0].get_ydata() == pytest.approx(3.0 * 9.81)


def test_energies():
    """Works that stay zero are left out."""
    every, state = chains()
    figure = plots.closure_and_energy_figure(made_up_run(every["two"], state))
    names = [text.get_text() for text in figure.axes[2].get_legend().get_texts()]
    assert names == ["kinetic", "potential, change", "work of drives", "work of damping"]


def test_largest_gap_is_never_hidden():
    """However many samples, the worst one is on the curve."""
    gaps = np.zeros(5000)
    gaps[3137] = 1e-6
    _, shown = plots.worst_gaps(np.linspace(0, 1, 5000), gaps)
    assert shown.max() == 1e-6
    assert len(shown) <= plots.POINTS


def test_summary_table():
    """Every line of the summary has a unit or a share, and the table renders."""
    from rich.console import Console

    chain, state = two_pandas("hinge", "ball")
    summary = summarise(chain, made_up_run(chain, state))
    lines = dict(rows(summary))
    assert lines["simulated"] == "1 s, 50 samples"
    assert "J moved" in lines["energy balance"]
    assert "peak grasp wrench, left" in lines
    assert lines["worst condition of the grasps"] == "2"
    assert lines["largest torque"].startswith("8 % of the limit of left/joint5")
    out = io.StringIO()
    Console(file=out, width=100).print(summary_table(summary))
    assert "closure error" in out.getvalue()


def test_plots_are_not_cut_off():
    """The last row of the wrenches, and the torques, reach to the largest of all arms, whichever comes first."""
    chain, run = lifted("rigid", "rigid")
    run = replace(run, internal_wrench=run.internal_wrench * np.array([1.0, 4.0])[:, None], tau=9.0 * run.tau)
    run = replace(run, tau=np.where(np.arange(14) < 7, run.tau, 0.1 * run.tau))
    for figure in (plots.grasp_wrench_figure(chain, run), plots.joint_torque_figure(chain, run)):
        for panel in figure.axes:
            low, high = panel.get_ylim()
            for line in panel.lines:
                assert low - 1e-9 <= np.min(line.get_ydata()) and np.max(line.get_ydata()) <= high
