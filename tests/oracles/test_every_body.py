"""The oracle of trunks has the stored 180-digit answers, those of the other oracle, and joints' in place of grasps."""

import numpy as np
import pytest

from holdfast import Inputs
from holdfast.dynamics import project_velocity
from tests.oracles.every_body import EveryBody
from tests.oracles.maximal_kkt import solve
from tests.systems.as_chain import Problem, as_chain
from tests.systems.lower_pairs import PITCH, grasp_of, pair
from tests.systems.problems import random_case, relative_gap
from tests.systems.trunk_problems import cases, names

DIGITS = 50
EXACT = 1e-12
SLIDING = ("universal", "slider", "cylinder", "planar", "two slides", "three slides", "scara")


@pytest.mark.parametrize("name", names())
def test_stored_answers(name):
    """Accelerations of trunk, base, arms and object; forces where they are unique."""
    case = cases()[name]
    oracle = EveryBody(Problem(case.chain, case.state, case.tau, case.inputs), DIGITS)
    found, _ = oracle.solved()
    wanted, trunk = case.expected, case.expected.trunk
    assert relative_gap(found.qdd, np.concatenate([trunk.qdd, *wanted.qdd])) < EXACT
    assert relative_gap(found.object_acceleration, wanted.alpha_C) < EXACT
    if trunk.acceleration is not None:
        assert relative_gap(found.base_acceleration, trunk.acceleration) < EXACT
    if oracle.unique:
        assert relative_gap(found.grasp_wrench, wanted.f) < EXACT
        assert relative_gap(found.base_wrench, wanted.base_wrench) < EXACT
    if trunk.base_wrench is not None:
        assert relative_gap(found.trunk_base_wrench, trunk.base_wrench, 1.0) < EXACT


@pytest.mark.parametrize("seed", range(6))
def test_without_a_trunk(seed):
    """Arms on bases of their own, some moving: the answers of the oracle in joint coordinates."""
    case = random_case(seed)
    found, _ = EveryBody(as_chain(case), DIGITS).solved()
    wanted = solve(case, DIGITS)
    assert relative_gap(found.qdd, np.concatenate(wanted["qdd"])) < EXACT
    assert relative_gap(found.object_acceleration, wanted["alpha_C"]) < EXACT
    assert relative_gap(found.grasp_wrench, wanted["f"]) < EXACT
    assert relative_gap(found.base_wrench, wanted["base_wrench"]) < EXACT


@pytest.mark.parametrize("kind", SLIDING)
def test_joints_in_place_of_grasps(kind):
    """A grasp that slides or crosses is as many massless joints and a rigid grasp beyond them."""
    p = pair((kind, "rigid", kind), seed=3)
    grasps, _ = EveryBody(Problem(p.chain, p.state, p.tau, Inputs()), DIGITS).solved()
    joints, _ = EveryBody(Problem(p.by_joints, p.same, p.torques_of_joints(), Inputs()), DIGITS).solved()
    assert relative_gap(grasps.qdd, joints.qdd[p.own]) < EXACT
    assert relative_gap(grasps.object_acceleration, joints.object_acceleration) < EXACT


def test_a_screw_is_the_subspace_of_its_twist():
    """Rows on the object and a pitch, or rows on the tip that its twist is orthogonal to."""
    p = pair(("cylinder", "rigid"), seed=4)
    name, cylinder = next(iter(p.chain.grasps.items()))
    twist = [[1.0], [0.0], [0.0], [PITCH], [0.0], [0.0]]
    found = []
    for grasp in (grasp_of("screw", cylinder.frame), type(cylinder)("subspace", cylinder.frame, motion=twist)):
        chain = p.chain.without_grasp(name).with_grasp(name, grasp)
        state = project_velocity(chain, p.state)
        found.append(EveryBody(Problem(chain, state, p.tau, Inputs()), DIGITS).solved()[0])
    assert relative_gap(found[0].qdd, found[1].qdd) < EXACT
    assert relative_gap(found[0].grasp_wrench, found[1].grasp_wrench) < EXACT
