"""Exported code of chains with branches: what it computes apart from Python, bit for bit, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.codegen import export_c
from holdfast.codegen.export import files_of
from holdfast.codegen.functions import FOREST_FUNCTIONS, exported_of_forest
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiler.targets import OBJECT_TARGETS
from holdfast.errors import MethodNotApplicable
from holdfast.questions.arrays import state_fields
from tests.codegen.exported import built, outputs
from tests.compiler.programs import same_bits
from tests.longer import mostly_long
from tests.systems.branched import branched_problems, palletiser


def systems(p, count):
    """Return the arrays of a problem's state under several torques, as a call takes them."""
    rng, found = np.random.default_rng(2), []
    for _ in range(count):
        x = {name: np.array(getattr(p.state, field)) for name, field in state_fields(p.chain).items()}
        found.append(x | {"tau": np.where(p.tau != 0.0, p.tau + rng.standard_normal(p.tau.shape), 0.0)})
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(branched_problems(), ["palletiser"]))
@pytest.mark.parametrize("source", [False, True])
def test_bits(name, source, tmp_path):
    """Forward dynamics and its gradients are those of machine code, from an object file and from source by gcc."""
    p = branched_problems()[name]
    compiled, given = hf.compile(p.chain), systems(p, 3)
    functions = [exported_of_forest(one, compiled, p.state, of=["qdd"]) for one in FOREST_FUNCTIONS[:2]]
    target = OBJECT_TARGETS["x86-64-v3"]
    made = files_of("part", functions, target, source=source)
    for file, content in made.files.items():
        (tmp_path / file).write_bytes(content)
    program = built(tmp_path, "part", made.functions, "gcc", target.name, target.flags)
    weights = np.random.default_rng(3).standard_normal(p.chain.joint_count)
    along = {f"{WITH}qdd": weights}
    found = outputs(program, functions, {functions[0].name: given, functions[1].name: [x | along for x in given]})
    for x, plain, derived in zip(given, *found.values(), strict=True):
        wanted = compiled.forward_dynamics(**x)
        for array, shape in wanted.layout.shapes.items():
            if 0 in shape:  # which C does not have
                continue
            assert same_bits(np.asarray(wanted.array(array)).ravel(), plain[array].ravel()), array
        assert plain["returned"][0] == wanted.array("status")
        gradient = compiled.forward_dynamics_vjp(**x, qdd=weights)
        for by in ("q", "qd", "tau"):
            assert same_bits(np.asarray(gradient[by]).ravel(), derived[f"found.{by}"].ravel()), by


def test_refusals(tmp_path):
    """What has no machine code is refused by name; by default forward dynamics is written."""
    chain = palletiser()[0]
    made = export_c(chain, tmp_path / "code", name="arm")
    assert [*made.functions] == ["arm_forward_dynamics"]
    assert "1 arms" in (made.folder / "arm.h").read_text()
    for functions in (["inverse_dynamics"], ["step"], ["closure_vjp"]):
        with pytest.raises(MethodNotApplicable, match=f"'{functions[0]}': expected forward_dynamics"):
            export_c(chain, tmp_path / "other", functions=functions)
    with pytest.raises(MethodNotApplicable, match="laws: expected its default"):
        hf.compile(chain).export(tmp_path / "other", laws={"hold": hf.ControlLaw(lambda t, s, m, given: (s.q, m))})
