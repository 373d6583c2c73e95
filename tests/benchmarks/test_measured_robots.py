"""Logs of measured robots, made from files as their sources have them."""

import numpy as np
import pytest
from benchmarks.measured_robots import EVERY, LOGS, columns, convert_gen3, convert_panda, main


def test_a_log_of_the_panda_has_one_number_a_line(tmp_path):
    random, samples = np.random.default_rng(0), 41
    read = {"time": np.arange(samples) / 1000} | {
        name: random.normal(size=(samples, 7)) for name in ("positions", "velocity", "torques")
    }
    (tmp_path / "rbt_log").mkdir()
    for name, values in read.items():
        np.savetxt(tmp_path / "rbt_log" / f"exciting_traj_{name}.txt", values.ravel())
    t, q, qd, tau = columns(convert_panda(tmp_path, tmp_path / "logs"), "t", "q", "qd", "tau")
    assert t == pytest.approx(read["time"][::EVERY])
    for found, name in ((q, "positions"), (qd, "velocity"), (tau, "torques")):
        assert found == pytest.approx(read[name][::EVERY])
    np.savetxt(tmp_path / "rbt_log" / "exciting_traj_torques.txt", read["torques"].ravel()[:-1])
    with pytest.raises(SystemExit, match="torques: expected 7 numbers for each of 41 times, got 286"):
        convert_panda(tmp_path, tmp_path / "logs")


def test_a_log_of_the_gen3_has_other_columns_too(tmp_path):
    names = [
        f"{kind}{k}" for kind in ("Position", "Velocity", "Torque", "TorqueSm", "Temp", "Cur") for k in range(1, 8)
    ]
    table = np.column_stack([np.arange(9), np.random.default_rng(0).normal(size=(9, len(names)))])
    path = tmp_path / "opti_traj_testing2.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(["Time", *names]), comments="")
    t, q, qd, tau, current = columns(convert_gen3(tmp_path, tmp_path), "t", "q", "qd", "tau_sensor", "current")
    assert t == pytest.approx(np.arange(9) / 1000)
    for k, found in ((0, q), (1, qd), (3, tau), (5, current)):
        assert found == pytest.approx(table[:, 1 + 7 * k : 8 + 7 * k])
    path.write_text("Time,Position1\n0,1\n1,2\n")
    with pytest.raises(SystemExit, match="expected columns Position2"):
        convert_gen3(tmp_path, tmp_path)


def test_an_absent_source_is_named(tmp_path):
    with pytest.raises(SystemExit, match=r"expected exciting_traj_time\.txt in it, got none"):
        convert_panda(tmp_path, tmp_path)


def test_robots_without_logs_are_left_out_and_named_if_asked_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["measured_robots", str(tmp_path)])
    assert main() == 0
    said = capsys.readouterr().out
    for log in LOGS.values():
        assert f"left out: expected {log}" in said
    monkeypatch.setattr("sys.argv", ["measured_robots", str(tmp_path), "ur5e"])
    with pytest.raises(SystemExit, match=r"ur5e: expected dual_ur5e_\*kg\*\.csv"):
        main()
