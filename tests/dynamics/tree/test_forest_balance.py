"""Energies, momentum and power of forests: balances along forward dynamics."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.dynamics import forest_balance, forest_dynamics
from holdfast.dynamics.tree.forest_balance import kinetic_energy, mass_moment, momentum
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.model.forest import Forest
from holdfast.spatial.differentiation import linearised
from tests.dynamics.tree.problems import underactuated
from tests.longer import mostly_slow
from tests.systems.random_forests import random_forest


def rates(p, qdd, f):
    """Return the exact rate of change of a function of the motion along accelerations."""
    given = ForestArguments(*p[1:])

    def along(q, qd):
        return f(given.motion({"q": q, "qd": qd}), qd)

    return linearised(along, np.zeros(len(p.qd)), p.qd).rates(p.qd, qdd)


@pytest.mark.parametrize("seed", mostly_slow(range(20), range(5)))
def test_power_balance(seed):
    """d(T + U)/dt is the power of drives, dampers and wrenches: closures and couplings do no work."""
    p = underactuated(seed)
    found, balance = forest_dynamics(*p[1:]), forest_balance(*p[1:])
    kinetic, moment = rates(p, found.qdd, lambda motion, qd: (kinetic_energy(motion, qd), mass_moment(motion)[1]))
    change, terms = kinetic - p.forest.gravity @ moment, np.abs([kinetic, *balance.power, 1.0]).max()
    assert abs(change - balance.power.total) < 1e-10 * terms * (1e4 if "_heavy_" in p.name else 1.0)


@pytest.mark.parametrize("seed", mostly_slow([5, 25, 45], [5]))
def test_momentum_in_flight(seed):
    """Torsos that fly and hand objects on keep their momentum, about the world's origin, without gravity."""
    p = random_forest(seed)
    assert all(b.parent is not None or b.joint.of_kind.floats for b in p.forest.bodies)
    forest = Forest(p.forest.bodies, p.forest.closures, p.forest.couplings, np.zeros(3))
    p = p._replace(forest=forest, wrenches=0.0 * p.wrenches)
    tau = p.tau.copy()
    for body, part in zip(forest.bodies, forest.velocities, strict=True):
        tau[part] = 0.0 if body.joint.of_kind.floats else tau[part]
    (change,) = rates(
        p, forest_dynamics(forest, p.q, p.qd, tau).qdd, lambda motion, qd: (momentum(motion, np.zeros(3)),)
    )
    about = forest_balance(forest, p.q, p.qd, about=[0.3, -0.2, 0.5])
    here = forest_balance(forest, p.q, p.qd)
    assert np.abs(change).max() < 1e-10 * max(1.0, np.abs(here.momentum).max())
    moved = here.momentum[:3] - np.cross([0.3, -0.2, 0.5], here.momentum[3:])
    np.testing.assert_allclose(about.momentum[:3], moved, atol=1e-10 * max(1.0, np.abs(moved).max()))
    assert here.mass == pytest.approx(sum(body.link.mass for body in forest.bodies))
