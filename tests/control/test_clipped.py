"""Torques clipped to effort limits: in runs, machine code and rollouts alike."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import GravityCompensation, clipped
from holdfast.simulation.stepper import ReferenceStepper
from tests.simulation.gantries import squeezed

ASKED = np.array([0.0, 0.0, 60.0, 0.0, 0.0, 20.0])


def limited():
    """Return a gantry whose drives push with 33 N at most."""
    return squeezed((None, None), effort_limit=33.0)


def lift(t, state, memory):
    """Push one slide with more than it can, the other with what comes to more later."""
    return ASKED * (1.0 + 20.0 * t), memory


@pytest.mark.slow
def test_as_if_asked_for_less():
    """A run under clipped torques is one under the torques that the drives give; the margin says where."""
    chain, state = limited()
    run = hf.simulate(chain, state, lift, 0.1, 1e-3, on_limit="clip")
    assert run.stopped is None and not run.occurrences
    assert np.abs(run.tau).max() == 33.0
    given = hf.simulate(chain, state, lambda t, s, m: (np.clip(lift(t, s, m)[0], -33.0, 33.0), m), 0.1, 1e-3)
    assert np.array_equal(run.q, given.q) or np.allclose(run.q, given.q, atol=1e-13)
    assert run.lowest_joint_margin[:, 2].min() == 0.0
    asked = hf.simulate(chain, state, lift, 0.1, 1e-3)
    assert any(one.quantity == "effort" for one in asked.occurrences)
    assert np.abs(asked.q[-1] - run.q[-1]).max() > 1e-3


@pytest.mark.slow
def test_laws_and_rollouts():
    """A law is clipped in machine code; a rollout takes it as any other."""
    chain, state = limited()
    law = hf.ControlLaw(lambda t, s, memory, given: (ASKED * (1.0 + 20.0 * t), memory))
    options = {"duration": 0.05, "step": 1e-3, "on_limit": "clip"}
    run = hf.simulate(chain, state, law, **options)
    reference = hf.simulate(chain, state, law, make_stepper=ReferenceStepper, **options)
    assert run.q == pytest.approx(reference.q, abs=1e-13)
    rollout = hf.compile_rollout(chain, clipped(law, chain))
    systems = rollout.start(state.q, state.qd, state.object_pose, state.object_twist)
    rollout.step(systems, 1e-3, steps=50)
    assert systems.q[0] == pytest.approx(run.q[-1], abs=1e-12)
    assert systems.tau[0, 2] == 33.0


def test_controllers_that_follow_the_grasps():
    """What a controller says of itself goes through: traceable, breakpoints, another chain."""
    chain, _ = squeezed(("ball", "ball"), effort_limit=33.0)
    kept = clipped(GravityCompensation(chain, internal_force=5.0), chain)
    other = replace(chain, grasps={"left": chain.grasps["left"]})
    assert kept.traceable and kept.breakpoints == ()
    assert kept.for_chain(other).controller.chain is other
    assert clipped(lift, chain).for_chain(other).controller is lift


def test_shapes_are_still_looked_at():
    """Torques of another length are refused by name."""
    chain, state = limited()
    with pytest.raises(hf.StateError, match="controller: torques"):
        hf.simulate(chain, state, lambda t, s, m: (np.zeros(3), m), 0.1, 1e-3, on_limit="clip")
