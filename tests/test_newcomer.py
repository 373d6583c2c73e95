"""A newcomer's first hour: the README's example as printed, then programs of at most ten lines for robots of their own.

A program uses public names only, as `PROGRAMS` has it, and runs in a folder with two URDF files and their mesh.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from tests.surface import PUBLIC

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


VISUAL = '<visual> <geometry> <mesh filename="wedge.stl" scale="0.1 0.1 0.1"/> </geometry> </visual>'
IMPORTS = """
import matplotlib.pyplot as plt
import numpy as np
import holdfast as hf
"""
ASSEMBLED = """
left = hf.load_urdf("left.urdf", mount=[1, 0, 0, 0, -0.55, 0, 0])
right = hf.load_urdf("right.urdf", mount=[0, 0, 0, 1, 0.55, 0, 0])
box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.2, z=0.2)
grasps = {"left": hf.Grasp("rigid", hf.contact_frame([-0.15, 0, 0], into=[1, 0, 0]))}
grasps["right"] = hf.Grasp("rigid", hf.contact_frame([0.15, 0, 0], into=[-1, 0, 0]))
chain, state = hf.assemble({"left": left, "right": right}, box, grasps, object_pose=hf.Pose.translation(0, 0, 0.72))
"""
PROGRAMS = {
    "two URDFs to CSV, Parquet, MCAP, a folder and a page with meshes": ASSEMBLED
    + """
run = hf.simulate(chain, state, hf.control.GravityCompensation(chain, internal_force=20.0), duration=0.02, step=0.01)
files = run.to_csv("run.csv"), run.to_parquet("run.parquet"), run.to_mcap("run.mcap")
run.save("run")
run.page("run.html")
""",
    "a sampled controller that saturates": """
gravity = hf.control.GravityCompensation(chain, internal_force=20.0)
most = np.array([0.2 * joint.effort_limit for joint in chain.all_joints])
def saturated(t, state, memory):
    tau, memory = gravity(t, state, memory)
    return np.clip(tau, -most, most), memory
run = hf.simulate(chain, state, saturated, duration=0.04, step=0.002, sample_time=0.01, delay=0.003)
""",
    "a thousand randomised rollouts to a histogram": """
tau = hf.holding_torques(chain, state, internal_force=20.0)
masses = np.random.default_rng(0).uniform(2.0, 4.0, 1000)
rollout = hf.compile_rollout(chain)
each = {"tau": tau, "object_mass": masses, "object_inertia": "scale"}
start = rollout.start(np.tile(state.q, (1000, 1)), state.qd, state.object_pose, state.object_twist, **each)
record = rollout.run(start, 0.02, 0.001)
risen = record["object_pose"][-1, :, 6] - state.object_pose[6]
counts, *_ = plt.hist(1e3 * risen, bins=40)
plt.savefig("risen.png")
""",
    "a box lifted by friction within limits, and the largest payload": """
left = hf.load_urdf("left.urdf", mount=[1, 0, 0, 0, -0.55, 0, 0])
right = hf.load_urdf("right.urdf", mount=[0, 0, 0, 1, 0.55, 0, 0])
box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.2, z=0.2)
rubber = hf.Friction(mu=0.8, torsion_radius=0.02)
pads = {"left": hf.Grasp("softfinger", hf.contact_frame([-0.15, 0, 0], into=[1, 0, 0]), contact=rubber)}
pads["right"] = hf.Grasp("softfinger", hf.contact_frame([0.15, 0, 0], into=[-1, 0, 0]), contact=rubber)
gripped, still = hf.assemble({"left": left, "right": right}, box, pads, object_pose=hf.Pose.translation(0, 0, 0.72))
limits = hf.forces.ForceLimits(effort=0.8, least_margin=2.0)
lift = hf.forces.distribute(gripped, still, [0, 0, 0, 0, 0, 1.0], limits=limits)
payload = hf.forces.lift_margin(gripped, still, payload=True, limits=limits)
""",
    "a look at number 17 of them": """
run = record.trajectory(17)
run.page("number_17.html")
hf.plot.save_plots(chain, run, "plots")
""",
}
NEEDED = {"matplotlib": "plot", "pyarrow": "parquet", "mcap_ros2": "ros", "viser": "view"}


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
    wrench = np.array(done.stdout.strip().strip("[]").split(), dtype=float)
    assert wrench == pytest.approx([0, 0, 0, 0, -20.0, 3.0 * 9.81 / 2], abs=1e-9)


def test_make_demo_ends_with_a_page():
    """Its rule simulates, exports the page of that run, and says how to open it, and installs what both need."""
    rules = README.with_name("Makefile").read_text(encoding="utf-8")
    needs, simulated, exported, *said = re.search(r"^demo: (.*\n(?:\t.*\n)+)", rules, re.MULTILINE)[1].splitlines()
    (folder,) = re.findall(r"holdfast simulate .*--out (\S+)", simulated)
    run, page = re.findall(r"holdfast view (\S+) --export (\S+)", exported)[0]
    assert run == folder and all(page in line for line in said) and "webbrowser" in said[-1]
    installs = re.search(rf"^{re.escape(needs)}:.*\n(?:\t.*\n)+", rules, re.MULTILINE)[0]
    assert {"plot", "view"} <= set(re.search(r"\.\[([\w,]+)\]", installs)[1].split(","))


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """Return a folder with two robots, the right one heavier."""
    from tests.simulation.test_run_outputs import CORNERS, stl  # which has the robots of this file

    folder = tmp_path_factory.mktemp("mine")
    for name, heavier in (("left", 1.0), ("right", 1.2)):
        (folder / f"{name}.urdf").write_text(urdf(name, heavier).replace("<inertial>", f"{VISUAL} <inertial>"))
    (folder / "wedge.stl").write_text(stl(CORNERS))
    return folder


@pytest.fixture(scope="module")
def names(place) -> dict[str, Any]:
    """Return every name that the programs leave, one after the other."""
    for needed, extra in NEEDED.items():
        pytest.importorskip(needed, reason=f"needs {needed}: pip install 'holdfast[{extra}]'")
    found: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setenv("MPLBACKEND", "Agg")
        (place / "plots").mkdir()
        for title, program in {"imports": IMPORTS, **PROGRAMS}.items():
            exec(compile(program, title, "exec"), found)
            found |= {f"{title}: run": found.get("run")}
    return found


@pytest.mark.parametrize("title", PROGRAMS)
def test_ten_lines_of_public_names(title):
    """What is taken from `hf` is public, of what comes of it nothing is private, and a line is as long as elsewhere."""
    program = PROGRAMS[title]
    lines = [line for line in program.splitlines() if line.strip()]
    assert len(lines) <= 10 and max(map(len, lines)) <= 120
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_")
            path = ast.unparse(node)
            if re.fullmatch(r"hf\.[\w.]+", path):
                name = path.removeprefix("hf.")
                assert any(name in (one, one.split(".")[0]) or name.startswith(f"{one}.") for one in PUBLIC), path


@pytest.mark.slow
def test_two_robots_go_everywhere(place, names):
    """Tables of every sample, messages, a folder that is read again, and a page on which the meshes are drawn."""
    run, state = names["two URDFs to CSV, Parquet, MCAP, a folder and a page with meshes: run"], names["state"]
    assert len(run) == len((place / "run.csv").read_text().splitlines()) - 1 == 3
    assert (place / "run.parquet").read_bytes()[:4] == b"PAR1"
    assert (place / "run.mcap").read_bytes()[1:5] == b"MCAP"
    assert np.array_equal(hf.load_result(place / "run").trajectory.q, run.q)
    assert run.q[0] == pytest.approx(state.q)
    text = (place / "run.html").read_text(encoding="utf-8")
    assert "<title>run</title>" in text and text.rstrip().endswith("</html>")
    for name in ("left", "right"):
        for (piece,) in run.playback().visuals[name][1:]:
            assert np.ptp(piece.mesh.vertices, axis=0) == pytest.approx(0.1) and len(piece.mesh.faces) == 4


@pytest.mark.slow
def test_forces_at_each_hand(names):
    """Each hand has half the weight and all of the internal force; each base has its own arm and half the box."""
    result = hf.forward_dynamics(names["chain"], names["state"], names["tau"])
    for name, side, heavier in (("left", 1, 1.0), ("right", -1, 1.2)):
        assert result[name].grasp_wrench[3:] == pytest.approx([20.0 * side, 0, 3.0 * 9.81 / 2], abs=1e-9)
        arm = heavier * sum(joint[4] for joint in JOINTS)
        assert result[name].base_wrench[5] == pytest.approx((arm + 1.5) * 9.81, rel=1e-10)
    assert np.abs(result.qdd).max() < 1e-9


@pytest.mark.slow
def test_the_sampled_controller(names):
    """Torques change three milliseconds after each sample and at no other time, and none is beyond its bound."""
    run, most = names["a sampled controller that saturates: run"], names["most"]
    changed = run.t[1:][np.abs(np.diff(run.tau, axis=0)).max(axis=1) > 0.0]
    assert set(np.round(changed, 6)) <= {0.003, 0.004, 0.013, 0.014, 0.023, 0.024, 0.033, 0.034}
    assert len(changed) >= 3
    assert (np.abs(run.tau) <= most).all()
    assert (np.abs(run.tau) == most).any(axis=0).sum() >= 2
    assert np.abs(run.imbalance).max() < 1e-6


@pytest.mark.slow
def test_a_thousand_rollouts(place, names):
    """Torques that hold 3 kg let heavier boxes sink and raise lighter ones; the histogram counts them all."""
    masses, risen = names["masses"], names["risen"]
    assert names["record"].systems.running.all()
    assert ((risen < 0) == (masses > 3.0)).all()
    assert names["counts"].sum() == 1000
    assert (place / "risen.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_box_lifted_by_friction(names):
    """Forward dynamics lifts it with 2 N of margin at 80 % of the drives; both are used up at the payload."""
    gripped, still, lift, payload = (names[name] for name in ("gripped", "still", "lift", "payload"))
    most = 0.8 * np.array([joint.effort_limit for joint in gripped.all_joints])
    back = hf.forward_dynamics(gripped, still, lift.tau)
    assert back.object_acceleration == pytest.approx([0, 0, 0, 0, 0, 1.0], abs=1e-10)
    margins = hf.forces.grasp_margins(gripped, still, back.grasp_wrench)
    assert margins.min() == pytest.approx(2.0, abs=1e-6)
    assert (np.abs(lift.tau) <= most * (1 + 1e-9)).all()
    assert payload.value > 1.0 and payload.margin == pytest.approx(2.0, abs=1e-3)
    assert (np.abs(payload.tau) / most).max() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_number_17(place, names):
    """It is a run of its own payload, which forward dynamics confirms; it has a page and figures, and can be kept."""
    run, record = names["run"], names["record"]
    assert np.array_equal(run.q, record["q"][:, 17])
    assert run.require_setting().chain.held_object.mass == names["masses"][17]
    assert "</html>" in (place / "number_17.html").read_text(encoding="utf-8")
    assert {"grasp_wrenches.png", "load_share.png"} <= {path.name for path in (place / "plots").iterdir()}
    again = hf.io.load_record(record.save(place / "many"), names["rollout"]).trajectory(17)
    assert np.array_equal(again.q, run.q)


@pytest.mark.slow
def test_in_a_notebook(place, monkeypatch):
    """The same programs as cells, executed by a kernel: it shows the histogram and the page, and prints nothing."""
    client = pytest.importorskip("nbclient", reason="needs nbclient: pip install nbclient ipykernel")
    import nbformat

    for needed, extra in NEEDED.items():
        pytest.importorskip(needed, reason=f"needs {needed}: pip install 'holdfast[{extra}]'")
    monkeypatch.chdir(place)
    (place / "plots").mkdir(exist_ok=True)
    cells = [IMPORTS, *(program for program in PROGRAMS.values()), "run", "run.show()"]
    cells = [cell.replace('run.save("run")', 'run.save("run", overwrite=True)') for cell in cells]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell.strip()) for cell in cells])
    client.NotebookClient(notebook, timeout=300).execute()
    shown = [output for cell in notebook.cells for output in cell.outputs]
    assert {output.output_type for output in shown} <= {"execute_result", "display_data"}
    assert sum("image/png" in output.data for output in shown) == 1
    *_, summary, page = (output.data.get("text/html", "") for output in shown)
    assert "<table>" in summary and page.startswith("<iframe")
