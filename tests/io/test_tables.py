"""A table holds every number of a run, under names and units that other programs can show."""

import csv
import sys
import tracemalloc

import numpy as np
import pytest

import holdfast as hf
from holdfast.io import tables
from holdfast.io.columns import columns, rows
from holdfast.io.result_folder import ResultWriter, run_meta
from holdfast.io.result_reader import load_result
from holdfast.io.tables import export_csv, export_parquet
from holdfast.simulation.trajectory import stacked
from tests.io.recorded import filled
from tests.simulation.rollout.problems import arrays
from tests.simulation.rollout.test_statuses import gantries, given
from tests.systems.trunk_runs import still_base


@pytest.fixture
def saved(tmp_path):
    """Return a result of two chunks, and its samples."""
    w, given = filled(tmp_path / "run", 4, 3)
    w.finish(None)
    return load_result(tmp_path / "run"), stacked(given)


def read_csv(path):
    """Return header and numbers."""
    with path.open(newline="", encoding="utf-8") as file:
        head, *lines = csv.reader(file)
    return head, np.array([[float(entry) for entry in line] for line in lines])


def test_csv_brings_back_every_bit(saved, tmp_path):
    """One header line, a row a sample, and the same float64 in every place."""
    result, run = saved
    export_csv(result, tmp_path / "run.csv")
    head, table = read_csv(tmp_path / "run.csv")
    assert table.shape == (7, len(head))
    assert table.tobytes() == rows(run).tobytes()
    at = {title: table[:, i] for i, title in enumerate(head)}
    assert len(at) == len(head)
    for title, values in {
        "t [s]": run.t,
        "q left/joint1 [rad]": run.q[:, 0],
        "tau right/joint7 [N m]": run.tau[:, 13],
        "object_pose qw": run.object_pose[:, 0],
        "object_pose z [m]": run.object_pose[:, 6],
        "object_twist omega_y [rad/s]": run.object_twist[:, 1],
        "object_acceleration v_dot_x [m/s^2]": run.object_acceleration[:, 3],
        "grasp_wrench right moment_x [N m]": run.grasp_wrench[:, 1, 0],
        "grasp_wrench left force_z [N]": run.grasp_wrench[:, 0, 5],
        "work damping [J]": run.work[:, 1],
        "position_gap after [m or rad]": run.position_gap[:, 1],
        "condition": run.condition,
    }.items():
        assert np.array_equal(at[title], values), title


def test_what_happened(saved, tmp_path):
    """A second table, a row an occurrence; entries that one does not have are empty."""
    result, run = saved
    assert export_csv(result, tmp_path / "run.csv") == [tmp_path / "run.csv", tmp_path / "run_occurrences.csv"]
    with (tmp_path / "run_occurrences.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["kind"] for line in lines] == ["attach", "violation", "recovery"]
    for line, one in zip(lines, run.occurrences, strict=True):
        assert (float(line["t [s]"]), line["name"], line["text"]) == (one.t, one.name, one.text)
        assert line["quantity"] == (one.quantity or "")
        assert line["lowest [SI]"] == ("" if one.lowest is None else repr(one.lowest))
    assert float(lines[0]["impulses right linear_z [N s]"]) == run.occurrences[0].impulses[1][5]
    assert lines[1]["impulses right linear_z [N s]"] == ""


def test_a_quiet_run_has_one_table(tmp_path):
    """The second table of an earlier export does not stay beside one of a run in which nothing happened."""
    filled(tmp_path / "run", 1)
    (tmp_path / "run_occurrences.csv").write_text("earlier")
    assert export_csv(load_result(tmp_path / "run"), tmp_path / "run.csv") == [tmp_path / "run.csv"]
    assert not (tmp_path / "run_occurrences.csv").exists()


def test_every_column_is_named(saved):
    """No array is left with numbers for names, and none with a whole sentence for a unit."""
    result, run = saved
    for column in columns(result.meta, run):
        assert not column.name.split()[-1].isdigit(), column
        assert "," not in column.unit, column
    result.meta.joint_kinds[0] = "prismatic"  # metres and newtons
    titles = {column.title for column in columns(result.meta, run)}
    assert {"q left/joint1 [m]", "qd left/joint1 [m/s]", "qdd left/joint1 [m/s^2]", "tau left/joint1 [N]"} <= titles


def test_parquet(saved, tmp_path):
    """The same columns, bit for bit, with units in the metadata and a row group for each chunk."""
    parquet = pytest.importorskip("pyarrow.parquet")
    result, run = saved
    export_csv(result, tmp_path / "run.csv")
    export_parquet(result, tmp_path / "run.parquet")
    file = parquet.ParquetFile(tmp_path / "run.parquet")
    table = file.read()
    head, _ = read_csv(tmp_path / "run.csv")
    assert table.column_names == head
    assert np.column_stack([column.to_numpy() for column in table.columns]).tobytes() == rows(run).tobytes()
    assert table.schema.field("q left/joint1 [rad]").metadata == {b"unit": b"rad"}
    assert table.schema.metadata[b"scene"] == b"test"
    assert file.num_row_groups == 2
    log = parquet.read_table(tmp_path / "run_occurrences.parquet").to_pylist()
    assert [line["kind"] for line in log] == [one.kind for one in run.occurrences]
    assert log[0]["base_impulses left angular_x [N m s]"] == 0.0
    assert log[1]["lowest [SI]"] is None


def test_without_pyarrow(saved, tmp_path, monkeypatch):
    """The extra that brings it is named, and nothing is written."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(hf.errors.MissingExtra, match=r"pip install 'holdfast\[parquet\]'"):
        export_parquet(saved[0], tmp_path / "run.parquet")
    assert not list(tmp_path.glob("*.parquet*"))


def test_a_broken_export_leaves_what_was_there(saved, tmp_path):
    """A result that is torn meanwhile: refused, the earlier table untouched, no half of a new one."""
    result, _ = saved
    path = tmp_path / "run.csv"
    path.write_text("earlier")
    (result.folder / "chunk_0001.npz").write_bytes(b"torn")
    with pytest.raises(hf.errors.ResultError, match=r"chunk_0001.npz is damaged"):
        export_csv(result, path)
    assert path.read_text() == "earlier"
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["run.csv"]
    with pytest.raises(hf.errors.ResultError, match="cannot be written"):
        export_csv(result, tmp_path / "nowhere" / "run.csv")


@pytest.mark.slow
def test_a_long_run_is_not_held_in_memory(tmp_path):
    """Four times the chunks take no more memory."""
    peaks = []
    for flushes in (2, 8):
        filled(tmp_path / str(flushes), *[100] * flushes)
        tracemalloc.start()
        export_csv(load_result(tmp_path / str(flushes)), tmp_path / "table")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0], peaks


def test_what_happened_below_a_trunk(tmp_path):
    """A run on a trunk has columns of its base: the arrays, and the impulse that it takes when an arm grips."""
    p = still_base(9, 2, floating=False, arms={"arms": 2, "grasps": "rigid", "joints": 7})
    name = next(iter(p.chain.mounts))
    chain, grips = p.chain.without_grasp(name), hf.Attach(0.002, name, p.chain.grasps[name], here=True)
    writer = ResultWriter(tmp_path / "run", run_meta(chain, "gripping", 0.004, 0.002), "")
    run = hf.simulate(
        chain, p.state, lambda t, s, m: (p.tau, m), 0.004, 0.002, events=[grips], on_sample=writer.add
    )  # fmt: skip
    writer.finish(None)
    export_csv(load_result(tmp_path / "run"), tmp_path / "run.csv")
    head, table = read_csv(tmp_path / "run.csv")
    wrenches = [head.index(f"trunk_base_wrench {part}") for part in ("moment_x [N m]", "force_z [N]")]
    assert np.array_equal(table[:, wrenches], run.trunk_base_wrench[:, [0, 5]])
    with (tmp_path / "run_occurrences.csv").open(newline="", encoding="utf-8") as file:
        (gripped,) = [line for line in csv.DictReader(file) if line["kind"] == "attach"]
    titles = [title for title in gripped if title.startswith("trunk_base_impulse")]
    assert titles == [f"trunk_base_impulse {half}_{axis} [{unit}]"
                      for half, unit in (("angular", "N m s"), ("linear", "N s")) for axis in "xyz"]  # fmt: skip
    assert tuple(float(gripped[title]) for title in titles) == run.occurrences[0].trunk_base_impulse
    assert any(run.occurrences[0].trunk_base_impulse)


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
        with pytest.raises(hf.errors.MissingExtra, match=r"pip install 'holdfast\[pandas\]'"):
            one.to_pandas()
        with pytest.raises(hf.errors.MissingExtra, match=r"pip install 'holdfast\[xarray\]'"):
            one.to_xarray()
