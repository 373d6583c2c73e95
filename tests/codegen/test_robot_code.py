"""The example project: built by CMake with Debian's compilers, it does what Python does."""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli.commands import run
from holdfast.control import compile_law
from tests.codegen.exported import require

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
EXAMPLE, SCENE = ROOT / "examples" / "robot_code", ROOT / "examples" / "two_pandas.toml"
SAMPLE = 1e-3


@pytest.fixture(scope="module")
def code(tmp_path_factory):
    """The folder that the example's command writes."""
    folder = tmp_path_factory.mktemp("robot") / "code"
    text = (EXAMPLE / "CMakeLists.txt").read_text()
    command = re.search(r"holdfast (export-c .*?)\n#\n", text, re.DOTALL)[1].replace("\\\n#", "").split()
    command[command.index("../two_pandas.toml")] = str(SCENE)
    command[command.index("code")] = str(folder)
    assert run(command) == 0
    return folder


def build(source: Path, folder: Path, **definitions: Path) -> None:
    """Configure and build a CMake project."""
    defined = [f"-D{name}={x}" for name, x in definitions.items()]
    subprocess.run(["cmake", "-S", source, "-B", folder, *defined], check=True, timeout=300, capture_output=True)
    subprocess.run(["cmake", "--build", folder], check=True, timeout=300, capture_output=True)


@pytest.mark.slow
def test_carry(code, tmp_path, monkeypatch):
    """Two seconds of controller and plant, 1,000 times a second: the box where Python's run has it, to the bit."""
    require("cmake", "gcc", "g++")
    build(EXAMPLE, tmp_path, CODE=code)
    out = subprocess.run([tmp_path / "carry"], check=True, capture_output=True, text=True, timeout=60).stdout
    exactly = re.search(r"exactly:(.*)", out)[1].split()
    assert [float.fromhex(x) for x in exactly] == list(carried_by_python())
    times = re.findall(r"([\d.]+) s: the box is at .* (\d\.\d+) m", out)
    assert [t for t, _ in times] == ["0.4", "0.8", "1.2", "1.6", "2.0"]
    assert float(times[-1][1]) == pytest.approx(0.92, abs=1e-3)  # 0.72 m and the 0.2 m of the path


def carried_by_python() -> np.ndarray:
    """Return the box's pose after the same two seconds."""
    scene = hf.load_scene(SCENE)
    law, rollout = compile_law(scene.controller, scene.chain), hf.compile_rollout(scene.chain)
    s = scene.state
    systems = rollout.start(s.q, s.qd, s.object_pose, s.object_twist, tau=np.zeros(14))
    for k in range(2000):
        tau = law.torques(k * SAMPLE, systems.q, systems.qd, systems.object_pose, systems.object_twist).tau
        rollout.step(systems, SAMPLE, tau=tau)
    return systems.object_pose[0]


@pytest.mark.slow
def test_ros2_controller(code, tmp_path):
    """The ros2_control example's torques, from joint states alone, are the controller's; invalid states are refused."""
    require("g++")
    stand_in = Path(__file__).parent / "ros"
    program = tmp_path / "manager"
    include = [f"-I{x}" for x in (code, stand_in, EXAMPLE / "ros2_control")]
    sources = [stand_in / "manager.cpp", EXAMPLE / "ros2_control" / "carry_controller.cpp", code / "pandas.o"]
    flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    subprocess.run(["g++", *flags, *include, "-o", program, *sources], check=True, timeout=300)
    scene = hf.load_scene(SCENE)
    run = hf.simulate(scene.chain, scene.state, scene.controller, duration=1.0, step=0.01)
    rows = [np.concatenate([run.q[k], run.qd[k]]) for k in range(0, 100, 10)]
    text = "\n".join(" ".join(map(repr, row.tolist())) for row in rows) + "\n" + "nan " * 28
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True, timeout=60)
    *found, refused = done.stdout.splitlines()
    assert refused == "refused"
    for k, line in enumerate(found):
        state = run.state(10 * k)
        tau, _ = scene.controller(k * SAMPLE, state, None)
        assert np.allclose([float(x) for x in line.split()], tau, rtol=0.0, atol=1e-8), k
    assert len(found) == len(rows)


def test_find_package_and_pkg_config(code, tmp_path):
    """The other two ways in which projects find code."""
    require("cmake", "gcc", "pkg-config")
    (tmp_path / "main.c").write_text('#include "pandas.h"\nint main(void) { return PANDAS_STEP_RUNNING; }\n')
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\nproject(p LANGUAGES C)\nfind_package(pandas REQUIRED)\n"
        "add_executable(p main.c)\ntarget_link_libraries(p holdfast::pandas)\n"
    )
    build(tmp_path, tmp_path / "build", pandas_DIR=code)
    subprocess.run([tmp_path / "build" / "p"], check=True, timeout=60)
    environment = {**os.environ, "PKG_CONFIG_PATH": str(code)}
    asked = ["pkg-config", "--cflags", "--libs", "pandas"]
    flags = subprocess.run(asked, env=environment, check=True, capture_output=True, text=True).stdout.split()
    command = ["gcc", "main.c", *flags, "-o", "q"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    subprocess.run([tmp_path / "q"], check=True, timeout=60)
