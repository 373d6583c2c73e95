"""Recordings from files: tables as they are exported, and result folders."""

from __future__ import annotations

import csv

import numpy as np
import pytest

import holdfast as hf
from holdfast.identification import Recording, load_recording
from holdfast.io.columns import array_columns
from holdfast.io.save_run import meta_of
from holdfast.simulation.setting import Setting
from holdfast.simulation.trajectory import RUN_ARRAYS
from tests.identification.recorded import recorded, two_pandas

OBJECT_MOTION = ("object_pose", "object_twist", "object_acceleration")


@pytest.fixture(scope="module")
def short() -> Recording:
    """Return a few samples."""
    return recorded(*two_pandas(), duration=1.0, rate=8.0)


def titles(chain: hf.ClosedChain) -> dict[str, list[str]]:
    """Return the columns of each array."""
    meta, names = meta_of(Setting(chain)), ("t", "q", "qd", "qdd", "tau", "wrist_wrench", *OBJECT_MOTION)
    return {x: [one.title for one in array_columns(x, RUN_ARRAYS[x].shape(chain), meta)] for x in names}


def write(path, chain, recording, without=()):
    """Write a table with one column more than needed."""
    columns = {name: head for name, head in titles(chain).items() if name not in without}
    rows = [np.asarray(getattr(recording, name)).reshape(len(recording), -1) for name in columns]
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([title for head in columns.values() for title in head] + ["note"])
        table.writerows([*row, 7.0] for row in np.hstack(rows).tolist())


@pytest.mark.slow
def test_csv(short, tmp_path):
    """Every bit comes back; arrays that are not there are None, and the file itself can be given to identify."""
    chain, _ = two_pandas()
    write(tmp_path / "run.csv", chain, short)
    found = load_recording(tmp_path / "run.csv", chain)
    for name in titles(chain):
        assert np.array_equal(getattr(found, name), getattr(short, name)), name
    assert np.array_equal(hf.identify(chain, tmp_path / "run.csv").values, hf.identify(chain, short).values)
    write(tmp_path / "less.csv", chain, short, without=("tau", "object_pose"))
    less = load_recording(tmp_path / "less.csv", chain)
    assert less.tau is None and less.object_pose is None and less.qdd is not None


def test_csv_that_lacks_something(short, tmp_path):
    """The first column that is missing is named, and what it might be called instead; so is a text among numbers."""
    chain, _ = two_pandas()
    path = tmp_path / "run.csv"
    write(path, chain, short)
    whole = path.read_text()
    head = whole[: whole.index("\n")]
    for changed, said in (
        (
            whole.replace("q left/joint3 [rad]", "q left/joint_3 [rad]", 1),
            "'q left/joint3'. Did you mean 'q left/joint_3'",
        ),
        (whole.replace("t [s]", "time", 1), "'t [s]'"),
        (head + whole[len(head) :].replace("0.0,", "nought,", 1), "line 2, t: expected a number, got 'nought'"),
        (head + whole[len(head) :].replace("0.0,", ",", 1), "line 2, t: expected a finite number, got none"),
        (whole.replace(",7.0", "", 1), "line 2: expected"),
        (whole.replace("qd left/joint1 [rad/s]", "q left/joint1 [rad]", 1), "twice"),
        ("t [s]", "a line for each sample"),
    ):
        path.write_text(changed)
        with pytest.raises(hf.errors.ResultError) as raised:
            load_recording(path, chain)
        assert said in str(raised.value)
    path.write_text(whole.replace("7.0", "seven"))
    load_recording(path, chain)  # a column of texts that nobody asks for
    for name in ("run.txt", "absent.csv"):
        with pytest.raises(hf.errors.ResultError):
            load_recording(tmp_path / name, chain)


def test_parquet(short, tmp_path):
    """As CSV; without its package the error says which."""
    chain, _ = two_pandas()
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        with pytest.raises(hf.errors.MissingExtra, match="parquet"):
            load_recording(tmp_path / "run.parquet", chain)
        return
    columns = {}
    for name, head in titles(chain).items():
        columns |= dict(zip(head, np.asarray(getattr(short, name)).reshape(len(short), -1).T, strict=True))
    parquet.write_table(pyarrow.table(columns), tmp_path / "run.parquet")
    assert np.array_equal(load_recording(tmp_path / "run.parquet", chain).q, short.q)


def test_a_simulated_run(tmp_path):
    """What a simulation recorded gives back the payload that it was told, from wrists and from torques."""
    from tests.systems import random_system
    from tests.systems.as_chain import as_chain

    p = as_chain(random_system(2, arms=2, joints=6, grasps="rigid", moving_base=False, extras=False))
    run = hf.simulate(p.chain, p.state, lambda t, state, memory: (p.tau, memory), 0.02, 0.004)
    body = p.chain.held_object
    heavier = hf.HeldObject(1.3 * body.mass, 1.5 * body.inertia, body.com + 0.01)
    guess = hf.ClosedChain(p.chain.arms, heavier, p.chain.grasps, p.chain.gravity)
    for by in ("wrist_wrench", "tau"):
        found = hf.identify(guess, run, by=by, noise=np.full(6, 1e-6) if by == "wrist_wrench" else 1e-6)
        assert abs(found.values[0] / body.mass - 1) < 1e-5, by
