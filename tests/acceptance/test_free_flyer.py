"""A spacecraft with two arms that catches a tumbling satellite and carries it along for 20 s."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import attach, kinetic_energy, momentum
from tests.systems.trunk_runs import still_base

pytestmark = pytest.mark.long
CATCH, END = 2.0, 20.0
TWO = {"arms": 2, "joints": 7, "grasps": "rigid", "gravity": (0.0, 0.0, 0.0)}


def test_catch():
    """One arm holds the satellite, the other grips at 2 s while they move against each other; nothing else pushes.

    Dampers in the joints bring the arms to rest in the end; the whole tumbles on.
    """
    p = still_base(7, 2, floating=True, arms=TWO, in_world=0.0)
    caught = p.chain.names[1]
    grasp = p.chain.grasps[caught]
    damped = {
        name: replace(arm, joints=[replace(joint, damping=2.0) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    chain = replace(p.chain, arms=damped).without_grasp(caught)
    rate = np.random.default_rng(3).normal(size=chain.joint_count)
    state = hf.dynamics.project_velocity(chain, replace(p.state, qd=0.3 * rate))
    law = hf.ControlLaw(lambda t, s, memory, given: (np.zeros(chain.joint_count), memory))
    grips = hf.Attach(CATCH, caught, grasp, here=True)
    run = hf.simulate(
        chain, state, law, END, 0.1, scheme="dop853", rtol=1e-13, atol=1e-14, events=[grips], on_limit="record"
    )
    assert run.stopped is None and run.t[-1] == END
    sizes = np.abs(run.momentum).max(axis=0).reshape(2, 3).max(axis=1)
    drift = np.abs(run.momentum - run.momentum[0]).max(axis=0).reshape(2, 3).max(axis=1) / sizes
    k = int(np.flatnonzero(~run.holding.all(axis=1))[-1])  # the last sample before
    assert abs(run.t[k] - CATCH) < 1e-12
    across = np.abs(run.momentum[k + 1] - run.momentum[k]).reshape(2, 3).max(axis=1) / sizes
    made = attach(chain, run.state(k), caught, grasp, here=True)
    before, after = kinetic_energy(chain, run.state(k)), kinetic_energy(made.chain, made.state)
    lost = abs((after - before) - made.energy_change) / before
    assert np.abs(momentum(made.chain, made.state) - momentum(chain, run.state(k))).max() <= 1e-13 * sizes.max()
    gap = run.position_gap[:, 1].max()
    print(
        f"momentum over {END:g} s: angular {drift[0]:.1e}, linear {drift[1]:.1e}; across the catch {across.max():.1e};"
        f" energy lost {made.energy_change:.3g} J, as the formula says to {lost:.1e} of {before:.3g} J;"
        f" closure {gap:.1e}; {len(run)} samples"
    )
    assert drift.max() <= 1e-11 and across.max() <= 1e-13
    assert made.energy_change < -1e-3 and lost <= 1e-12
    assert gap <= 1e-12
