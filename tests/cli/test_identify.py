"""`holdfast identify`: a recording with columns of its own, its answer, its page, and what is bad about a bad one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.faulty_recordings import SCENE, arm, as_text, sound

import holdfast as hf
from holdfast.identification import Recording

COLUMNS = """
[recording]
time = "stamp"
time_unit = "ms"
[recording.arms.arm]
position = { columns = "q{1}", unit = "deg" }
torque = { columns = "tau{1}", sign = -1 }
"""


@pytest.fixture
def scene(tmp_path) -> Path:
    """Return a scene beside its recording, in degrees, milliseconds and torques of the opposite sign."""
    columns = sound(arm()[0], np.random.default_rng(0))
    columns = {"stamp": 1e3 * columns.pop("t"), **columns}
    for k in range(1, 4):
        columns[f"q{k}"] = np.degrees(columns[f"q{k}"])
        columns[f"tau{k}"] = -columns[f"tau{k}"]
    (tmp_path / "log.csv").write_text(as_text(columns))
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.partition("[recording")[0] + COLUMNS)
    return path


@pytest.mark.slow
def test_a_recording(scene, tmp_path, cli):
    """The friction that it has, predicted samples, and a page that needs nothing else."""
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    options = ["--model", scene, "--unknowns", "damping", "--unknowns", "friction", "--format", "json", "--out", out]
    answer = json.loads(cli("identify", tmp_path / "log.csv", *options).out)
    assert answer["by"] == "tau" and answer["samples"] == [90] and answer["criteria"] == []
    for joint in ("arm/joint1", "arm/joint2", "arm/joint3"):
        assert abs(answer["values"][f"{joint} damping"] - 0.3) < 0.05
        assert answer["held_out"][joint] < 2.0 * answer["fitted"][joint]
    page = (out / "identification.html").read_text()
    assert "Good fit" in page and page.count("data:image/png") == 4 and "http" not in page
    assert {Path(one).name for one in answer["files"]} == {path.name for path in out.iterdir()}


def test_a_bad_fit(scene, tmp_path, cli):
    """The sign of a torque: exit code 3, and the criterion."""
    changes = ["recording.arms.arm.torque.sign=[-1, 1, -1]", 'recording.file="log.csv"']
    options = ["--model", scene, "--set", changes[0], "--set", changes[1]]
    answer = cli("identify", *options, "--unknowns", "friction", code=3)
    assert "bad fit: tau of 'arm/joint2' has most likely the opposite sign" in answer.out


def test_usage(scene, tmp_path, cli):
    """What is missing or unknown is said."""
    log = tmp_path / "log.csv"
    for arguments, said in (
        ([], "expected a file, or recording.file in the scene"),
        ([log, "--prior", "link=0.1"], "Did you mean 'links'"),
        ([log, "--prior", "links=much"], "links: expected a number, got 'much'"),
        ([log, "--by", "current"], "expected current, got none; it has tau"),
        ([log, "--added", "other.csv=2"], "--added: 'other.csv': expected one of"),
        ([log, "--added", "log.csv=two"], "expected MASS or MASS,X,Y,Z, got 'two'"),
        ([log, "--added", "log.csv=2,0,1"], "expected MASS or MASS,X,Y,Z, got 3 numbers"),
        ([tmp_path / "other.csv"], "cannot be read"),
        ([log, "--set", 'recording.time="tim"'], "expected a column 'tim"),
    ):
        assert said in cli("identify", *arguments, "--model", scene, code=2).err, arguments


HELD = """
object = { mass = 1.0, box = [0.1, 0.1, 0.1], pose = { position = [0.0, 0.0, 0.8] } }
grasps = [{ arm = "arm", kind = "rigid" }]
"""
CURRENTS = """
[recording.arms.arm]
position = { columns = "q{1}" }
current = { columns = "i{1}" }
"""


@pytest.mark.slow
def test_a_known_mass_in_one_of_two_recordings(tmp_path, cli):
    """Gains of the drives and the payload, from currents without and with 1.5 kg that are known."""
    bare, gains = arm()[0], np.array([10.0, 12.0, 8.0])
    (tmp_path / "scene.toml").write_text(HELD + SCENE.partition("[recording")[0] + CURRENTS)
    chain = hf.load_scene(tmp_path / "scene.toml").chain
    assert bare.joint_count == chain.joint_count
    heavy = hf.HeldObject.sphere(1.5, float(np.cbrt(1.5 / (4 / 3 * np.pi * 7850.0))))
    for name, seed, added in (("one.csv", 0, None), ("two.csv", 1, replace(heavy, com=np.array([0.0, 0.0, 0.1])))):
        columns = sound(bare, np.random.default_rng(seed))
        motion = {kind: np.column_stack([columns[f"{kind}{k}"] for k in (1, 2, 3)]) for kind in ("q", "qd")}
        given = Recording(t=columns["t"], **motion, tau=0.0 * motion["q"], added=added)
        tau = -hf.identification.measurement_errors(chain, given, "tau")
        table = {"t": columns["t"]} | {f"q{k + 1}": motion["q"][:, k] for k in range(3)}
        (tmp_path / name).write_text(as_text(table | {f"i{k + 1}": (tau / gains)[:, k] for k in range(3)}))
    files = [tmp_path / "one.csv", tmp_path / "two.csv", "--model", tmp_path / "scene.toml", "--format", "json"]
    seek = ["--unknowns", "payload", "--unknowns", "drive_gain", "--prior", "payload=0.5"]
    answer = json.loads(cli("identify", *files, *seek, "--added", "two.csv=1.5,0,0,0.1").out)
    assert answer["values"]["mass"] == pytest.approx(1.0, abs=0.02)
    for k, gain in enumerate(gains):
        assert answer["values"][f"arm/joint{k + 1} drive gain"] == pytest.approx(gain, rel=0.01)
