"""Figures render, every axis says its unit, and nothing but safe colours is used."""

import builtins
import io

import numpy as np
import pytest

from holdfast import ClosedChain, MissingExtra
from holdfast.dynamics.split import split
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Trajectory
from holdfast.view import figure_style, plots
from holdfast.view.summary_table import rows, summary_table
from tests.control.two_pandas import two_pandas

SAFE = {figure_style.BLUE, figure_style.VERMILLION, figure_style.GREEN, figure_style.ORANGE, figure_style.PURPLE,
        figure_style.SKY, figure_style.BLACK}  # fmt: skip


def made_up_run(chain, state, samples=50):
    """Return a run whose numbers mean nothing but have the right shapes."""
    rng, n, l = np.random.default_rng(1), chain.joint_count, len(chain.arms)
    wave = np.linspace(0, 1, samples)[:, None]
    wrench = np.zeros((samples, l, 6))
    for i, name in enumerate(chain.names):
        if name in chain.grasps:
            wrench[:, i] = wave * rng.normal(size=6)
    return Trajectory(
        t=wave[:, 0], q=np.tile(state.q, (samples, 1)), qd=0 * wave + np.zeros(n), qdd=0 * wave + np.zeros(n),
        tau=wave * np.ones(n), object_pose=np.tile(state.object_pose, (samples, 1)),
        object_twist=0 * wave + np.zeros(6),
        object_acceleration=0 * wave + np.zeros(6), grasp_wrench=wrench, base_wrench=0 * wrench,
        position_gap=np.abs(rng.normal(size=(samples, 2))) * [1e-12, 0], velocity_gap=1e-12 * wave + np.zeros(2),
        kinetic=wave[:, 0], potential=-wave[:, 0], work=wave * [0.5, -0.5, 0, 0], condition=1 + wave[:, 0],
    )  # fmt: skip


def chains():
    chain, state = two_pandas("hinge", "ball")
    arms = {f"arm{k}": chain.arms["left"] for k in range(6)}
    many = ClosedChain(arms, chain.held_object, {f"arm{k}": chain.grasps["left"] for k in (0, 1, 2, 3, 5)})
    return {"two": chain, "six": many, "none": chain.without_grasp("left").without_grasp("right")}, state


@pytest.mark.parametrize("which", ["two", "six", "none"])
def test_grasp_wrench_figure(which, recwarn):
    """One column of three panels per arm that holds, units on the outer axes, no warning."""
    every, state = chains()
    chain = every[which]
    run = made_up_run(chain, type(state)(np.zeros(chain.joint_count), np.zeros(chain.joint_count), state.object_pose))
    figure = plots.grasp_wrench_figure(chain, run)
    drawn = [panel for panel in figure.axes if panel.lines]
    assert len(drawn) == 3 * len(chain.grasps)
    assert {panel.get_ylabel() for panel in drawn} <= {"force [N]", "moment [N m]", "|force| [N]", ""}
    assert {line.get_color() for panel in drawn for line in panel.lines} <= SAFE
    assert len(png(figure)) > 1000
    assert not recwarn.list


def test_motion_and_internal_parts_are_the_splits():
    """The third row shows the norms of the split's forces."""
    chain, state = two_pandas("hinge", "ball")
    run = made_up_run(chain, state)
    _, _, last = plots.grasp_wrench_figure(chain, run).axes[::2]
    part = split(chain, state, run.grasp_wrench[-1])
    shown = [line.get_ydata()[-1] for line in last.lines]
    assert shown == pytest.approx([np.linalg.norm(part.motion[0, 3:]), np.linalg.norm(part.internal[0, 3:])])


@pytest.mark.parametrize("samples", [1, 2, 50, 2000])
def test_closure_and_energy_figure(samples, recwarn):
    """Gaps of zero and runs of one sample are drawn too; works that stay zero are left out."""
    chain, state = two_pandas("hinge", "ball")
    figure = plots.closure_and_energy_figure(made_up_run(chain, state, samples))
    labels = [panel.get_ylabel() for panel in figure.axes]
    assert labels == ["position gap\n[m or rad]", "velocity gap\n[m/s or rad/s]", "energy [J]", "imbalance [J]"]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert len(png(figure)) > 1000
    assert not recwarn.list
    if samples > 1:
        names = [text.get_text() for text in figure.axes[2].get_legend().get_texts()]
        assert names == ["kinetic", "potential, change", "work of drives", "work of damping"]


def test_largest_gap_is_never_hidden():
    """However many samples, the worst one is on the curve."""
    gaps = np.zeros(5000)
    gaps[3137] = 1e-6
    _, shown = plots._worst(np.linspace(0, 1, 5000), gaps)
    assert shown.max() == 1e-6
    assert len(shown) <= plots.POINTS


def test_files(tmp_path):
    """Both figures are written under their names."""
    chain, state = two_pandas("hinge", "ball")
    names = plots.save_plots(chain, made_up_run(chain, state), tmp_path)
    assert names == ["grasp_wrenches.png", "closure_and_energy.png"]
    assert all((tmp_path / name).stat().st_size > 1000 for name in names)


def test_missing_matplotlib(monkeypatch):
    """Without matplotlib the error names the extra."""
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *arguments, **options)

    chain, state = two_pandas("hinge", "ball")
    run = made_up_run(chain, state)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtra, match=r"pip install 'holdfast\[plot\]'"):
        plots.grasp_wrench_figure(chain, run)


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


def png(figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, dpi=100)
    return out.getvalue()
