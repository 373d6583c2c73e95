"""What runs of an object that touches the world record of its contacts, in memory, in folders, and in tables."""

import csv

import numpy as np
import pytest

import holdfast as hf
from holdfast.io.tables import export_csv, export_parquet
from holdfast.simulation.trajectory import TOUCH_FIELDS
from holdfast.world import HalfSpace, Touching, corners

EDGES, MU, MASS = (0.2, 0.2, 0.1), 0.5, 2.0
FEET = {"a": [0.05, 0, -0.05], "b": [-0.05, 0.05, -0.05], "c": [-0.05, -0.05, -0.05]}


def nothing(t, state, memory):
    """No arms, no torques."""
    return np.zeros(0), memory


def slid(points, contacts, **options):
    """Return the run of a box on a table that slides and stops, with a contact at rest in the air."""
    touching = Touching(points, {"table": HalfSpace(friction=MU), "ceiling": HalfSpace(normal=[0, 0, -1], offset=-1.0)})
    chain = hf.ClosedChain({}, hf.HeldObject.box(MASS, *EDGES), {}, touching=touching)
    start = hf.State([], [], hf.Pose.translation(0, 0, 0.05), [0, 0, 0, 0.1, 0, 0])
    return hf.simulate(chain, start, nothing, 0.06, 0.01, contacts=contacts, **options)


@pytest.mark.parametrize("contacts", ["events", "steps"])
@pytest.mark.parametrize(("points", "shared"), [(FEET, False), (corners(*EDGES), True)])
def test_margins_and_uniqueness(contacts, points, shared):
    """Three feet that slip have unique forces, four corners and feet that stick do not; margins are Coulomb's."""
    run = slid(points, contacts)
    names, n = run.setting.chain.touching.names, run.touch_force[..., 2]
    below = np.array([name.endswith("table") for name in names]) & (run.touch_gap[-1] < 1e-9)
    assert not run.touch_mode[:, ~below].any() and np.isinf(run.touch_margin[:, ~below]).all()
    slipping, resting = run.t < 0.015, run.t > 0.045
    assert (run.touch_mode[slipping][:, below] == 2).all() and (run.touch_mode[resting][:, below] == 1).all()
    np.testing.assert_array_equal(run.touch_margin[slipping][:, below], n[slipping][:, below])
    np.testing.assert_allclose(run.touch_margin[resting][:, below], MU * n[resting][:, below], atol=1e-9)
    np.testing.assert_array_equal(run.touch_status[slipping], int(shared))
    np.testing.assert_array_equal(run.touch_status[resting], 1)


def test_folders_and_tables(tmp_path):
    """Every array comes back from a folder to the bit, and every number has a column with names and units."""
    run = slid(FEET, "steps", folder=tmp_path / "run")
    result = hf.load_result(tmp_path / "run")
    for name in TOUCH_FIELDS:
        assert getattr(result.trajectory, name).tobytes() == getattr(run, name).tobytes(), name
    export_csv(result, tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="", encoding="utf-8") as file:
        head, *lines = csv.reader(file)
    table = dict(zip(head, np.array([[float(x) for x in line] for line in lines]).T, strict=True))
    expected = {
        "touch_force a/table z [N]": run.touch_force[:, 0, 2],
        "touch_gap a/ceiling [m]": run.touch_gap[:, 1],
        "touch_mode b/table": run.touch_mode[:, 2],
        "touch_margin c/table [N]": run.touch_margin[:, 4],
        "touch_status": run.touch_status,
    }
    for title, values in expected.items():
        np.testing.assert_array_equal(table[title], values)
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow")
    export_parquet(result, tmp_path / "run.parquet")
    columns = parquet.read_table(tmp_path / "run.parquet")
    for title, values in expected.items():
        np.testing.assert_array_equal(columns[title].to_numpy(), values)


def test_without_contacts():
    """A chain that touches nothing has none of this, and no column of it."""
    chain = hf.ClosedChain({}, hf.HeldObject.box(MASS, *EDGES), {})
    run = hf.simulate(chain, hf.State([], [], hf.Pose.identity()), nothing, 0.02, 0.01)
    assert all(getattr(run, name).shape == (len(run), 0) for name in TOUCH_FIELDS)
