"""A question that is declared in one file is answered everywhere, and is in the tables over which tests iterate.

Here it is the power of the drives, joint by joint, and that of the object's weight.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from benchmarks.write_stubs import written

import holdfast as hf
from holdfast.codegen.functions import exported_names
from holdfast.questions.arrays import OBJECT, Row
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import QUESTIONS, Question
from holdfast.spatial.vector import cross
from tests.capabilities.chains import chain_with
from tests.capabilities.questions import of_questions
from tests.codegen import problems as exported
from tests.codegen import test_export as test_bits
from tests.compiled import test_functions as compiled
from tests.derivatives import test_compiled_functions as compiled_derivatives
from tests.derivatives import test_functions as derivatives
from tests.derivatives.functions import function_case
from tests.fuzz import chain_calls
from tests.fuzz.calls import CALLS
from tests.fuzz.ended import ended
from tests.questions import every

NAME = "powers"


def _powers(case: VariedCase) -> tuple[Any, ...]:
    state, held = case.state, case.chain.held_object
    v = state.object_twist[3:] + cross(state.object_twist[:3], state.object_frame.R @ held.com)
    return case.own["tau"] * state.qd, held.mass * (case.chain.gravity @ v)


@asked
def powers(chain: hf.ClosedChain, state: hf.State, tau: Any) -> dict[str, Any]:
    """Return tau qd of every joint and m g^T v of the object's mass centre [W]."""
    v = state.object_twist[3:] + np.cross(state.object_twist[:3], state.object_frame.R @ chain.held_object.com)
    return {"of_drives": tau * state.qd, "of_weight": np.array(chain.held_object.mass * (chain.gravity @ v))}


def question() -> Question:
    """Return it."""
    return Question(
        NAME,
        _powers,
        (Row("of_drives", ("n",), "W", "power of the drives"), Row("of_weight", (), "W", "power of the weight")),
        "the power of the drives and of the object's weight",
        inputs=("qd", "tau", "object_pose", "object_twist"),
        parameters=("gravity", *OBJECT),
        arguments=("qd", "tau", "object_pose", "object_twist", "gravity", "object_mass", "object_com"),
        by=("qd", "tau", "object_pose", "object_twist"),
        depends_on=(),
        shown=lambda chain: dict,
    )


@pytest.fixture(autouse=True)
def declared() -> Iterator[None]:
    """Declare it for one test."""
    declare(question(), powers)
    every.FUNCTIONS[NAME] = powers
    try:
        yield
    finally:
        del QUESTIONS[NAME], every.FUNCTIONS[NAME]


def test_the_reference():
    """Answers, products, Jacobians: against differences along everything, and each other."""
    of = function_case(NAME, "floating")
    assert of.by == question().arguments and "Return the Jacobian" in powers.jacobian.__doc__
    assert powers(of.p.chain, of.p.state, of.p.tau)["of_drives"].sum() == pytest.approx(of.p.tau @ of.p.state.qd)
    for law in (
        derivatives.test_functions_return_what_their_questions_compute,
        derivatives.test_a_gradient_along_a_direction_is_a_cotangent_along_the_rates,
        derivatives.test_derivatives_come_with_what_the_function_returns,
        derivatives.test_the_jacobian_holds_the_rates_of_all_directions,
    ):
        law(NAME, "floating")
    derivatives.test_rates_are_five_point_differences(NAME, "floating", True)
    with pytest.raises(hf.errors.StateError, match=rf"{NAME}\.vjp: no 'q'"):
        powers.vjp(of.p.chain, of.p.state, of.p.tau, by=["q"], of_weight=1.0)


def test_machine_code():
    """Bits of interpreter, batches, threads; parameters of calls; refusals."""
    compiled.test_random_systems(NAME, 0)
    compiled.test_run_time_parameters(NAME, "interleaved")
    for law in (
        compiled.test_batch_is_single,
        compiled.test_shared_arguments,
        compiled.test_interpreter,
        compiled.test_refusals,
        compiled.test_invalid_inputs,
    ):
        law(NAME)


def test_derivatives_of_machine_code():
    """Those of the reference, in one call, a batch, on threads and bound."""
    of = function_case(NAME, "floating")
    compiled_derivatives.require_reference(of)
    compiled_derivatives.require_matrix(of, of.by)
    compiled_derivatives.test_bits(NAME, "plain")
    for kind in ("vjp", "jvp", "jacobian"):
        compiled_derivatives.test_interpreter(NAME, "plain", kind)
        compiled_derivatives.test_bound_calls(NAME, kind)


def test_exported_code(tmp_path):
    """The program in C has the library's bits."""
    assert {NAME, f"{NAME}_vjp", f"{NAME}_jvp", f"{NAME}_jacobian"} <= {*exported_names()}
    if not test_bits.HERE:
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    chain, state = exported.chain_and_state("one holds")
    known = exported.answer(NAME, hf.compile(chain), state, 20)
    test_bits.check_all([known], test_bits.HERE[-1], True, ["gcc"], tmp_path)


def test_jax():
    """Its numbers, and gradients by calls of its `vjp`."""
    jax = pytest.importorskip("jax", reason="needs JAX: pip install 'holdfast[jax]'")
    of = function_case(NAME, "plain")
    fast, given = compiled_derivatives.alone(of.p.chain), compiled_derivatives.inputs_of(of)
    with jax.enable_x64(True):
        f = hf.interop.to_jax(fast.powers)
        found, slope = f(*given), jax.grad(lambda *x: f(*x)["of_weight"], argnums=3)(*given)
        assert every.flat(fast.powers(*given)).keys() == found.keys()
        for name, x in fast.powers(*given).items():
            np.testing.assert_array_equal(found[name], x)
        np.testing.assert_array_equal(slope, fast.powers.vjp(*given, of_weight=1.0).object_twist)


def test_tables():
    """The fuzz asks it, and so does the page of what is covered; it is in the stub, the page of questions and help."""
    before = {*CALLS}
    chain_calls.of_question(NAME)
    added = {name: CALLS.pop(name) for name in {*CALLS} - before}
    kinds = {name.partition(" ")[0] for name in added}
    assert kinds == {NAME, *(f"{NAME}.{kind}" for kind in ("vjp", "jvp", "jacobian"))}
    for name, call in added.items():
        assert ended(lambda call=call: call.make(**call.given())) == "answered", name
    assert {*every.FUNCTIONS} == {*every.differentiable()}
    assert all(NAME in text for text in written().values())
    assert "power of the drives" in getattr(compiled_derivatives.alone(chain_with("rigid grasps").chain), NAME).__doc__
    assert len(of_questions(chain_with("rigid grasps"))) == len(every.FUNCTIONS)
