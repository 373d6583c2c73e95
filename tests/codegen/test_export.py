"""The call and the command: what they write, and what they refuse by name."""

import json
import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli import main as command
from holdfast.cli.commands import run
from holdfast.codegen import export_c
from holdfast.codegen.export import files_of
from holdfast.codegen.functions import exported_function, exported_names
from holdfast.codegen.header import CFunction, fields_of, header, meaning
from holdfast.compiler.targets import OBJECT_TARGETS, cpu
from holdfast.control import compile_law
from holdfast.spatial.scalar import cos, sin
from tests.codegen.exported import APART, STRICT, built, outputs, require
from tests.codegen.problems import NAMES, chain_and_state, steps, truths
from tests.compiler.programs import same_bits
from tests.longer import mostly_long

ROOT = Path(__file__).parents[2]


def test_files(tmp_path):
    """A folder with code, two headers, and what build systems ask for; sizes are those of the header."""
    chain, _ = chain_and_state("one")
    made = hf.compile(chain).export(tmp_path / "code", name="one", functions=["kinetic_energy"])
    assert sorted(made.files) == sorted(path.name for path in made.folder.iterdir())
    assert set(made.files) == {"one.o", "one.h", "one.hpp", "one.pc", "oneConfig.cmake", "CMakeLists.txt"}
    size = made.functions["one_kinetic_energy"]
    header = (made.folder / "one.h").read_text()
    assert f"#define ONE_KINETIC_ENERGY_WORKSPACE {size.workspace // 8} " in header
    assert f"#define ONE_KINETIC_ENERGY_STACK {size.stack} " in header
    with pytest.raises(hf.errors.ResultError, match="is in use"):
        export_c(chain, tmp_path / "code", functions=["kinetic_energy"])
    source = export_c(chain, tmp_path / "code", functions=["kinetic_energy"], source=True, overwrite=True)
    assert "chain.c" in source.files
    assert source.functions["chain_kinetic_energy"].stack is None


def test_names_in_the_first_comment():
    """No arm's name ends the comment, or continues a line of it."""
    text = header("one", [], {"Joints": "*/ int left; /* 0..6; a\nb 7..13; */"})
    comment, _, rest = text.partition("*/")
    assert "int left" in comment and "a\\nb" in comment
    assert rest.startswith("\n#ifndef HOLDFAST_ONE_H") and "/*" not in comment[2:]


@pytest.mark.slow
def test_headers_compile_strictly(tmp_path):
    """As C11 and as C++17, every warning an error; a law's parameter may be called like a word of C."""
    require("gcc", "g++")
    chain, state = chain_and_state("one")
    law = hf.ControlLaw(lambda t, s, m, given: (given["double"] * s.q, m), parameters={"double": ()})
    functions = ["kinetic_energy", "step"]
    export_c(chain, tmp_path, functions=functions, laws={"hold": law}, state=state, overwrite=True)
    (tmp_path / "a.c").write_text('#include "chain.h"\n')
    (tmp_path / "a.cpp").write_text(
        '#include "chain.hpp"\nvoid f() { static chain::Hold hold; hold.double_()[0] = 1.0; hold(); }\n'
    )
    for compiler, standard, file in (("gcc", "-std=c11", "a.c"), ("g++", "-std=c++17", "a.cpp")):
        arguments = [compiler, standard, *STRICT, "-Wno-unused-function", "-fsyntax-only", file]
        subprocess.run(arguments, cwd=tmp_path, check=True, timeout=60)


@pytest.mark.long
def test_every_array_is_explained():
    """What a header says of each array of each function."""
    for name in ("one holds", "floating"):
        chain, state = chain_and_state(name)
        compiled = hf.compile(chain, parameters=("link_inertia", "link_wrench"))
        for function in exported_names():
            if function == "step" and chain.floats:
                continue
            found = exported_function(function, compiled, state, scheme="imex")
            own = CFunction("x", found, 1, None)
            assert all(meaning(array) for array in found.externals), function
            assert len(set(own.fields.values())) == len(found.externals)


def test_names_in_c():
    """Words of the language, and names that meet, get an underscore."""
    found = fields_of(["last.q", "control.q", "control.int", "found.qdd.q"])
    assert list(found.values()) == ["q", "q_", "int_", "found_qdd_q"]


def refusals():
    """Return what is refused: arguments, error and words of its message."""
    plain = hf.ControlLaw(lambda t, s, m, given: (s.q, m))
    return [
        ({"name": "Pandas"}, hf.errors.ModelError, "name: expected lower-case"),
        ({"name": 3}, hf.errors.ModelError, "name"),
        ({"target": "riscv"}, hf.errors.ModelError, "target: expected one of x86-64-v2"),
        ({"target": ["aarch64"]}, hf.errors.ModelError, "target"),
        ({"state": np.zeros(7)}, hf.errors.ModelError, "state"),
        ({"functions": ["step"], "scheme": None}, hf.errors.ModelError, "scheme"),
        ({"functions": ["forward"]}, hf.errors.ModelError, "did you mean|Available"),
        ({"functions": "forward_dynamics"}, hf.errors.ModelError, "functions"),
        ({"functions": []}, hf.errors.ModelError, "expected functions or laws, got none"),
        ({"functions": ["step"]}, hf.errors.ModelError, "state"),
        ({"laws": {"Law": plain}}, hf.errors.ModelError, "laws"),
        ({"laws": {"step": plain}}, hf.errors.ModelError, "laws"),
        ({"laws": {"hold": lambda t, s, m: (s.q, m)}}, hf.errors.MethodNotApplicable, "traced"),
        ({"laws": 3}, hf.errors.ModelError, "laws"),
        ({"functions": ["forward_dynamics_vjp"], "of": ["qqd"]}, hf.errors.StateError, "qqd"),
        ({"functions": ["forward_dynamics_jacobian"], "by": []}, hf.errors.StateError, "expected some"),
    ]


@pytest.mark.parametrize("case", range(len(refusals())))
def test_refusals(case, tmp_path):
    """Nothing is written of what is refused, and the message says what was expected."""
    chain, _ = chain_and_state("one")
    options, error, words = refusals()[case]
    with pytest.raises(error, match=f"(?i){words}"):
        export_c(chain, tmp_path / "code", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_refused_chains_and_states(tmp_path):
    """No step from open grasps, no scheme that estimates errors."""
    chain, state = chain_and_state("one holds")
    apart = hf.State(state.q + 1.0, state.qd, state.object_pose, state.object_twist)
    with pytest.raises(hf.errors.StateError, match="from which steps can begin"):
        export_c(chain, tmp_path / "a", functions=["step"], state=apart)
    with pytest.raises(hf.errors.ModelError, match="scheme"):
        export_c(chain, tmp_path / "a", functions=["step"], state=state, scheme="dopri5")
    with pytest.raises(hf.errors.ModelError, match="chain"):
        export_c(3, tmp_path / "a")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_the_old_export(tmp_path, monkeypatch):
    """An export that cannot be written leaves what was there."""
    chain, _ = chain_and_state("one")
    export_c(chain, tmp_path / "code", functions=["kinetic_energy"])
    before = (tmp_path / "code" / "chain.o").read_bytes()

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(hf.errors.ResultError, match="No space left"):
        export_c(chain, tmp_path / "code", functions=["potential_energy"], overwrite=True)
    assert (tmp_path / "code" / "chain.o").read_bytes() == before


def test_command(tmp_path, capsys):
    """JSON of what was written; a function that is none is refused with the exit code of bad input."""
    options = ["--function", "control", "--function", "kinetic_energy", "--json"]
    assert command(["export-c", str(SCENE), "--out", str(tmp_path / "code"), *options]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report["functions"]) == {"two_pandas_control", "two_pandas_kinetic_energy"}
    assert all(size["workspace"] > 0 for size in report["functions"].values())
    assert command(["export-c", str(SCENE), "--out", str(tmp_path / "b"), "--function", "dynamic"]) != 0
    assert "no 'dynamic'" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


@pytest.mark.long
def test_command_of_what_floats(tmp_path, capsys):
    """Inverse dynamics takes the base's acceleration; what cannot be exported is left out with a note."""
    scene = str(ROOT / "examples" / "free_flyer.toml")
    assert command(["export-c", scene, "--out", str(tmp_path / "code"), "--name", "flyer"]) == 0
    err = capsys.readouterr().err
    assert "note: without control: compile_law" in err and "inverse_dynamics" not in err
    header = (tmp_path / "code" / "flyer.h").read_text()
    assert "int64_t flyer_step(" in header and "int64_t flyer_inverse_dynamics(" in header
    assert "floating_acceleration" in header and "largest_wrench" in header


def test_memory_begins_at_the_state(tmp_path):
    """What `begin` fills memory with: the state given, the chain's parameters, its generic rank."""
    chain, state = chain_and_state("one holds")
    found = exported_function("forward_dynamics", hf.compile(chain), state)
    assert np.array_equal(found.values["q"], state.q)
    assert np.array_equal(found.values["gravity"], chain.gravity)
    assert found.values["generic_rank"] == chain.constraint_row_count


HERE = [name for name, needs in cpu.X86_LEVELS.items() if "fma" in needs and cpu.features().issuperset(needs)]
COMPILERS = {"aarch64": ["aarch64-linux-gnu-gcc"]}


def check(name, target, source, compilers, folder, count, derivatives=True, with_step=True):
    """Library = exported, for every function, system and array."""
    known = [truth for truth in truths(name, count, derivatives) if with_step or truth.function.name != "step"]
    check_all(known, target, source, compilers, folder)


def check_all(known, target, source, compilers, folder):
    """The same for functions whose answers are known."""
    require(*APART.get(target, []), *compilers)
    exported = files_of("part", [truth.function for truth in known], OBJECT_TARGETS[target], source)
    folder.mkdir(exist_ok=True)
    for file, content in exported.files.items():
        (folder / file).write_bytes(content)
    for compiler in compilers:
        flags = OBJECT_TARGETS[target].flags
        program = built(folder, "part", exported.functions, compiler, target, flags)
        given = {truth.function.name: truth.given for truth in known}
        found = outputs(program, [truth.function for truth in known], given, APART.get(target, ()))
        for truth in known:
            of_function = found[truth.function.name]
            for k, (got, expected) in enumerate(zip(of_function, truth.expected, strict=True)):
                for array, x in expected.items():
                    assert same_bits(got[array].ravel(), np.asarray(x, dtype=got[array].dtype).ravel()), (
                        truth.function.name,
                        k,
                        array,
                    )


@pytest.mark.slow
@pytest.mark.parametrize("source", mostly_long((False, True), (True,)))
def test_one_chain(source, tmp_path):
    """Object file and source of two arms, one of which holds."""
    if not HERE:
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    check("one holds", HERE[-1], source, ["gcc"], tmp_path, 20, derivatives=False, with_step=not source)


@pytest.mark.slow
def test_a_step_on_moving_bases(tmp_path):
    """The base's motion is part of the code: as the rollout steps that has it, whose base has moved by then."""
    if not HERE:
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    chain, state = chain_and_state("one holds")
    name = next(iter(chain.arms))
    base, along = chain.arms[name].base, np.array([0.0, 0.05, 0.02])

    def heave(t):
        still = np.zeros(3)
        twist, acceleration = (np.concatenate([still, x * along]) for x in (5.0 * sin(5.0 * t), 25.0 * cos(5.0 * t)))
        return hf.Pose(base.R, base.p + (1.0 - cos(5.0 * t)) * along), twist, acceleration

    found = steps(hf.compile(chain), state, 20, {name: heave})
    assert not same_bits(found.expected[-1]["last.q"], steps(hf.compile(chain), state, 20).expected[-1]["last.q"])
    check_all([found], HERE[-1], False, ["gcc"], tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("source", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_ten_chains(name, source, tmp_path):
    """1,000 systems of every chain, for every processor, by both compilers."""
    for target in (*HERE, "aarch64"):
        compilers = COMPILERS.get(target, ["gcc", "clang"] if source else ["gcc"])
        check(name, target, source, compilers, tmp_path / target, 1000, derivatives=name == "two of seven")


pytestmark = pytest.mark.slow

EXAMPLE, SCENE = ROOT / "examples" / "robot_code", ROOT / "examples" / "two_pandas.toml"
SAMPLE = 1e-3


@pytest.fixture(scope="module")
def code(tmp_path_factory):
    """The folder that the example's command writes."""
    return exported_as_told(EXAMPLE, tmp_path_factory.mktemp("robot") / "code")


def exported_as_told(example: Path, folder: Path) -> Path:
    """Run the command at the top of an example's CMake file, and return the folder that it writes."""
    text = (example / "CMakeLists.txt").read_text()
    command = re.search(r"holdfast (export-c .*?)\n#\n", text, re.DOTALL)[1].replace("\\\n#", "").split()
    command[1] = str(example / command[1])
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


@pytest.mark.long
def test_lift(tmp_path):
    """A second of forces within limits at 1 kHz: the box where Python's distribution brings it, to the bit, in time."""
    require("cmake", "gcc", "g++")
    example = EXAMPLE / "lift"
    build(example, tmp_path / "build", CODE=exported_as_told(example, tmp_path / "code"))
    out = subprocess.run([tmp_path / "build" / "lift"], check=True, capture_output=True, text=True, timeout=60).stdout
    assert [float.fromhex(x) for x in re.search(r"exactly:(.*)", out)[1].split()] == lifted_by_python().tolist()
    height, violation = re.search(r"at ([\d.]+) m, limits passed by at most (\S+) N", out).groups()
    assert float(height) == pytest.approx(0.82, abs=1e-4) and float(violation) < 1e-9
    medians = re.findall(r"median ([\d.]+) us, at most [\d.]+ us", out)
    assert len(medians) == 2 and max(map(float, medians)) < 500.0


def lifted_by_python() -> np.ndarray:
    """Return the box's pose after the same second."""
    scene = hf.load_scene(EXAMPLE.parent / "box_lift.toml")
    fast, rollout, s = hf.compile(scene.chain), hf.compile_rollout(scene.chain), scene.state
    systems = rollout.start(s.q, s.qd, s.object_pose, s.object_twist, tau=np.zeros(14))
    resting, start = systems.q[0].copy(), systems.object_pose[0, 4:].copy()
    usual = {"effort_share": 0.8, "demanded_margin": np.full(2, 2.0)}
    for k in range(1000):
        q, qd, pose, twist = (x[0] for x in (systems.q, systems.qd, systems.object_pose, systems.object_twist))
        x = min(k * SAMPLE / 0.8, 1.0)
        rest = 1.0 - x
        s_, rate = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x), 30.0 * x * x * rest * rest / 0.8
        second = 60.0 * x * rest * (1.0 - 2.0 * x) / 0.8 / 0.8
        up = np.array([0.0, 0.0, 0.2])
        shift = up * second + 20.0 * (up * rate - twist[3:]) + 100.0 * (start + up * s_ - pose[4:])
        wanted, wished = np.r_[-20.0 * twist[:3], shift], -10.0 * qd + 25.0 * (resting - q)
        found = fast.distribute(q, qd, pose, twist, wanted, wished_qdd=wished, **usual)
        rollout.step(systems, SAMPLE, tau=found.tau[None])
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
