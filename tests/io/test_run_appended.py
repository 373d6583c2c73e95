"""`simulate(folder=)` appends its samples to a result folder: the run that `run.save` writes, there at any time."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.io import result_folder
from tests.compiler.programs import same_bits
from tests.simulation.rollout.problems import problem

CHAIN, STATE = problem("one")
UP = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def hang(t, now, memory):
    """Exert nothing."""
    return np.zeros(CHAIN.joint_count), memory


def heave(t):
    """Move the base up, faster and faster."""
    base = CHAIN.arms["arm1"].base
    return hf.Pose(base.R, base.p + 0.05 * t**2 * UP[3:]), 0.1 * t * UP, 0.1 * UP


@pytest.mark.parametrize("moving", [False, True])
def test_same_as_saved(tmp_path, monkeypatch, moving):
    """Samples, options, summary and motions of bases are those that `run.save` writes."""
    monkeypatch.setattr(result_folder, "LONGEST_WAIT", 0.0)
    options = {"base_motion": {"arm1": heave}} if moving else {}
    run = hf.simulate(CHAIN, STATE, hang, 0.005, 0.001, folder=tmp_path / "on", **options)
    run.save(tmp_path / "saved")
    on, saved = (hf.load_result(tmp_path / name) for name in ("on", "saved"))
    assert on.complete and on.note == "" and on.chunks == (1,) * 6
    assert same_bits(on.trajectory.q, run.q) and same_bits(on.trajectory.grasp_wrench, saved.trajectory.grasp_wrench)
    assert (on.meta.options, on.meta.model_sha256) == (saved.meta.options, saved.meta.model_sha256)
    for name in ("summary.json", "model.json", *(["bases.npz"] if moving else [])):
        assert (tmp_path / "on" / name).read_bytes() == (tmp_path / "saved" / name).read_bytes()


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_ended_half_way(tmp_path, error):
    """Samples so far can be read meanwhile and afterwards; an earlier run is replaced only when told to."""
    seen = []

    def end(t):
        seen.append(hf.load_result(tmp_path / "run").samples)
        if t > 0.0025:
            raise error

    with pytest.raises(error):
        hf.simulate(CHAIN, STATE, hang, 0.005, 0.001, folder=tmp_path / "run", progress=end)
    left = hf.load_result(tmp_path / "run")
    assert seen == [1, 1, 1] and left.samples == 4 and "incomplete, up to t = 0.003 s of 0.005 s" in left.note
    with pytest.raises(hf.ResultError, match="holds an earlier result; try overwrite=True"):
        hf.simulate(CHAIN, STATE, hang, 0.002, 0.001, folder=tmp_path / "run")
    assert len(hf.simulate(CHAIN, STATE, hang, 0.002, 0.001, folder=str(tmp_path / "run"), overwrite=True)) == 3
    assert hf.load_result(tmp_path / "run").samples == 3


def test_nothing_begun(tmp_path):
    """A run that is refused leaves no folder."""
    with pytest.raises(hf.StateError):
        hf.simulate(CHAIN, STATE, lambda t, now, memory: (np.zeros(3), None), 0.005, 0.001, folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()
