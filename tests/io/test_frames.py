"""Runs and records as tables of pandas and data sets of xarray: every number under its name."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.io import tables
from tests.io.test_export import read_csv
from tests.simulation.rollout.problems import arrays
from tests.simulation.rollout.test_statuses import gantries, given


@pytest.fixture(scope="module")
def record():
    """Return a record of two blocks between gantries, one of which slips."""
    rollout, state = gantries()
    rate = np.array([20.0, 600.0])
    systems = rollout.start(**{name: np.tile(x, (2, 1)) for name, x in arrays(state).items()}, **given(rate))
    recorded = ("q", "tau", "grasp_wrench", "work", "t", "running")
    return rollout.run(systems, 0.1, 1e-3, every=20, record=recorded, least_margin=0.0)


def test_tables(record, tmp_path):
    """A run's table is that of its CSV file; a record's has a row for each system and time."""
    pytest.importorskip("pandas", reason="needs pandas: pip install 'holdfast[pandas]'")
    run = record.trajectory(0)
    table = run.to_pandas()
    run.to_csv(tmp_path / "run.csv")
    head, numbers = read_csv(tmp_path / "run.csv")
    assert list(table.columns) == head
    assert table.to_numpy().tobytes() == numbers.tobytes()
    assert hf.load_result(run.save(tmp_path / "run")).to_pandas().equals(table)
    every = record.to_pandas()
    assert len(every) == 2 * len(record.t)
    arm = record.systems.chain.names[1]
    forces = every.loc[1][f"grasp_wrench {arm} force_x [N]"]
    assert np.array_equal(forces, record["grasp_wrench"][:, 1, 1, 3])
    assert np.array_equal(forces.index, record.t)
    assert np.array_equal(every.loc[0]["work drives [J]"], record["work"][:, 0, 0])


def test_data_sets(record):
    """Axes by name, joints and arms by theirs, what became of each system beside it."""
    pytest.importorskip("xarray", reason="needs xarray: pip install 'holdfast[xarray]'")
    every = record.to_xarray()
    assert every.sizes["system"] == 2 and every.sizes["t"] == len(record.t)
    joint = record.systems.chain.joint_names()[2]
    assert np.array_equal(every.q.sel(system=1, joint=joint), record["q"][:, 1, 2])
    assert every.status.to_numpy().tolist() == ["RUNNING", "SLIPPED"]
    assert np.array_equal(every.stopped, record.stopped)
    run = record.trajectory(0)
    found = run.to_xarray()
    arm = run.setting.chain.names[0]
    assert np.array_equal(found.grasp_wrench.sel(arm=arm), run.grasp_wrench[:, 0])
    assert np.array_equal(found.object_pose, run.object_pose) and found.q.attrs["unit"] == "rad or m"
    assert np.array_equal(found.t, run.t)


def test_without_them(record, monkeypatch):
    """The command that installs what is missing."""

    def nothing(name, *_):
        raise ImportError(name)

    monkeypatch.setattr(tables, "import_module", nothing)
    for one in (record, record.trajectory(0)):
        with pytest.raises(hf.MissingExtra, match=r"pip install 'holdfast\[pandas\]'"):
            one.to_pandas()
        with pytest.raises(hf.MissingExtra, match=r"pip install 'holdfast\[xarray\]'"):
            one.to_xarray()
