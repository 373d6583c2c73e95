"""Hands as contacts with the mobility of their arms: sticking, they are the grasps of the closed chain."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import Friction, Grasp
from holdfast.dynamics.contact.fixed_modes import ContactModes, touch_at
from holdfast.dynamics.contact.sliding_hands import (
    Hand,
    stacked_acceleration,
    stacked_twist,
    touching_rows,
    with_contact_wrench,
    without_hands,
    wrenches_of_hands,
)
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.state import Inputs

CONTACTS = {
    "rigid": None,
    "ball": Friction(0.5),
    "softfinger": Friction(0.5, torsion_radius=0.02),
    "hinge": Friction(0.5, half_length=0.03),
}


def held_by(kinds, seed=3):
    """Return a box held by Pandas at random postures, moving."""
    rng = np.random.default_rng(seed)
    arms = {f"arm{i}": hf.robots.panda() for i in range(len(kinds))}
    n = sum(arm.joint_count for arm in arms.values())
    chain = hf.ClosedChain(arms, hf.HeldObject.box(2.0, 0.2, 0.3, 0.1), {})
    q, qd = rng.uniform(-1.0, 1.0, n) - 0.5, rng.uniform(-1.0, 1.0, n)
    state = hf.State(q, qd, [1, 0, 0, 0, 0.3, 0.1, 0.4], rng.uniform(-1.0, 1.0, 6))
    for name, kind in zip(arms, kinds, strict=True):
        made = hf.dynamics.attach(chain, state, name, Grasp(kind, hf.Pose.identity(), CONTACTS[kind]), here=True)
        chain, state = made.chain, made.state
    return chain, state, rng.uniform(-10.0, 10.0, n)


@pytest.mark.parametrize("kinds", [("ball", "softfinger", "rigid"), ("hinge", "ball"), ("softfinger", "softfinger")])
def test_sticking_hands_are_grasps(kinds):
    """Taken out of the filter and solved as contacts that stick, hands give the chain's accelerations and forces."""
    chain, state, tau = held_by(kinds)
    known = hf.forward_dynamics(chain, state, tau)
    hands = tuple(Hand(name, grasp) for name, grasp in chain.grasps.items() if grasp.contact is not None)
    open_chain = without_hands(chain, [hand.arm for hand in hands])
    free = hf.forward_dynamics(open_chain, state, tau)
    rows = touching_rows(open_chain, state, hands)
    k, d = rows.C.shape[:2]
    np.testing.assert_allclose(rows.velocity(stacked_twist(open_chain, state, hands)), 0.0, atol=1e-12)
    np.testing.assert_allclose(rows.gap, 0.0, atol=1e-12)
    modes = ContactModes(np.full(k, ContactMode.STICKS), np.zeros((k, d)), hands)
    touch = touch_at(open_chain, state, free, modes)
    wrench = rows.wrench(touch.force)
    found = hf.forward_dynamics(
        open_chain, state, tau, inputs=with_contact_wrench(open_chain, state, Inputs(), hands, wrench)
    )
    size = np.abs(known.qdd).max()
    np.testing.assert_allclose(found.qdd, known.qdd, atol=1e-9 * size)
    np.testing.assert_allclose(found.object_acceleration, known.object_acceleration, atol=1e-9 * size)
    of_hands = wrenches_of_hands(open_chain, hands, wrench) + found.grasp_wrench
    np.testing.assert_allclose(of_hands, known.grasp_wrench, atol=1e-9 * np.abs(known.grasp_wrench).max())


@pytest.mark.slow
def test_rate_of_slip():
    """The rows' accelerations are the derivatives of the slip along a motion, also of one that slips and spins."""
    chain, state, tau = held_by(("softfinger", "ball"))
    hands = tuple(Hand(name, grasp) for name, grasp in chain.grasps.items())
    chain = without_hands(chain, chain.names)
    rng = np.random.default_rng(1)
    state = replace(state, object_twist=state.object_twist + rng.uniform(-0.5, 0.5, 6))
    free = hf.forward_dynamics(chain, state, tau)
    rows = touching_rows(chain, state, hands)
    rate = rows.C @ stacked_acceleration(chain, state, hands, free) + rows.drift
    u = []
    for h in (-1e-4, 1e-4):
        run = hf.simulate(chain, state if h > 0 else reversed_in_time(state), lambda t, s, m: (tau, m), 1e-4, 1e-4)
        end = run.state(1) if h > 0 else reversed_in_time(run.state(1))
        u.append(touching_rows(chain, end, hands).velocity(stacked_twist(chain, end, hands)))
    np.testing.assert_allclose((u[1] - u[0]) / 2e-4, rate, rtol=1e-5, atol=1e-4)
    gaps = touching_rows(chain, state, hands).velocity(stacked_twist(chain, state, hands))[:, 2]
    assert np.abs(gaps).min() > 0.0


def reversed_in_time(state):
    """Return the state with opposite velocities."""
    return replace(state, qd=-state.qd, object_twist=-state.object_twist)
