"""Recordings whose columns have names, units, signs and zeros of their own, in every kind of file."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.identification import Recording, load_recording
from tests.systems import random_system
from tests.systems.as_chain import as_chain

MAP = {
    "time": "stamp",
    "time_unit": "ms",
    "arms": {
        "arm1": {
            "position": {"columns": "l_q{1}", "unit": "deg", "sign": [1, -1, 1], "offset": [0, 10, 0]},
            "velocity": {"columns": "l_w{1}", "unit": "rpm"},
            "current": {"columns": "l_i{1}", "unit": "mA"},
            "wrist_force": {"columns": ["fx", "fy", "fz"], "sign": -1},
        },
        "arm2": {
            "position": {"columns": ["r0", "r1", "r2"], "unit": ["rad", "mrad", "rad"]},
            "velocity": {"columns": "r_w{0}"},
            "current": {"columns": ["a", "b", "c"], "scale": 2.0},
            "wrist_force": {"columns": "g{0}", "unit": "kN"},
        },
    },
}


@pytest.fixture(scope="module")
def chain() -> hf.ClosedChain:
    """Return two arms of three joints each that hold a body."""
    system = random_system(2, arms=2, joints=3, grasps="ball", moving_base=False, extras=False)
    found = as_chain(system).chain
    assert all(joint.turns for joint in found.all_joints)
    return found


@pytest.fixture(scope="module")
def truth(chain) -> Recording:
    """Return a recording."""
    random, t = np.random.default_rng(0), np.cumsum(np.random.default_rng(1).uniform(0.01, 0.02, 20))
    q, qd, current = (random.normal(size=(20, 6)) for _ in range(3))
    return Recording(t=t - t[0], q=q, qd=qd, current=current, wrist_force=random.normal(size=(20, 2, 3)))


def readings(truth: Recording) -> dict[str, np.ndarray]:
    """Return the columns of MAP, as instruments with these units and signs would have written them."""
    q, w, i, f = np.degrees(truth.q), truth.qd, truth.current, truth.wrist_force
    assert w is not None and i is not None and f is not None
    columns = {"stamp": 1e3 * truth.t + 5000.0, "state": 1.0 + 0 * truth.t}
    columns |= {"l_q1": q[:, 0], "l_q2": 10 - q[:, 1], "l_q3": q[:, 2]}
    columns |= {"r0": truth.q[:, 3], "r1": 1e3 * truth.q[:, 4], "r2": truth.q[:, 5]}
    columns |= {f"l_w{k + 1}": w[:, k] * 60 / (2 * np.pi) for k in range(3)}
    columns |= {f"r_w{k}": w[:, 3 + k] for k in range(3)}
    columns |= {f"l_i{k + 1}": 1e3 * i[:, k] for k in range(3)} | {x: i[:, 3 + k] / 2 for k, x in enumerate("abc")}
    columns |= {f"f{x}": -f[:, 0, k] for k, x in enumerate("xyz")} | {f"g{k}": f[:, 1, k] / 1e3 for k in range(3)}
    return columns


def write_csv(path: Path, columns: dict, separator: str = ",") -> Path:
    """Write columns."""
    with path.open("w", newline="") as file:
        table = csv.writer(file, delimiter=separator)
        table.writerow(columns)
        table.writerows(zip(*(np.asarray(x).tolist() for x in columns.values()), strict=True))
    return path


def write_mcap(path: Path, columns: dict, truth: Recording) -> Path:
    """Write the columns as ROS 2 messages: joints on one topic, sensors on others that have other stamps."""
    writer_of = pytest.importorskip("mcap_ros2.writer").Writer
    from holdfast.interop.mcap_writer import JOINT_MESSAGE, WRENCH_MESSAGE, definition

    with path.open("wb") as file:
        writer = writer_of(file)
        joint, wrench = (writer.register_msgdef(kind, definition(kind)) for kind in (JOINT_MESSAGE, WRENCH_MESSAGE))
        names = [name for name in columns if name[0] in "lr" and "_i" not in name and "_w" not in name]
        for k, t in enumerate(truth.t.tolist()):
            time = round(1e9 * (t + 1.7e9))
            header = {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": ""}
            position = [float(columns[name][k]) for name in names]
            body = {"header": header, "name": names, "position": position, "velocity": [], "effort": []}
            writer.write_message("/joints", joint, body, log_time=time + 7, publish_time=time)
            force = {axis: float(columns[f"f{axis}"][k]) for axis in "xyz"}
            body = {"header": header, "wrench": {"force": force, "torque": dict.fromkeys("xyz", 0.0)}}
            writer.write_message("/left", wrench, body, log_time=time, publish_time=time)
        writer.finish()
    return path


@pytest.mark.parametrize("kind", ["comma", "semicolon", "parquet", "npz"])
def test_units_signs_and_zeros(kind, chain, truth, tmp_path):
    """What instruments wrote comes back in SI units."""
    columns, given = readings(truth), dict(MAP)
    if kind in ("comma", "semicolon"):
        path = write_csv(tmp_path / "log.csv", columns | {"text": ["a"] * 20}, ";" if kind == "semicolon" else ",")
    elif kind == "npz":
        path = tmp_path / "log.npz"
        columns["l_q"] = np.column_stack([columns.pop(f"l_q{k}") for k in (1, 2, 3)])
        left = MAP["arms"]["arm1"]
        given["arms"] = MAP["arms"] | {"arm1": left | {"position": left["position"] | {"columns": "l_q"}}}
        np.savez(path, **columns, rate=100.0)
    else:
        arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        path = tmp_path / "log.parquet"
        parquet.write_table(arrow.table(columns), path)
    found = load_recording(path, chain, columns=given)
    assert np.allclose(found.t - found.t[0], truth.t, atol=1e-12)
    for name in ("q", "qd", "current", "wrist_force"):
        assert np.allclose(getattr(found, name), getattr(truth, name), atol=1e-12), name
    assert found.notes == () and found.tau is None


def test_ros_messages(chain, truth, tmp_path):
    """Joints by name on one topic, forces on another."""
    path = write_mcap(tmp_path / "log.mcap", readings(truth), truth)
    left, right = MAP["arms"]["arm1"]["position"], MAP["arms"]["arm2"]["position"]
    at = "/joints position "
    force = {"columns": [f"/left wrench.force.{axis}" for axis in "xyz"], "sign": -1}
    given = {
        "arms": {
            "arm1": {"position": left | {"columns": at + "l_q{1}"}, "wrist_force": force},
            "arm2": {"position": right | {"columns": at + "r{0}"}, "wrist_force": force},
        }
    }
    found = load_recording(path, chain, columns=given)
    assert np.allclose(found.t, truth.t, atol=2e-9)
    assert np.allclose(found.q, truth.q, atol=1e-12)
    assert np.allclose(found.wrist_force[:, 0], truth.wrist_force[:, 0], atol=1e-12)


def test_a_run_as_ros_messages(tmp_path):
    """What a simulated run writes as MCAP is read without a map."""
    pytest.importorskip("mcap_ros2")
    from holdfast.interop.mcap_writer import write_mcap as write_mcap_run

    p = as_chain(random_system(2, arms=2, joints=3, grasps="ball", moving_base=False, extras=False))
    run = hf.simulate(p.chain, p.state, lambda t, state, memory: (p.tau, memory), 0.02, 0.004)
    write_mcap_run(p.chain, run, tmp_path / "run.mcap")
    found = load_recording(tmp_path / "run.mcap", p.chain)
    assert np.array_equal(found.q, run.q) and np.array_equal(found.tau, run.tau)


def test_arrays_of_a_recording(truth, chain, tmp_path):
    """An archive with the names of a Recording needs no map."""
    arrays = {name: getattr(truth, name) for name in ("t", "q", "qd", "current", "wrist_force")}
    np.savez(tmp_path / "log.npz", **arrays)
    found = load_recording(tmp_path / "log.npz", chain)
    for name, array in arrays.items():
        assert np.array_equal(getattr(found, name), array), name


def test_units_in_titles(truth, chain, tmp_path):
    """A title's unit counts, and contradicts another one."""
    columns = readings(truth)
    columns["r1 [mrad]"] = columns.pop("r1")
    path = write_csv(tmp_path / "log.csv", columns)
    right = MAP["arms"]["arm2"]
    bare = MAP["arms"] | {"arm2": right | {"position": {"columns": ["r0", "r1", "r2"]}}}
    assert np.allclose(load_recording(path, chain, columns=MAP | {"arms": bare}).q, truth.q)
    wrong = MAP["arms"] | {"arm2": right | {"position": {"columns": ["r0", "r1", "r2"], "unit": "rad"}}}
    with pytest.raises(hf.errors.ResultError, match=r"r1: expected the unit of the column's title, \[mrad\]"):
        load_recording(path, chain, columns=MAP | {"arms": wrong})


def test_masks_and_bad_rows(truth, chain, tmp_path):
    """Rows that are not valid, outside of a time, repeated or incomplete: refused by name, or dropped with a note."""
    columns = {name: x.tolist() for name, x in readings(truth).items()}
    columns["stamp"][4] = columns["stamp"][3]
    columns["l_q2"][7] = ""
    columns["l_i3"][9] = ""
    columns["state"][0] = 0
    path, drop = write_csv(tmp_path / "log.csv", columns), MAP | {"bad_rows": "drop", "valid": "state"}
    with pytest.raises(hf.errors.ResultError, match="line 9, l_q2: expected a number, got none"):
        load_recording(path, chain, columns=MAP)
    found = load_recording(path, chain, columns=drop)
    assert np.allclose(found.t, truth.t[[1, 2, 3, 5, 6, *range(8, 20)]] + 5.0)
    assert found.used is not None and found.used.sum() == 17 * 6 - 1 and found.used[6, 2] == 0.0
    assert [note.partition(":")[0] for note in found.notes] == [
        "state", "1 rows with missing numbers were dropped", "1 missing entries of current do not count", "stamp",
    ]  # fmt: skip
    late = load_recording(path, chain, columns=drop | {"begin": 0.14, "end": 10.0})
    assert len(late) == (truth.t >= 0.14).sum()
    with pytest.raises(hf.errors.ResultError, match="line 6, stamp: expected increasing times"):
        load_recording(path, chain, columns=MAP | {"end": 0.06})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"arms": {"arm1": MAP["arms"]["arm1"]}}, "expected columns of 'arm2'"),
        ({"arms": MAP["arms"] | {"arm3": MAP["arms"]["arm1"]}}, "no arm 'arm3'. Did you mean"),
        ({"time": "stam"}, "expected a column 'stam .s.'. Did you mean 'stamp'"),
        ({"time_unit": "deg"}, "expected a unit among s, ms, us, ns, min; got 'deg', which is a unit of rad"),
        ({"tme": "t"}, "columns: .*unknown field `tme`.* Did you mean 'time'"),
        ({"cutoff": 500.0}, "cutoff: expected below"),
        ({"valid": "stat"}, "expected a column 'stat'. Did you mean 'state'"),
        ({"begin": 4.0, "end": 1.0}, "end: expected a time after the begin"),
        ({"begin": 4.0}, "expected samples to use"),
    ],
)
def test_wrong_maps(change, said, chain, truth, tmp_path):
    """The key or the column is named."""
    path = write_csv(tmp_path / "log.csv", readings(truth))
    with pytest.raises(hf.errors.HoldfastError, match=said):
        load_recording(path, chain, columns=MAP | change)


@pytest.mark.parametrize(
    ("part", "change", "said"),
    [
        ("position", {"columns": ["r0", "r1"]}, "expected 3 columns, got 2"),
        ("position", {"columns": ["r0", "r1", "r1"]}, "expected each column once, got 'r1' twice"),
        ("position", {"columns": "r_{0}"}, "expected a column 'r_0'. Did you mean"),
        ("position", {"columns": "r"}, r"try a pattern such as 'r\{1\}'"),
        ("position", {"columns": "r{0}", "unit": "N"}, "expected a unit among rad, mrad, deg, rev; got 'N'"),
        ("position", {"columns": "r{0}", "sign": 2}, "sign: expected 1 or -1"),
        ("position", {"columns": "r{0}", "sign": [1, -1]}, "once or 3 times"),
        ("current", {"columns": "r{0}", "scale": 0}, "scale: expected numbers other than 0"),
        ("current", {"columns": ["", "r1", "r2"]}, None),
        ("position", {"columns": ["", "r1", "r2"]}, "expected a column ''"),
    ],
)
def test_wrong_columns(part, change, said, chain, truth, tmp_path):
    """The key or the column is named."""
    path = write_csv(tmp_path / "log.csv", readings(truth))
    arms = MAP["arms"] | {"arm2": MAP["arms"]["arm2"] | {part: change}}
    if said is None:
        used = load_recording(path, chain, columns=MAP | {"arms": arms}).used
        assert used is not None and used.sum(axis=0).tolist() == [20, 20, 20, 0, 20, 20]
        return
    with pytest.raises(hf.errors.HoldfastError, match=said):
        load_recording(path, chain, columns=MAP | {"arms": arms})


def test_joints_at_their_limits_do_not_count(tmp_path):
    """Torques at the effort limit, and positions at the end of a range, also where they are filtered."""
    joints = [
        hf.Joint(axis=[0, 1, 0], position_limits=(-1.0, 1.0), effort_limit=5.0),
        hf.Joint(placement=hf.Pose.translation(0, 0, 0.3)),
    ]
    chain = hf.ClosedChain({"arm": hf.Arm(joints, [hf.Link(1.0, [0, 0, 0.1], 0.01 * np.eye(3))] * 2)})
    t = np.linspace(0.0, 4.0, 400)
    q = np.column_stack([np.clip(1.2 * np.sin(3 * t), -1.0, 1.0), np.sin(2 * t)])
    tau = np.column_stack([np.clip(7.0 * np.cos(2 * t), -5.0, 5.0), 9.0 * np.cos(t)])
    columns = {"t": t, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]}
    path = write_csv(tmp_path / "log.csv", columns)
    given = {"arms": {"arm": {"position": {"columns": "q{1}"}, "torque": {"columns": "tau{1}"}}}}
    plain = load_recording(path, chain, columns=given)
    assert plain.used is None
    found = load_recording(path, chain, columns=given | {"at_limits": "drop"})
    assert found.used is not None
    clipped = (np.abs(q[:, 0]) >= 0.998) | (np.abs(tau[:, 0]) >= 4.995)
    assert clipped.tolist() == (found.used[:, 0] == 0.0).tolist()
    assert found.used[:, 1].all() and "joints at a limit do not count: 'arm/joint1'" in found.notes[0]
    smooth = load_recording(path, chain, columns=given | {"at_limits": "drop", "cutoff": 8.0})
    assert smooth.used is not None and 0.0 < smooth.used[:, 0].mean() < found.used[:, 0].mean()
