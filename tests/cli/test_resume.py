"""`holdfast simulate --resume`: goes on with an interrupted run, or says in one line why not."""

from pathlib import Path

import pytest

import holdfast.cli.simulate as command
from holdfast.cli import main
from holdfast.io.result_reader import load_result
from tests.io.recorded import same_bits

TEXT = (Path(__file__).parents[2] / "examples" / "two_pandas.toml").read_text()


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "short.toml"
    path.write_text(TEXT.replace("duration = 2.0", "duration = 0.008"))
    return path


def interrupted(scene, monkeypatch):
    """Press Ctrl-C in the middle of a run."""
    real = command.run_simulation

    def simulation(*arguments, on_sample, **options):
        def add(sample):
            on_sample(sample)
            if sample.t > 0.005:
                raise KeyboardInterrupt

        return real(*arguments, on_sample=add, **options)

    with monkeypatch.context() as patched:
        patched.setattr(command, "run_simulation", simulation)
        assert main(["simulate", str(scene), "--out", "left", "--no-plots"]) == 130


def test_resume(scene, capsys, monkeypatch):
    """The same samples, the same summary; a second time it says that the run is complete."""
    assert main(["simulate", str(scene), "--out", "whole", "--no-plots"]) == 0
    table = capsys.readouterr().out.replace("whole", "left")
    interrupted(scene, monkeypatch)
    assert "--resume" in capsys.readouterr().err
    assert main(["simulate", str(scene), "--out", "left", "--resume", "--no-plots"]) == 0
    assert capsys.readouterr().out == table
    same_bits(load_result("left").trajectory, load_result("whole").trajectory)
    assert Path("left/summary.json").read_bytes() == Path("whole/summary.json").read_bytes()
    assert main(["simulate", str(scene), "--out", "left", "--resume"]) == 2
    assert "left: nothing to resume: the run is complete, 5 samples up to t = 0.008 s" in capsys.readouterr().err


def test_resume_refused(scene, capsys, monkeypatch):
    """Another text of the scene is another run; what is there stays there."""
    interrupted(scene, monkeypatch)
    capsys.readouterr()
    scene.write_text(scene.read_text().replace("squeeze = 20.0", "squeeze = 21.0"))
    assert main(["simulate", str(scene), "--out", "left", "--resume"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "these differ: the scene's text; try what it was begun with, or --overwrite" in said.err
    assert load_result("left").samples == 4


def test_resume_of_nothing(scene, capsys):
    """Where nothing was flushed yet it begins."""
    assert main(["simulate", str(scene), "--out", "none", "--resume", "--no-plots"]) == 0
    assert "none: nothing to resume yet; the run begins" in capsys.readouterr().err
    assert load_result("none").complete


def test_resume_or_overwrite(scene, capsys):
    """Not both."""
    assert main(["simulate", str(scene), "--resume", "--overwrite"]) == 2
    assert "try one of them" in capsys.readouterr().err
