"""Runs of chains with branches in folders and tables: what is read back is what was written, bit by bit."""

from __future__ import annotations

import csv

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.io.model_data import model_of, model_text
from holdfast.model.fingerprint import fingerprint
from tests.longer import mostly_slow
from tests.simulation.test_mechanism_events import PAD, constant, events
from tests.systems.branched import branched_problems

NAMES = [*branched_problems()]


def simulated(name, **given):
    """Return a short run; that of the grippers has events."""
    p = branched_problems()[name]
    happening = events(p.chain.grasps[PAD]) if name == "grippers" else []
    return hf.simulate(p.chain, p.state, constant(p.tau), 0.02, 4e-3, events=happening, name=name, **given)


def same(found, wanted):
    """Check that two runs have the same bits, log and chain."""
    assert found.recorded == wanted.recorded and found.rows == wanted.rows
    for name in wanted.recorded:
        a, b = getattr(found, name), getattr(wanted, name)
        assert a.shape == b.shape and a.tobytes() == b.tobytes()
    assert found.occurrences == wanted.occurrences and found.stopped == wanted.stopped
    assert fingerprint(found.setting.chain) == fingerprint(wanted.setting.chain)


@pytest.mark.parametrize("name", NAMES)
def test_models(name):
    """A chain with branches is read back from JSON number for number."""
    chain = branched_problems()[name].chain
    again = model_of(model_text(chain), "model.json")
    assert model_text(again) == model_text(chain)
    assert fingerprint(again) == fingerprint(chain) and [*again.grasps] == [*chain.grasps]
    assert again.as_forest.forest.topology == chain.as_forest.forest.topology


@pytest.mark.parametrize("name", mostly_slow(NAMES, ("palletiser",)))
def test_folders(name, tmp_path):
    """A folder that a run writes on the way, and one that is saved, hold the run."""
    run = simulated(name, folder=tmp_path / "on the way")
    same(hf.load_result(tmp_path / "on the way").whole_run(), run)
    run.save(tmp_path / "saved")
    found = hf.load_result(tmp_path / "saved")
    assert found.complete
    same(found.whole_run(), run)
    assert found.summary() == run.summary()
    assert len(found.playback(1e3)) == len(run)


@pytest.mark.slow
def test_summary():
    """The summary has peaks by grasps and loops, and nothing that a run of a forest does not determine."""
    run = simulated("pot and lid")
    found = run.summary()
    peaks = np.linalg.norm(run.grasp_wrench[..., 3:], axis=2).max(axis=0)
    assert found.peak_force == pytest.approx(dict(zip(run.rows, peaks, strict=True)))
    assert found.momentum_imbalance is None and found.peak_internal_force == {} and found.spin == {}
    assert found.energy_imbalance == pytest.approx(np.abs(run.imbalance).max())
    assert "knob" in found._repr_html_()


@pytest.mark.slow
def test_tables(tmp_path):
    """A CSV file has a column for each entry of each grasp and loop, with enough digits for the same float64."""
    run = simulated("grippers")
    table, log = run.to_csv(tmp_path / "run.csv")
    with table.open() as file:
        head, *lines = csv.reader(file)
    assert len(set(head)) == len(head)
    column = head.index("grasp_wrench arm1/pad1 force_z [N]")
    assert [float(line[column]) for line in lines] == run.grasp_wrench[:, 1, 5].tolist()
    with log.open() as file:
        head, *lines = csv.reader(file)
    column = next(k for k, title in enumerate(head) if title.startswith("impulses arm1/pad1 linear_x"))
    assert len(lines) == len(run.occurrences) == 3
    assert float(lines[1][column]) == run.occurrences[1].impulses[1][3]
    frame = run.to_pandas()
    assert len(frame) == len(run)


def test_refusals():
    """What is not written of such runs is refused by name."""
    run = simulated("palletiser")
    with pytest.raises(MethodNotApplicable, match="such a chain answers"):
        run.to_mcap("run.mcap")
    with pytest.raises(MethodNotApplicable, match="state_at"):
        run.state_at(0.001)
    with pytest.raises(StateError, match="'internal_wrench' was not recorded"):
        _ = run.internal_wrench[0]
    with pytest.raises(MethodNotApplicable, match="runs: 'a': chain"):
        hf.plot.compare_runs({"a": run, "b": run})
