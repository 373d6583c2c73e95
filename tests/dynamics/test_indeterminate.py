"""Where forces are not unique: accelerations are, and the smallest forces are returned."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.smallest_forces import replaced_by_smallest
from tests.dynamics.problems import motion_of
from tests.longer import mostly_slow
from tests.oracles.maximal_kkt import solve_min_norm
from tests.systems import planar_parallelogram, planar_three_arms
from tests.systems.as_chain import as_chain
from tests.systems.overconstrained import MECHANISMS
from tests.systems.problems import relative_gap

CASES = {
    "two": planar_three_arms(0, joints=(6, 6)),
    "three": planar_three_arms(1),
    "tilted": planar_three_arms(2, tilted=True),
    "crank": planar_parallelogram(0.4),
}
cases = pytest.mark.parametrize("name", CASES)


@cases
def test_accelerations_are_unique(name):
    """Accelerations and the total wrench are the least-squares oracle's; the forces satisfy every equation."""
    p, truth = as_chain(CASES[name]), solve_min_norm(CASES[name])
    result = p.solved()
    s = Stacked(motion_of(p))
    assert relative_gap(result.qdd, np.concatenate(truth["qdd"])) < 1e-9
    assert relative_gap(result.object_acceleration, truth["alpha_C"]) < 1e-9
    f = result.grasp_wrench.ravel()
    assert relative_gap(s.A.T @ f, s.A.T @ np.concatenate(truth["f"])) < 1e-9
    assert relative_gap(s.J.T @ f, s.J.T @ np.concatenate(truth["f"])) < 1e-9
    assert relative_gap(s.M @ result.qdd + s.J.T @ f, s.T_free) < 1e-9


@cases
def test_smallest_forces(name):
    """sum |moment/L|^2 + |force|^2 is least: orthogonal to all that no joint and no object feels."""
    p = as_chain(CASES[name])
    motion = motion_of(p)
    f, s = p.solved().grasp_wrench.ravel(), Stacked(motion)
    w = np.tile(np.r_[np.full(3, length_scale([c.offset for c in motion.contacts]) ** -2), np.ones(3)], len(f) // 6)
    _, sizes, Vt = np.linalg.svd(np.hstack([s.J, s.A]).T)
    null = Vt[int((sizes > 1e-9 * sizes[0]).sum()) :]
    assert len(null) == {"two": 3, "three": 6, "tilted": 6, "crank": 3}[name]
    assert np.abs(null @ (w * f)).max() < 1e-10 * np.abs(w * f).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_slow(MECHANISMS, {*MECHANISMS} - {"Bricard"}))
def test_smallest_forces_of_mechanisms(name):
    """Of every kind of grasp: no part that nothing feels, by singular vectors. Any other forces lead back to them.

    So do the wrenches of the bases, which Newton and Euler give with any forces.
    """
    chain, state = MECHANISMS[name]()
    tau = np.linspace(-1.0, 1.0, chain.joint_count)
    found = hf.forward_dynamics(chain, state, tau)
    motion = chain_motion(chain, state, tau, hf.Inputs().shaped(chain))
    s, f = Stacked(motion), np.concatenate([found.grasp_wrench[chain.names.index(name)] for name in chain.grasps])
    effects = [s.J.T, s.A.T]
    if motion.trunk is not None:
        columns = [motion.trunk.jacobian(name, motion.arms[name].base_to_tip) for name in chain.grasps]
        effects.append(np.vstack([np.hstack(one) for one in columns]).T)
    w = np.tile(np.r_[np.full(3, length_scale([c.offset for c in motion.contacts]) ** -2), np.ones(3)], len(f) // 6)
    _, sizes, Vt = np.linalg.svd(np.concatenate(effects) @ s.K.T)
    null = Vt[int((sizes > 1e-9 * sizes[0]).sum()) :] @ s.K
    assert len(null) == chain.constraint_row_count - found.rank > 0
    size = np.abs(f).max()
    assert np.abs(null @ (w * f)).max() < 1e-12 * size * w.max()
    more = f + size * np.random.default_rng(0).normal(size=len(null)) @ null
    changed = replace(sequential(motion), wrenches=list(more.reshape(-1, 6)), base_wrenches=None)
    other = chain_solution(motion, changed, "auto")
    given = other.grasp_wrench, other.base_wrench, other.trunk_base_wrench
    expected = found.grasp_wrench, found.base_wrench, found.trunk_base_wrench
    assert np.abs(given[0] - expected[0]).max() > 0.01 * size
    for mine, theirs in zip(replaced_by_smallest(motion, found.rank, *given), expected, strict=True):
        assert mine is theirs is None or np.abs(mine - theirs).max() < 1e-12 * size
