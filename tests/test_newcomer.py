"""A newcomer's first hour: the README's example as printed, then two robots of their own, a plot and a page."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf

README = Path(__file__).parents[1] / "README.md"

# A seven-joint arm of the Panda's shape: origin xyz and rpy, limits [rad], effort [N m], mass [kg] and its centre
JOINTS = (
    ("0 0 0.333", "0 0 0", (-2.9, 2.9), 87, 4.9, "0 0 -0.05"),
    ("0 0 0", "-1.5707963267948966 0 0", (-1.7, 1.7), 87, 2.2, "0 -0.08 0"),
    ("0 -0.316 0", "1.5707963267948966 0 0", (-2.9, 2.9), 87, 3.2, "0.03 0.04 -0.07"),
    ("0.0825 0 0", "1.5707963267948966 0 0", (-3.0, -0.1), 87, 3.5, "-0.05 0.1 0.03"),
    ("-0.0825 0.384 0", "-1.5707963267948966 0 0", (-2.9, 2.9), 12, 2.1, "-0.01 0.04 -0.04"),
    ("0 0 0", "1.5707963267948966 0 0", (0.0, 3.7), 12, 1.6, "0.06 -0.01 -0.01"),
    ("0.088 0 0", "1.5707963267948966 0 0", (-2.9, 2.9), 12, 0.7, "0.01 0 0.06"),
)


def urdf(name: str, heavier: float) -> str:
    """Return a description as a newcomer has one; `heavier` multiplies every mass."""
    parts = [f'<robot name="{name}"> <link name="link0"/>']
    for k, (xyz, rpy, (low, high), effort, mass, com) in enumerate(JOINTS, 1):
        m = heavier * mass
        parts.append(f"""
  <joint name="joint{k}" type="revolute"> <parent link="link{k - 1}"/> <child link="link{k}"/>
    <origin xyz="{xyz}" rpy="{rpy}"/> <axis xyz="0 0 1"/>
    <limit lower="{low}" upper="{high}" velocity="2.2" effort="{effort}"/> </joint>
  <link name="link{k}"> <inertial> <origin xyz="{com}"/> <mass value="{m}"/>
    <inertia ixx="{0.004 * m}" iyy="{0.004 * m}" izz="{0.003 * m}" ixy="0" ixz="0" iyz="0"/> </inertial> </link>""")
    parts.append("""
  <joint name="flange_joint" type="fixed"> <parent link="link7"/> <child link="flange"/> <origin xyz="0 0 0.107"/>
  </joint> <link name="flange"/>
</robot>""")
    return "".join(parts)


def test_the_readme_as_printed(tmp_path: Path):
    """The first block of Python, pasted into a file of an empty folder, runs without a warning."""
    block = re.search(r"^```python\n(.*?)^```$", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert block is not None
    script = tmp_path / "first.py"
    script.write_text(block[1], encoding="utf-8")
    environment = os.environ | {"HOLDFAST_CACHE": str(tmp_path / "cache"), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-W", "error", script.name],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "regular: rank 12 of 12" in done.stdout
    printed = done.stdout[done.stdout.index("[") + 1 : done.stdout.index("]")]
    wrench = np.array(printed.split(), dtype=float)
    assert wrench == pytest.approx([0, 0, 0, 20.0, 0, 3.0 * 9.81 / 2], abs=1e-9)


@pytest.fixture(scope="module")
def lifted(tmp_path_factory) -> tuple[hf.ClosedChain, hf.State, np.ndarray]:
    """Return two robots of their own that hold a box, and the torques that hold it and squeeze."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "left.urdf").write_text(urdf("left", 1.0))
    (folder / "right.urdf").write_text(urdf("right", 1.2))
    arms = {
        "left": hf.load_urdf(folder / "left.urdf", mount=[1, 0, 0, 0, -0.55, 0, 0]),
        "right": hf.load_urdf(folder / "right.urdf", mount=[0, 0, 0, 1, 0.55, 0, 0]),
    }
    box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.2, z=0.2)
    grasps = {
        "left": hf.Grasp("rigid", hf.Pose.from_wxyz_xyz([0.5, -0.5, 0.5, -0.5, -0.15, 0, 0])),
        "right": hf.Grasp("rigid", hf.Pose.from_wxyz_xyz([0.5, -0.5, -0.5, 0.5, 0.15, 0, 0])),
    }
    chain, state = hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.72])
    return chain, state, hf.holding_torques(chain, state, internal=20.0)


def test_forces_at_each_hand_of_ones_own(lifted):
    """Each hand has half the weight and all of the squeeze; each base has its own arm and half the box."""
    chain, state, tau = lifted
    result = hf.forward_dynamics(chain, state, tau)
    for name, side, heavier in (("left", 1, 1.0), ("right", -1, 1.2)):
        assert result[name].grasp_wrench[3:] == pytest.approx([20.0 * side, 0, 3.0 * 9.81 / 2], abs=1e-9)
        arm = heavier * sum(joint[4] for joint in JOINTS)
        assert result[name].base_wrench[5] == pytest.approx((arm + 1.5) * 9.81, rel=1e-10)
    assert np.abs(result.qdd).max() < 1e-9


@pytest.fixture(scope="module")
def run(lifted) -> hf.simulation.Trajectory:
    """Return a short run under those torques."""
    chain, state, tau = lifted
    return hf.simulate(chain, state, lambda t, state, memory: (tau, memory), duration=0.04, step=0.01)


def test_plots_of_ones_own(lifted, run, tmp_path):
    """Every figure of a run, as files to open."""
    from holdfast.view.plots import save_plots

    names = save_plots(lifted[0], run, tmp_path)
    assert {"grasp_wrenches.png", "load_share.png"} <= set(names)
    for name in names:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_a_page_of_ones_own(lifted, run, tmp_path):
    """One HTML file that opens from disk."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    from holdfast.view.page import export_page
    from holdfast.view.playback import playback_of_run

    export_page(playback_of_run(lifted[0], run, "my own robots"), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<title>my own robots</title>" in text
    assert text.rstrip().endswith("</html>")


def test_a_run_of_ones_own_goes_everywhere(lifted, tmp_path):
    """CSV, Parquet, MCAP, a folder and a page, by methods of the run."""
    for needed in ("pyarrow", "mcap_ros2", "viser"):
        pytest.importorskip(needed, reason=f"needs {needed}: pip install 'holdfast[parquet,ros,view]'")
    chain, state, _ = lifted
    run = hf.simulate(chain, state, hf.control.GravityCompensation(chain, squeeze=20.0), duration=0.02, step=0.01)
    run.to_csv(tmp_path / "run.csv")
    run.to_parquet(tmp_path / "run.parquet")
    run.to_mcap(tmp_path / "run.mcap")
    run.save(tmp_path / "run")
    run.page(tmp_path / "run.html")
    assert hf.load_result(tmp_path / "run").samples == len((tmp_path / "run.csv").read_text().splitlines()) - 1 == 3
    assert (tmp_path / "run.parquet").read_bytes()[:4] == b"PAR1"
    assert (tmp_path / "run.mcap").read_bytes()[1:5] == b"MCAP"
    assert "</html>" in (tmp_path / "run.html").read_text()


def test_a_thousand_randomised_rollouts(lifted, tmp_path):
    """A histogram of a thousand payloads; number 17 comes back from the folder as a run of its own payload."""
    chain, state, tau = lifted
    rollout, masses = hf.compile_rollout(chain), np.random.default_rng(0).uniform(2.0, 4.0, 1000)
    payload = {"object_mass": masses, "object_inertia": "scale", "tau": tau}
    start = [np.tile(x, (1000, 1)) for x in (state.q, state.qd, state.object_pose, state.object_twist)]
    record = rollout.run(rollout.start(*start, **payload), 0.002, 0.001)
    counts, _ = np.histogram(record["object_pose"][-1, :, 6], bins=20)
    run = hf.io.load_record(record.save(tmp_path / "many"), rollout).trajectory(17)
    assert counts.sum() == 1000
    assert np.array_equal(run.q, record["q"][:, 17])
    heavier = masses > 3.0  # the torques hold 3 kg
    sinks = record["object_twist"][-1, :, 5] < 0
    assert (sinks == heavier).all()
