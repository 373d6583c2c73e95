"""Exported code of chains with branches: what it computes apart from Python, bit for bit, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.codegen import export_c
from holdfast.codegen.export import files_of
from holdfast.codegen.functions import exported_of_forest
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


def wanted_motion(compiled, x):
    """Return the arrays of a call of inverse dynamics: the motion under given torques."""
    found, state = compiled.forward_dynamics(**x), {name: value for name, value in x.items() if name != "tau"}
    names = ("qdd", "object_acceleration", "floating_acceleration")
    return state | {name: np.array(found.array(name)) for name in names if name in found.layout.shapes}


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(branched_problems(), ["palletiser"]))
@pytest.mark.parametrize("source", [False, True])
def test_bits(name, source, tmp_path):
    """Forward dynamics and its gradients are those of machine code, from an object file and from source by gcc."""
    p = branched_problems()[name]
    compiled, given = hf.compile(p.chain), systems(p, 3)
    names = ("forward_dynamics", "forward_dynamics_vjp", "inverse_dynamics")
    functions = [exported_of_forest(one, compiled, p.state, of=["qdd"]) for one in names]
    target = OBJECT_TARGETS["x86-64-v3"]
    made = files_of("part", functions, target, source=source)
    for file, content in made.files.items():
        (tmp_path / file).write_bytes(content)
    program = built(tmp_path, "part", made.functions, "gcc", target.name, target.flags)
    weights = np.random.default_rng(3).standard_normal(p.chain.joint_count)
    along = {f"{WITH}qdd": weights}
    wished = [wanted_motion(compiled, x) for x in given]
    found = outputs(program, functions, dict(zip(names, (given, [x | along for x in given], wished), strict=True)))
    for x, y, plain, derived, back in zip(given, wished, *found.values(), strict=True):
        for wanted, ours in ((compiled.forward_dynamics(**x), plain), (compiled.inverse_dynamics(**y), back)):
            for array, shape in wanted.layout.shapes.items():
                if 0 in shape:  # which C does not have
                    continue
                assert same_bits(np.asarray(wanted.array(array)).ravel(), ours[array].ravel()), array
            assert ours["returned"][0] == wanted.array("status")
        gradient = compiled.forward_dynamics_vjp(**x, qdd=weights)
        for by in ("q", "qd", "tau"):
            assert same_bits(np.asarray(gradient[by]).ravel(), derived[f"found.{by}"].ravel()), by


def test_refusals(tmp_path):
    """What has no machine code is refused by name; by default forward and inverse dynamics are written."""
    chain = palletiser()[0]
    made = export_c(chain, tmp_path / "code", name="arm")
    assert [*made.functions] == ["arm_forward_dynamics", "arm_inverse_dynamics"]
    header = (made.folder / "arm.h").read_text()
    assert "1 arms" in header and "ARM_INVERSE_DYNAMICS_INVALID" in header
    assert "ARM_INVERSE_DYNAMICS_SINGULAR" not in header
    for functions in (["mass_matrix"], ["step"], ["closure_vjp"]):
        with pytest.raises(MethodNotApplicable, match=f"'{functions[0]}': expected forward_dynamics"):
            export_c(chain, tmp_path / "other", functions=functions)
    with pytest.raises(MethodNotApplicable, match="laws: expected its default"):
        hf.compile(chain).export(tmp_path / "other", laws={"hold": hf.ControlLaw(lambda t, s, m, given: (s.q, m))})
