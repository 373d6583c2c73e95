"""A rectangular sole in chains of serial arms: distribution, machine code and checkpoints."""

import json
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.forces import ForceLimits, distribute, grasp_margins, largest_margin
from holdfast.model.fingerprint import fingerprint
from holdfast.simulation.checkpoint import Checkpoint
from tests.control.two_pandas import two_pandas

A, B, MU = 0.06, 0.03, 0.7
SOLE = hf.Friction(MU, half_lengths=(A, B))


def on_soles(contact: hf.Friction = SOLE):
    """Return two Pandas whose palms press a box as soles."""
    chain, state = two_pandas("sole", "sole")
    return replace(chain, grasps={name: replace(x, contact=contact) for name, x in chain.grasps.items()}), state


def in_contact_axes(chain, state, wrenches):
    """Return the wrenches in axes of the contact frames."""
    frames = [state.object_frame.R @ grasp.frame.R for grasp in chain.grasps.values()]
    return [np.append(R.T @ f[:3], R.T @ f[3:]) for R, f in zip(frames, wrenches, strict=True)]


def test_moves_as_a_rigid_grasp():
    """Its accelerations and wrenches are those of a rigid grasp; friction does not change the motion."""
    (chain, state), (rigid, _) = on_soles(), two_pandas("rigid", "rigid")
    tau = np.random.default_rng(0).normal(size=14)
    one, other = hf.forward_dynamics(chain, state, tau), hf.forward_dynamics(rigid, state, tau)
    np.testing.assert_array_equal(one.qdd, other.qdd)
    np.testing.assert_array_equal(one.grasp_wrench, other.grasp_wrench)


def test_distribution_keeps_the_edges():
    """A box that turns quickly about the line between its palms' centres would tip; the palms press harder instead."""
    chain, state = on_soles()
    turn = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 1.0])
    found = distribute(chain, state, turn, limits=ForceLimits(least_margin=3.0))
    assert found.status == "optimal"
    for m_x, m_y, _, f_x, f_y, f_n in in_contact_axes(chain, state, found.grasp_wrench):
        assert abs(m_x) <= B * (f_n - 3.0) + 1e-5
        assert abs(m_y) <= A * (f_n - 3.0) + 1e-5
        assert np.hypot(f_x, f_y) <= MU * f_n - 3.0 + 1e-5
    assert max(found.prices, key=found.prices.get).endswith("edge")


@pytest.mark.slow
def test_largest_margin_and_machine_code():
    """Machine code has the same margins and the same distribution; no pressure is better than the largest margin."""
    chain, state = on_soles()
    fast, still = hf.compile(chain), (state.q, state.qd, state.object_pose, state.object_twist)
    turn = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 1.0])
    found = distribute(chain, state, turn)
    quick = fast.distribute(*still, turn)
    np.testing.assert_allclose(quick.tau, found.tau, atol=1e-5)
    for name in ("left edge", "right edge"):
        assert quick.prices(chain)[name] == pytest.approx(found.prices[name], rel=1e-4)
    margins = grasp_margins(chain, state, quick.grasp_wrench)
    np.testing.assert_allclose(fast.grasp_margins(state.object_pose, quick.grasp_wrench), margins, rtol=1e-13)
    result = hf.forward_dynamics(chain, state, found.tau)
    best = largest_margin(chain, state, result, effort_limits=True)
    assert best.margin > found.margin
    J = grasp_margins.jacobian(chain, state, quick.grasp_wrench, by=["grasp_wrench"])
    step = 1e-6 * np.random.default_rng(1).normal(size=(2, 6))
    up, down = (grasp_margins(chain, state, quick.grasp_wrench + x) for x in (step, -step))
    slope = np.tensordot(J["grasp_margins", "grasp_wrench"], step, 2)
    np.testing.assert_allclose((up - down) / 2, slope, atol=1e-12)


@pytest.mark.slow
def test_a_checkpoint_keeps_it():
    """Through a file: the same chain, which another sole is not."""
    chain, state = on_soles()
    law, found = hf.control.GravityCompensation(chain, internal_force=40.0), []
    run = hf.simulate(chain, state, law, 0.004, 0.002, on_slip="record", on_checkpoint=found.append)
    assert run.t[-1] == 0.004
    arrays, data = found[0].to_data()
    again = Checkpoint.from_data(arrays, json.loads(json.dumps(data)))
    assert [one.contact for one in again.grasps.values()] == [SOLE, SOLE]
    shorter, _ = on_soles(replace(SOLE, half_lengths=(A, 0.5 * B)))
    assert fingerprint(chain) != fingerprint(shorter)
