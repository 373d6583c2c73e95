"""Runs of chains with branches under laws in machine code are those under the same laws in Python."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelError
from holdfast.simulation.rollout import mechanism_steppers
from holdfast.simulation.rollout.mechanism_steppers import FusedMechanismStepper, MechanismSteppers
from tests.longer import mostly_long
from tests.simulation.test_mechanism_limits import held_box, pendulum
from tests.systems.branched import branched_problems, palletiser, swinging

STEP, STEPS = 1e-3, 60


@pytest.fixture(autouse=True)
def whole_steps(monkeypatch):
    """Let runs of any length have code of whole steps."""
    monkeypatch.setattr(mechanism_steppers, "WHOLE_STEPS_FROM", 1)


SAME = ("t", "q", "qd", "qdd", "tau", "grasp_wrench", "coupling_force", "work", "kinetic", "potential", "object_pose")


def in_python(law):
    """Return a law as a Python function, which no machine code contains."""

    def function(t, state, memory):
        tau, _ = law(t, state, memory) if callable(law) else law.torque(t, state, np.zeros(0), {})
        return np.asarray(tau), memory

    return function


def both(chain, state, law, duration=STEPS * STEP, step=STEP, **options):
    """Return a run under a law, and the same under a Python function."""
    return tuple(hf.simulate(chain, state, one, duration, step, **options) for one in (law, in_python(law)))


def require_alike(found, wanted, names=SAME):
    """Require the samples of two runs to be the same to rounding."""
    assert len(found) == len(wanted)
    for name in names:
        a, b = getattr(found, name), getattr(wanted, name)
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-11 * max(1.0, np.abs(b).max(initial=0.0)), err_msg=name)


@pytest.mark.parametrize("name", mostly_long(branched_problems(), ()))
def test_a_law(name):
    """A spherical joint and a floating base, several objects, forces that are not unique."""
    chain, state, tau = branched_problems()[name]
    require_alike(*both(chain, state, swinging(tau)))


@pytest.mark.slow
def test_a_controller():
    """A controller of the library finds inverse dynamics within the step."""
    chain, state, _ = palletiser()
    found, wanted = both(chain, state, hf.control.GravityCompensation(chain))
    require_alike(found, wanted)
    assert np.abs(found.tau).max() > 10.0


@pytest.mark.parametrize("on_limit", ["record", "stop"])
def test_instants(on_limit):
    """Limits are passed and kept again when they are under the function, in the same words."""
    p = pendulum(position_limits=(-0.1, 1.0), rate_limit=1.0)
    found, wanted = both(p.chain, p.state, swinging(p.tau), 1.4, 4e-3, on_limit=on_limit)
    assert len(found.occurrences) == (6 if on_limit == "record" else 1)
    for a, b in zip(found.occurrences, wanted.occurrences, strict=True):
        assert (a.kind, a.name, a.quantity) == (b.kind, b.name, b.quantity)
        assert a.t == pytest.approx(b.t, abs=1e-9)
    assert (found.stopped is None) == (wanted.stopped is None) == (on_limit == "record")
    lowest = [run.lowest_joint_margin[:, 0].min() for run in (found, wanted)]
    assert lowest[0] == pytest.approx(lowest[1], abs=1e-9)


@pytest.mark.long
def test_a_slip():
    """A law that lets go of a box slips when it does as a serial chain, to a billionth of a second."""
    chain, state, beside, apart = held_box()
    tight, loose = (hf.control.GravityCompensation(chain, force)(0.0, state, None)[0] for force in (40.0, 0.0))
    law = hf.ControlLaw(lambda t, at, memory, given: (tight + 10.0 * t * (loose - tight), memory))
    wanted, found = (hf.simulate(*of, law, 0.06, STEP) for of in ((chain, state), (beside, apart)))
    (slip,), (theirs,) = found.occurrences, wanted.occurrences
    assert (slip.kind, slip.name, slip.text) == (theirs.kind, theirs.name, theirs.text)
    assert slip.t == pytest.approx(theirs.t, abs=1e-9) and 0.01 < slip.t < 0.06
    np.testing.assert_allclose(found.margin[:-1], wanted.margin[:-1], atol=1e-6)


def test_a_run_that_ends():
    """Where machine code finds no step, the reference says why: a parallelogram that becomes flat."""
    chain, _, tau = palletiser()
    lean = np.pi / 2 - 0.02
    state = hf.close(chain, hf.State([0.4, lean, -lean, lean], [0.0, 1.0, -1.0, 1.0]))
    found, wanted = both(chain, state, swinging(0.0 * tau), 0.1)
    assert found.stopped == wanted.stopped
    require_alike(found, wanted, ("t", "q"))


def test_a_torque_of_a_passive_joint():
    """It is refused by name, whenever it comes."""
    chain, state, tau = palletiser()
    late = hf.ControlLaw(lambda t, now, memory, given: (tau + (t > 0.0305) * np.array([0, 0, 1.0, 0]), memory))
    found, wanted = both(chain, state, late)
    assert "'robot/wrist' is passive" in found.stopped and found.stopped == wanted.stopped


def test_going_on():
    """A run that goes on from a checkpoint has the bits of one that was not interrupted."""
    chain, state, tau = palletiser()
    given, kept = (chain, state, swinging(tau), STEPS * STEP, STEP), []
    whole = hf.simulate(*given, on_checkpoint=kept.append)
    rest = hf.simulate(*given, start=kept[22])
    assert rest.t.tolist() == whole.t[23:].tolist()
    for name in whole.recorded:
        assert getattr(rest, name).tobytes() == getattr(whole, name)[23:].tobytes(), name


@pytest.mark.parametrize(
    ("options", "python", "whole"),
    [
        ({}, False, True),
        ({}, True, False),
        ({"sample_time": 2 * STEP}, True, True),
        ({"scheme": "dop853"}, False, False),
        ({"inputs": lambda t: hf.Inputs(np.zeros((0, 6)))}, False, False),
    ],
)
def test_who_takes_steps(options, python, whole, monkeypatch):
    """Machine code takes whole steps of a law and of a sampled function, not with what is called at every stage."""
    chain, state, tau = palletiser()
    kinds, make = [], MechanismSteppers.__call__
    monkeypatch.setattr(MechanismSteppers, "__call__", lambda *of: kinds.append(make(*of)) or kinds[-1])
    law = swinging(tau)
    hf.simulate(chain, state, in_python(law) if python else law, STEPS * STEP, STEP, **options)
    assert isinstance(kinds[-1], FusedMechanismStepper) == whole


def test_a_law_that_is_no_function():
    """A law that reads a counter is refused, as of serial chains."""
    chain, state, tau = palletiser()
    calls = []

    def torque(t, now, memory, given):
        calls.append(1)
        return tau * len(calls), memory

    with pytest.raises(ModelError, match="expected a function of its arguments alone"):
        hf.simulate(chain, state, hf.ControlLaw(torque), STEPS * STEP, STEP)
