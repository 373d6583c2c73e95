"""Whatever a public call is given: an answer, or an error of ours on one line; no warning, no NaN, no file begun."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast import control, dynamics, forces, load_urdf_trunk
from holdfast.errors import ModelError, SceneError, StateError
from holdfast.identification import base_parameters
from tests.fuzz.calls import CALLS, everything, fixed, rigid
from tests.fuzz.ended import ended
from tests.fuzz.fuzzed import QUICK, every_call, fuzzed
from tests.fuzz.odd import Failing
from tests.robots.test_urdf_trunk import HEAVY_BASE

CASES, PARTS = 3000, 6


@pytest.mark.parametrize("part", range(4))
def test_some_wrong_calls(part):
    """A few hundred of what needs no machine code."""
    ends, faults = fuzzed(range(part, 240, 4), QUICK)
    assert not faults, "\n".join(faults)
    assert ends["answered"] and ends["StateError"] and ends["ModelError"]


@pytest.mark.long
def test_sound_calls_are_answered():
    """As they are in the table, so that what is spoilt is what is refused."""
    for name in every_call():
        assert ended(lambda one=CALLS[name]: one.make(**one.given())) == "answered", name


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_3000_wrong_calls(part):
    """Of all there are, in parts that can go side by side."""
    ends, faults = fuzzed(range(part, CASES, PARTS), every_call())
    print(dict(ends))
    assert not faults, "\n".join(faults)


P, WHOLE = fixed(), everything()
CHAIN, STATE, TAU = P.chain, P.state, P.tau
ARM = CHAIN.arms["arm1"]
START = [1, 0, 0, 0, 0, 0, 0]
HUGE = hf.Inputs(base_twists=np.full((2, 6), 1e200))
WHIRLED = hf.Inputs(base_twists=np.full((2, 6), 1e308))

FOUND = {
    "a path for ever": (
        lambda: control.PoseSpline.at_speed([START, [1, 0, 0, 0, 1, 0, 0]], 5e-324, 1.0),
        ModelError,
        "path",
    ),
    "a length whose inverse overflows": (
        lambda: forces.split(CHAIN, STATE, np.ones((2, 6)), length=1e-320),
        StateError,
        "split: expected finite numbers",
    ),
    "a base carried far away": (
        lambda: hf.simulation.CarriedBase(
            control.RestToRest(START, [1, 0, 0], turn=[0, 0, 1], duration=1.0), [1, 0, 0, 0, 1e308, 0.2, 0.3]
        )(0.4),
        StateError,
        "carried base: expected finite numbers",
    ),
    "no chain": (lambda: dynamics.kinetic_energy(3, STATE), ModelError, "chain: expected ClosedChain, got int"),
    "no state": (lambda: forces.split(CHAIN, {}, np.zeros((2, 6))), StateError, "state: expected State, got dict"),
    "no inputs": (lambda: dynamics.closure(CHAIN, STATE, 1.0), StateError, "inputs: expected Inputs, got float"),
    "no chain of a step": (
        lambda: hf.linearise(1e-9, STATE, TAU, step=1e-3),
        ModelError,
        "chain: expected ClosedChain, got float",
    ),
    "no result": (lambda: forces.wrist_wrenches(CHAIN, STATE, "x"), StateError, "result: expected ForwardResult"),
    "no arm": (lambda: dynamics.tip_pose(None, []), ModelError, "arm: expected Arm, got NoneType"),
    "no chain to release": (lambda: dynamics.release("x", "y"), ModelError, "chain: expected ClosedChain"),
    "no state of a law": (lambda: control.GravityCompensation(CHAIN)(0.0, 1, None), StateError, "expected State"),
    "no values": (lambda: hf.ControlLaw(lambda *x: x).given(3), StateError, "values: expected Mapping, got int"),
    "names": (
        lambda: hf.forward_dynamics_jacobian(CHAIN, STATE, TAU, of=["qdd", "qdd"], by=["q"], check=False),
        StateError,
        "expected each name once",
    ),
    "a name": (lambda: hf.holding_torques(CHAIN, STATE, passive=[{}]), StateError, "passive: no joint"),
    "names of columns": (lambda: base_parameters(np.eye(2), ["a", np.nan]), ModelError, r"names\[1\]: expected str"),
    "tips": (lambda: load_urdf_trunk(HEAVY_BASE, np.array("x")), SceneError, "tips: expected links by arm"),
    "a joint twice": (
        lambda: dynamics.closure.jvp(CHAIN, STATE, along={"q": np.zeros(3)}),
        StateError,
        "expected shape",
    ),
    "a flag": (lambda: hf.close(CHAIN, STATE, hold_object=[1.0]), StateError, "hold_object: expected True or False"),
    "parameters": (
        lambda: dynamics.contact_attitudes(CHAIN, STATE, "quaternions"),
        StateError,
        "parameters: expected 'quaternion' or 'euler', got 'quaternions'",
    ),
    "no time": (lambda: control.RestToRest(START).at("x"), ModelError, "path: t: expected a number"),
    "a turn": (lambda: control.RestToRest(START, turn=[1e200, 0, 0]), ModelError, "turn: expected at most"),
    "in no time": (
        lambda: control.RestToRest(START, [1, 0, 0], duration=1e-200).at(2e-201),
        StateError,
        "path: .*overflow",
    ),
    "times": (
        lambda: control.TorqueSchedule.linear([0.0, 0.0], np.ones((2, 3))),
        ModelError,
        "schedule: times: expected increasing ones",
    ),
    "columns": (lambda: hf.regressor(CHAIN, STATE, TAU, np.ones(6), inputs=HUGE), StateError, "regressor"),
    "gaps": (lambda: dynamics.closure(CHAIN, STATE, WHIRLED), StateError, "closure: .*overflow"),
    "from joints": (
        lambda: dynamics.state_from_joints(rigid().chain, rigid().state.q, np.full(13, 1e308), check=False),
        StateError,
        "state_from_joints: .*overflow",
    ),
    "derivatives": (
        lambda: hf.forward_dynamics_jvp(CHAIN, STATE, TAU, along={"gravity": [0, 0, 1e308]}, check=False),
        StateError,
        "derivatives: .*overflow",
    ),
    "a share": (
        lambda: forces.split(CHAIN, STATE, np.array([[0, 0, 0, 1e200, 0, 0], [0, 0, 0, 1e200, 0, 0]])),
        StateError,
        "split: .*overflow",
    ),
    "breakpoints": (
        lambda: hf.simulate(CHAIN, STATE, lambda *x: (TAU, None), 0.1, 0.01, breakpoints=3),
        ModelError,
        "breakpoints: expected times, got 3",
    ),
    "where to begin": (
        lambda: hf.assemble(CHAIN.arms, CHAIN.held_object, CHAIN.grasps, q={"arm1": np.full(4, 1e200)}),
        StateError,
        "q of 'arm1': expected at most 100000 rad or m",
    ),
    "twists": (
        lambda: hf.State([], [], [START, START], Failing()),
        StateError,
        "state: object_twist: expected an array of numbers",
    ),
    "a rank": (lambda: hf.compile_rollout(CHAIN, generic_rank=99), StateError, "rollout: generic_rank: expected"),
}  # fmt: skip


def far(state: hf.State) -> hf.State:
    """Return a state whose object and base are beyond what can be squared."""
    place = [1, 0, 0, 0, 1e200, -1e200, 1e200]
    return hf.State(state.q, state.qd, place, state.object_twist, base_pose=place, base_twist=state.base_twist)


@pytest.mark.parametrize("ask", [hf.diagnose, dynamics.object_mobility, hf.assembly.assembly_report])
def test_far_away_without_a_warning(ask):
    """Where levers are infinite an answer need not mean much, but it is one (pytest makes errors of warnings)."""
    assert ask(WHOLE.chain, far(WHOLE.state)) is not None


def test_turning_points_of_large_torques():
    """They are where those of small ones are."""
    found = [control.TorqueSchedule([0.0, 5.0], size * np.array([[[0.0, 1.0, -0.5]] * 2] * 2)) for size in (1.0, 1e308)]
    assert np.array_equal(found[0].breakpoints, found[1].breakpoints)
    assert 1.0 in found[0].breakpoints


def test_large_regressors():
    """Only the proportions of a regressor's numbers matter, also where their squares overflow."""
    found = [base_parameters(np.full((3, 3), size), ["a", "b", "c"]).in_words() for size in (1.0, 1e200)]
    assert found[0] == found[1] == ["a + 1 b + 1 c"]


@pytest.mark.parametrize("what", FOUND)
def test_found(what):
    call, error, message = FOUND[what]
    with pytest.raises(error, match=message) as refused:
        call()
    assert "\n" not in str(refused.value)
