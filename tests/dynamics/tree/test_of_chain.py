"""Chains by the elimination in which every arm is a limb, beside that of their forest, joint by joint."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.tree.forest_dynamics import forest_dynamics
from holdfast.dynamics.tree.of_chain import chain_graph
from holdfast.dynamics.tree.order import AddFree, Cross, CrossAll, MeasureLeaf, MeasureLeaves
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from tests.longer import mostly_slow
from tests.systems.problems import random_problem
from tests.systems.stored_cases import stored_cases
from tests.systems.trunk_problems import random_on_trunk

STORED = {name: cases for cases in map(stored_cases, ("cases.json", "cases_trunk.json")) for name in cases}


def gap(found, wanted) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return float(np.abs(found - wanted).max(initial=0.0)) / max(1.0, float(np.abs(wanted).max(initial=0.0)))


def still_bases(raw) -> bool:
    """Return whether no base in the world moves, which a forest cannot be told."""
    bases = [part.get("base") or {} for part in (raw.get("trunk") or {}, *raw["arms"])]
    return not any(np.any(base.get(rate, 0.0)) for base in bases for rate in ("omega", "v", "omega_dot", "v_dot"))


def differences(p) -> list[float]:
    """Return the gaps between a chain's accelerations and grasp wrenches and those of its forest."""
    chain, state, inputs = p.chain, p.state, p.inputs.shaped(p.chain)
    base = [] if state.base_pose is None else [state.base_pose]
    q = np.concatenate([*base, state.q, state.object_pose])
    qd = np.concatenate([*([] if state.base_twist is None else [state.base_twist]), state.qd, state.object_twist])
    tau = np.concatenate([np.zeros(6 * len(base)), p.tau, np.zeros(6)])
    of_trunk = np.zeros((0 if chain.trunk is None else len(chain.trunk.bodies), 6))
    of_links = np.zeros((sum(arm.joint_count for arm in chain.arms.values()), 6))
    given = (inputs.trunk_link_wrenches, of_trunk), (inputs.link_wrenches, of_links), ([inputs.object_wrench], None)
    wrenches = np.concatenate([none if x is None else x for x, none in given])
    whole = forest_dynamics(chain.forest, q, qd, tau, wrenches, check=False)
    found = hf.forward_dynamics(chain, state, p.tau, inputs=p.inputs, check=False)
    own = slice(6 * len(base), -6)
    rows = [list(chain.arms).index(name) for name in chain.grasps]
    return [
        gap(found.qdd, whole.qdd[own]),
        gap(found.object_acceleration, whole.qdd[-6:]),
        gap(found.grasp_wrench[rows], whole.closure_wrench),
    ]


STANDING = [name for name, cases in STORED.items() if still_bases(cases.raw[name])]


def test_enough_are_compared():
    """Most stored chains have bases that stand still."""
    assert len(STANDING) >= 80


@pytest.mark.parametrize("name", mostly_slow(STANDING, STANDING[::3]))
def test_stored_chains(name):
    """Stored chains, arms in the world, on trunks and on floating bases, to 1e-12."""
    assert max(differences(STORED[name][name])) <= 1e-12


def test_an_arm_that_holds_nothing():
    """It moves by itself in both."""
    p = random_problem(5, arms=3, grasps=("rigid", None, "hinge"), moving_base=False, extras=False)
    assert max(differences(p)) <= 1e-10


def test_plan_of_a_trunk():
    """The root moves inward from the arms' bodies; a short trunk with all arms on its last body is crossed at once."""
    p = random_on_trunk(4, 2, floating=True)
    graph = chain_graph(p.chain, trunk_at_rest(p.chain, p.state))
    held, trunk = graph.held_object, tuple(graph.trunk)
    (steps,) = plan_of(graph.topology, trunk=trunk).steps
    assert steps[0] == AddFree(held, 0)
    assert [step.body for step in steps if isinstance(step, Cross)] == list(reversed(trunk))
    leaves = [leaf for step in steps if isinstance(step, MeasureLeaves) for leaf in step.leaves]
    assert all(isinstance(leaf, MeasureLeaf) for leaf in leaves)
    assert sorted(leaf.joints for leaf in leaves) == sorted(tuple(graph.arms[name]) for name in graph.closures)
    (at_once,) = plan_of(graph.topology, trunk=trunk, rates=True).steps
    assert [step.bodies for step in at_once if isinstance(step, CrossAll)] == [trunk]
