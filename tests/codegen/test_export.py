"""The call and the command: what they write, and what they refuse by name."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli import main as command
from holdfast.codegen import export_c
from holdfast.codegen.functions import exported_function, exported_names
from holdfast.codegen.header import CFunction, fields_of, header, meaning
from tests.codegen.exported import STRICT, require
from tests.codegen.problems import chain_and_state

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "examples" / "two_pandas.toml")


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
    with pytest.raises(hf.ResultError, match="is in use"):
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
        ({"name": "Pandas"}, hf.ModelError, "name: expected lower-case"),
        ({"name": 3}, hf.ModelError, "name"),
        ({"target": "riscv"}, hf.ModelError, "target: expected one of x86-64-v2"),
        ({"target": ["aarch64"]}, hf.ModelError, "target"),
        ({"state": np.zeros(7)}, hf.ModelError, "state"),
        ({"functions": ["step"], "scheme": None}, hf.ModelError, "scheme"),
        ({"functions": ["forward"]}, hf.ModelError, "did you mean|Available"),
        ({"functions": "forward_dynamics"}, hf.ModelError, "functions"),
        ({"functions": []}, hf.ModelError, "expected functions or laws, got none"),
        ({"functions": ["step"]}, hf.ModelError, "state"),
        ({"laws": {"Law": plain}}, hf.ModelError, "laws"),
        ({"laws": {"step": plain}}, hf.ModelError, "laws"),
        ({"laws": {"hold": lambda t, s, m: (s.q, m)}}, hf.MethodNotApplicable, "traced"),
        ({"laws": 3}, hf.ModelError, "laws"),
        ({"functions": ["forward_dynamics_vjp"], "of": ["qqd"]}, hf.StateError, "qqd"),
        ({"functions": ["forward_dynamics_jacobian"], "by": []}, hf.StateError, "expected some"),
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
    with pytest.raises(hf.StateError, match="from which steps can begin"):
        export_c(chain, tmp_path / "a", functions=["step"], state=apart)
    with pytest.raises(hf.ModelError, match="scheme"):
        export_c(chain, tmp_path / "a", functions=["step"], state=state, scheme="dopri5")
    with pytest.raises(hf.ModelError, match="chain"):
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
    with pytest.raises(hf.ResultError, match="No space left"):
        export_c(chain, tmp_path / "code", functions=["potential_energy"], overwrite=True)
    assert (tmp_path / "code" / "chain.o").read_bytes() == before


def test_command(tmp_path, capsys):
    """JSON of what was written; a function that is none is refused with the exit code of bad input."""
    options = ["--function", "control", "--function", "kinetic_energy", "--json"]
    assert command(["export-c", SCENE, "--out", str(tmp_path / "code"), *options]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report["functions"]) == {"two_pandas_control", "two_pandas_kinetic_energy"}
    assert all(size["workspace"] > 0 for size in report["functions"].values())
    assert command(["export-c", SCENE, "--out", str(tmp_path / "b"), "--function", "dynamic"]) != 0
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
