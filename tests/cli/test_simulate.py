"""`holdfast simulate` from the command line: what it prints, writes and returns."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import holdfast.cli.simulate as command
from holdfast.cli import main
from holdfast.errors import ResultError, SingularChainError
from holdfast.io.result_reader import load_result
from tests.cli.conftest import EXAMPLE
from tests.io.recorded import same_bits

TEXT = EXAMPLE.read_text()


@pytest.mark.slow
def test_complete_run(scene, tmp_path, cli):
    """A run ends with its summary and where to look; everything named is there."""
    said = cli("simulate", scene)
    folder = Path("results") / "short"
    assert "energy balance" in said.out
    for name in ("summary.json", "grasp_wrenches.png", "closure_and_energy.png"):
        assert f"look at {folder / name}" in said.out
        assert (folder / name).stat().st_size > 100
    found = load_result(folder)
    assert found.complete
    assert found.scene_text == scene.read_text()
    assert len(found.trajectory) == 11
    assert json.loads((folder / "summary.json").read_text())["worst_position_gap"] <= 1e-12
    # and not twice into the same folder unless told to
    assert "--overwrite" in cli("simulate", scene, code=2).err
    assert main(["simulate", str(scene), "--overwrite", "--no-plots"]) == 0


@pytest.mark.parametrize(
    ("old", "new", "code", "message"),
    [
        ("mass = 3.0", "mass = -3.0", 2, "$.object.mass: expected > 0"),
        ("mass = 3.0", "mass = 1e-300", 2, "short.toml: "),
        ("[0.0, 0.0, 0.72]", "[0.0, 0.0, 2.0]", 3, "cannot close the chains"),
    ],
)
def test_refused(scene, cli, old, new, code, message):
    """Bad input is 2, an unreachable object 3: one line on stderr, nothing written."""
    scene.write_text(scene.read_text().replace(old, new))
    said = cli("simulate", scene, code=code)
    *begun, error = said.err.splitlines()
    assert message in error
    assert all(line.startswith("simulating") for line in begun)
    assert said.out == ""
    assert not Path("results").exists()


@pytest.mark.slow
def test_sampled(scene, cli):
    """Sample time and delay by an option or in the scene: the same run, both kept with it; bad ones are refused."""
    scene.write_text(TEXT.replace("duration = 2.0", "duration = 0.012").replace("begin = 0.2", "begin = 0.0"))
    options = ["--sample-time", "4e-3", "--delay", "1e-3", "--no-plots"]
    assert main(["simulate", str(scene), "--out", "by_option", *options]) == 0
    scene.write_text(scene.read_text().replace("step = 0.002", "step = 0.002\nsample_time = 4e-3\ndelay = 1e-3"))
    assert main(["simulate", str(scene), "--out", "by_scene", "--no-plots"]) == 0
    runs = [load_result(folder) for folder in ("by_option", "by_scene")]
    same_bits(*(one.trajectory for one in runs))
    assert [one.meta.options for one in runs] == [{"sample_time": 4e-3, "delay": 1e-3}] * 2
    assert len(np.unique(runs[0].trajectory.tau, axis=0)) >= 3
    for bad, message in ((["--sample-time", "0"], "expected > 0"), (["--delay", "2"], "less than the duration")):
        assert message in cli("simulate", scene, "--out", "bad", *bad, code=2).err
    assert not Path("bad").exists()
    scene.write_text(scene.read_text().replace("sample_time = 4e-3", "sample_time = -4e-3"))
    assert "$.simulation.sample_time: expected > 0, got -0.004" in cli("simulate", scene, "--out", "bad", code=2).err


@pytest.mark.slow
def test_step_too_long(scene, cli):
    """Feedback that the step cannot follow: 3, and one line with the joint and a step that can."""
    text = TEXT.replace("internal_force = 20.0", "internal_force = 20.0\njoint_damping = 5000.0")
    scene.write_text(text.replace("begin = 0.2", "begin = 0.0").replace("duration = 2.0", "duration = 1.6"))
    said = cli("simulate", scene, "--no-plots", code=3).err
    (line,) = [line for line in said.splitlines() if not line.startswith("simulating")]
    assert re.search(r"short.toml: stopped .* the step of 0.002 s is too long for joint '\w+/joint\d'", line), line
    step = re.search(r"try a step of (\S+) s$", line)
    assert step and float(step[1]) * 5000.0 < 2.0
    assert not load_result(Path("results") / "short").meta.complete


def simulate_until(t_end, then):
    """Return a simulation that raises or returns `then` after t_end."""
    real = command.run_simulation

    def simulation(chain, state, controller, duration, step, **callbacks):
        def interrupted(t, state, memory):
            if t > t_end:
                raise then
            return controller(t, state, memory)

        return real(chain, state, interrupted, duration, step, **callbacks)

    return simulation


@pytest.mark.slow
def test_interrupted(scene, cli, monkeypatch):
    """Ctrl-C: 130, and what was simulated until then is kept."""
    monkeypatch.setattr(command, "run_simulation", simulate_until(0.011, KeyboardInterrupt()))
    said = cli("simulate", scene, "--out", "there", "--no-plots", code=130).err
    assert "interrupted after t = 0.01 s; the results until then are in there" in said
    found = load_result("there")
    assert found.trajectory.t[-1] == pytest.approx(0.01)
    assert found.note == "incomplete, up to t = 0.01 s of 0.02 s: interrupted"


def test_interrupted_at_once(scene, cli, monkeypatch):
    """Ctrl-C before the first sample leaves nothing."""
    monkeypatch.setattr(command, "run_simulation", simulate_until(-1.0, KeyboardInterrupt()))
    assert "nothing was written" in cli("simulate", scene, code=130).err
    assert not Path("results").exists()


@pytest.mark.slow
def test_stopped_by_physics(scene, cli, monkeypatch):
    """A run that turns singular: 3, the last good time, and a result that can be read and seen."""
    monkeypatch.setattr(command, "run_simulation", simulate_until(0.011, SingularChainError("the rank drops")))
    said = cli("simulate", scene, code=3)
    assert "stopped after t = 0.01 s: the rank drops" in said.err
    assert "look at" in said.out
    found = load_result("results/short")
    assert not found.complete
    assert found.trajectory.stopped == "stopped after t = 0.01 s: the rank drops"


@pytest.mark.slow
def test_without_matplotlib(scene, cli, monkeypatch):
    """Said before anything is simulated, with the command that brings it and the one that does without."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    said = cli("simulate", scene, code=2)
    assert said.err == (
        "holdfast: error: plots need matplotlib; try pip install 'holdfast[plot]', or --no-plots now and `holdfast plot"
        " RESULT` later\n"
    )
    assert said.out == ""
    assert not Path("results").exists()
    assert "look at results/short/summary.json" in cli("simulate", scene, "--no-plots").out
    assert load_result("results/short").complete
    assert main(["plot", "results/short"]) == 2
    monkeypatch.undo()
    monkeypatch.chdir(scene.parent)
    assert main(["plot", "results/short"]) == 0


@pytest.mark.slow
def test_plots_that_fail_leave_the_result(scene, cli, monkeypatch):
    """Whatever happens to a plot, the run is on disk and its summary is told first."""

    def broken(*arguments):
        raise ResultError("results/short/torques.png: cannot be written: No space left on device")

    monkeypatch.setattr(command, "save_plots", broken)
    said = cli("simulate", scene, code=2)
    assert "look at results/short/summary.json" in said.out
    assert "No space left on device" in said.err
    assert load_result("results/short").complete


BALLS = TEXT.replace('kind = "rigid"', 'kind = "ball"\ncontact = { mu = 0.5 }')
WEAK = BALLS.replace("internal_force = 20.0", "internal_force = 5.0").replace("duration = 2.0", "duration = 0.01")


@pytest.mark.slow
def test_slip_stops_the_run(scene, cli):
    """An internal force that cannot carry the box: 3, the grasp and the time on stderr, the result kept."""
    scene.write_text(WEAK)
    said = cli("simulate", scene, "--no-plots", code=3)
    assert "slips at t = 0 s" in said.err
    assert "lowest margin, left" in said.out
    assert len(load_result("results/short").trajectory) == 1
    summary = json.loads(Path("results/short/summary.json").read_text())
    assert summary["occurrences"][0]["kind"] == "violation"
    assert summary["lowest_margin"]["left"][0] < 0
    # where the scene asks for it, the run goes on to its end and the table says what happened and when
    scene.write_text(WEAK.replace("step = 0.002", 'step = 0.002\non_slip = "record"'))
    said = cli("simulate", scene, "--no-plots", "--overwrite")
    assert "grasp 'left' slips" in said.out
    assert "t = 0 s" in said.out


@pytest.mark.slow
def test_events_of_a_scene(scene, cli):
    """An arm lets go and the table says so; without it the other carries on."""
    release = '\n[[events]]\ntype = "release"\nt = 0.005\narm = "right"\n'
    scene.write_text(TEXT.replace("duration = 2.0", "duration = 0.01") + release)
    assert "'right' lets go" in cli("simulate", scene, "--no-plots").out
    run = load_result("results/short").trajectory
    assert run.holding[-1].tolist() == [True, False]
    assert [one.kind for one in run.occurrences] == ["release"]
    assert (run.t[1:] > run.t[:-1]).all()


def interrupted_in_the_middle(scene, monkeypatch, cli):
    """Press Ctrl-C in the middle of a run, and return what stderr says."""
    real = command.run_simulation

    def simulation(*arguments, on_samples, **options):
        def keep(samples, checkpoint):
            on_samples(samples, checkpoint)
            if samples.t[-1] > 0.011:
                raise KeyboardInterrupt

        return real(*arguments, on_samples=keep, **options)

    with monkeypatch.context() as patched:
        patched.setattr(command, "run_simulation", simulation)
        return cli("simulate", scene, "--out", "left", "--no-plots", code=130).err


@pytest.mark.slow
def test_resume(scene, cli, monkeypatch):
    """The same samples, the same summary; a second time it says that the run is complete."""
    table = cli("simulate", scene, "--out", "whole", "--no-plots").out.replace("whole", "left")
    assert "--resume" in interrupted_in_the_middle(scene, monkeypatch, cli)
    assert cli("simulate", scene, "--out", "left", "--resume", "--no-plots").out == table
    same_bits(load_result("left").trajectory, load_result("whole").trajectory)
    assert Path("left/summary.json").read_bytes() == Path("whole/summary.json").read_bytes()
    said = cli("simulate", scene, "--out", "left", "--resume", code=2).err
    assert "left: nothing to resume: the run is complete, 11 samples up to t = 0.02 s" in said


@pytest.mark.slow
def test_resume_refused(scene, cli, monkeypatch):
    """Another text of the scene is another run; what is there stays there."""
    interrupted_in_the_middle(scene, monkeypatch, cli)
    scene.write_text(scene.read_text().replace("internal_force = 20.0", "internal_force = 21.0"))
    said = cli("simulate", scene, "--out", "left", "--resume", code=2)
    assert said.out == ""
    assert "these differ: the scene's text; try the original ones, or --overwrite" in said.err
    assert load_result("left").samples == 9


@pytest.mark.slow
def test_resume_of_nothing(scene, cli):
    """Where nothing was flushed yet it begins."""
    said = cli("simulate", scene, "--out", "none", "--resume", "--no-plots").err
    assert "none: nothing to resume yet; the run starts from the beginning" in said
    assert load_result("none").complete


@pytest.mark.slow
def test_record_of_a_scene(scene, cli):
    """A scene may say what is recorded; then there is no summary, the figures that the arrays allow, and no page."""
    scene.write_text(scene.read_text().replace("[simulation]", '[simulation]\nrecord = ["q", "tau"]\nevery = 5'))
    assert "with t, q, tau, which is too little for a summary" in cli("simulate", scene, "--out", "few").out
    assert sorted(path.name for path in Path("few").iterdir() if path.suffix != ".npz") == [
        "joint_torques.png",
        "meta.json",
        "scene.toml",
    ]
    found = load_result("few")
    assert found.complete and found.samples == 3 and found.trajectory.every == 5
    assert "'grasp_wrench' was not recorded" in cli("summary", "few", code=2).err
    scene.write_text(scene.read_text().replace('"tau"', '"torque"'))
    assert "$.simulation.record: no array 'torque'" in cli("simulate", scene, "--out", "none", code=2).err
