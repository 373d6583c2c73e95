"""What every motion keeps: the grasps, energy, momentum."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.dynamics import closure, kinetic_energy, momentum, potential_energy
from holdfast.simulation import Rollout, RolloutSystems
from tests.longer import mostly_slow
from tests.simulation.rollout.problems import given_torques, problem, started, swinging

DURATION = 0.08


@pytest.mark.slow
@pytest.mark.parametrize("name", ["legs", "five"])
def test_closure(name):
    """After every step every grasp is closed to rounding; the gaps reported are those that the reference finds."""
    rollout, (chain, state) = swinging(name), problem(name)
    systems = started(rollout, state, 3)
    for _ in range(40):
        rollout.step(systems, 2e-3)
        assert systems.running.all()
        assert systems.gap.max() <= 1e-12
        assert (systems.drift[:, 0] <= 1e-4).all()
    gaps = closure(chain, systems.state(2)).values()
    assert max(np.abs(gap.position).max() for gap in gaps) <= 1e-12
    assert max(np.abs(gap.velocity).max() for gap in gaps) <= 1e-12


@pytest.mark.slow
def test_first_gap_is_reported():
    """`start` closes what is a little open, and reports how far it was."""
    rollout, (_, state) = swinging("legs"), problem("legs")
    systems = started(rollout, state, 2)
    assert systems.drift[0].max() <= 1e-12 and 1e-5 < systems.drift[1].max() < 1e-2
    assert systems.gap.max() <= 1e-12


def energy(rollout: Rollout, systems: RolloutSystems, row: int) -> float:
    """Return T + V less the work done so far [J]."""
    state = systems.state(row)
    total = kinetic_energy(rollout.chain, state) + potential_energy(rollout.chain, state)
    return float(total - systems.work[row].sum())


@pytest.mark.parametrize(
    ("name", "scheme", "order"),
    mostly_slow([("five", "rk4", 4), ("legs", "rk4", 4), ("one", "midpoint", 2)], [("one", "midpoint", 2)]),
)
def test_energy(name, scheme, order):
    """Energy changes by the work of drives, losses and wrenches; what is left falls with the scheme's order."""
    rollout, (_, state) = swinging(name, scheme), problem(name)
    wrench = np.array([0.3, -0.2, 0.1, 1.0, 2.0, -1.5])
    left = []
    for steps in (20, 40):
        # torques that remember steps are no smooth function of time
        systems = started(rollout, state, 1, memory=np.zeros(2), object_wrench=wrench)
        before = energy(rollout, systems, 0)
        rollout.step(systems, DURATION / steps, steps=steps, object_wrench=wrench)
        left.append(abs(energy(rollout, systems, 0) - before))
    assert left[0] <= 1e-2
    assert np.log2(left[0] / left[1]) == pytest.approx(order, abs=0.5)


def test_work_terms():
    """Drives, losses, wrenches: each is what it is; nothing is done by bases that stand still."""
    rollout, (chain, state) = given_torques("one"), problem("one")
    tau, wrench = np.full(chain.joint_count, 0.5), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    systems = started(rollout, state, 1, tau=tau, object_wrench=wrench)
    q, z = systems.q[0].copy(), systems.object_pose[0, 6]
    rollout.step(systems, 1e-3, steps=50, tau=tau, object_wrench=wrench)
    drives, losses, bases, external = systems.work[0]
    assert drives == pytest.approx(tau @ (systems.q[0] - q), rel=1e-7)
    assert external == pytest.approx(2.0 * (systems.object_pose[0, 6] - z), rel=1e-7)
    assert losses < 0.0 and bases == 0.0


def test_released_object():
    """Nobody holds it: its momentum changes by its weight only, arms move on."""
    rollout, (chain, state) = swinging("nobody holds"), problem("nobody holds")
    alone = rollout.chain.held_object
    systems = started(rollout, state, 1)

    def spin_and_push() -> np.ndarray:
        at = systems.state(0)
        arms = type(at)(at.q, 0.0 * at.qd, at.object_pose, at.object_twist)  # joints at rest carry none
        return momentum(chain, arms)

    before, centre = spin_and_push(), state.object_frame.R @ alone.com + state.object_frame.p
    velocity = before[3:] / alone.mass
    rollout.step(systems, 1e-3, steps=100)
    t = systems.t[0]
    pull = alone.mass * chain.gravity
    arm = centre * t + velocity * t**2 / 2  # integral of the mass centre's place, its fall apart
    expected = before + np.concatenate([np.cross(arm, pull), pull * t])
    assert np.abs(spin_and_push() - expected).max() <= 1e-9 * max(1.0, np.abs(expected).max())
    assert np.abs(systems.q[0] - state.q).max() > 1e-3
    assert systems.margin.shape == (1, 0) and not systems.grasp_wrench.any()
