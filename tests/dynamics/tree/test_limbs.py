"""Limbs: chains of joints that are solved as arms give what the elimination gives joint by joint."""

import numpy as np
import pytest

from holdfast.dynamics import forest_dynamics
from holdfast.dynamics.tree.forest_dynamics import forest_arguments
from holdfast.dynamics.tree.limbed_solution import solved_with_limbs
from holdfast.dynamics.tree.limbs import limb_arms, limbed_motion
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.tree.varied_forest import damping_torques
from holdfast.errors import SingularChainError
from tests.dynamics.tree.problems import gap
from tests.longer import mostly_slow
from tests.systems.humanoid import humanoid
from tests.systems.random_forests import random_forest


def by_limbs(p):
    """Return the number of joints of all limbs, and the solution with them."""
    given, arms = forest_arguments(*p[1:]), limb_arms(p.forest)
    torque = given.tau - damping_torques(p.forest, given.qd)
    limbed = limbed_motion(p.forest, arms, given.q, given.qd, torque, given.wrenches)
    return sum(len(one.joints) for one in arms), solved_with_limbs(limbed, plan_of(p.forest.topology))


@pytest.mark.parametrize("seed", mostly_slow(range(60), range(0, 60, 3)))
def test_random_forests(seed):
    """Accelerations, unique forces and ranks, of limbs on the world, on free bodies, on joints and between them."""
    p = random_forest(seed)
    try:
        wanted = forest_dynamics(*p[1:])
    except SingularChainError:
        pytest.skip("no accelerations satisfy it")
    _, found = by_limbs(p)
    bar = 1e-9 if "_light_" in p.name else 1e-10
    assert gap(np.concatenate(found.qdd), wanted.qdd) <= bar
    assert int(found.rank) == wanted.rank
    if wanted.rank == p.forest.constraint_row_count:
        assert gap(np.array(found.wrenches).reshape(-1, 6), wanted.closure_wrench) <= bar
        assert gap(found.multipliers, wanted.coupling_force) <= bar


def test_humanoid():
    """All joints but those of the torso are in limbs; feet in the world are the bodies b of their closures."""
    p = humanoid()
    joints, found = by_limbs(p._replace(wrenches=np.random.default_rng(3).normal(size=p.wrenches.shape)))
    wanted = forest_dynamics(*p[1:-1], np.random.default_rng(3).normal(size=p.wrenches.shape), check=False)
    assert joints == 26
    assert gap(np.concatenate(found.qdd), wanted.qdd) <= 1e-12
    assert gap(found.wrenches, wanted.closure_wrench) <= 1e-12
    assert max(found.left) <= 1e-12


@pytest.mark.slow
def test_what_is_no_limb():
    """Nothing that another closure, a branch or a coupling needs is in a limb, nor a joint of several freedoms."""
    for seed in range(60):
        forest = random_forest(seed).forest
        arms = limb_arms(forest)
        members = [k for one in arms for k in one.joints]
        assert len(members) == len({*members})
        assert all(forest.bodies[k].joint.of_kind.freedoms == 1 for k in members)
        assert not {*members} & {k for coupling in forest.couplings for k, _, _ in coupling.terms}
        for one in arms:
            others = [c for i, c in enumerate(forest.closures) if i != one.closure]
            assert not {*one.joints} & {end for c in others for end in (c.a, c.b)}
            parents = [k for k, body in enumerate(forest.bodies) if body.parent in one.joints]
            assert parents == [*one.joints[1:]]
