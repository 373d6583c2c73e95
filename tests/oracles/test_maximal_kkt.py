"""The oracle reproduces the stored answers and obeys laws it was not built from."""

import numpy as np
import pytest

from holdfast import Inputs
from holdfast.dynamics import project_velocity
from tests.longer import mostly_slow
from tests.oracles.arithmetic import solve_by_elimination
from tests.oracles.every_body import EveryBody
from tests.oracles.maximal_kkt import solve, solve_min_norm
from tests.oracles.stepping import kinetic_energy, power, stepped, wrench_about_C
from tests.systems import closure_gaps, problems, random_system, well_conditioned_system
from tests.systems.as_chain import Problem, as_chain
from tests.systems.lower_pairs import PITCH, grasp_of, pair
from tests.systems.problems import random_case, relative_gap
from tests.systems.trunk_problems import cases, names

CASES = list(problems.CASES.values())
UNIQUE = [case for case in CASES if case["tags"]["f_unique"]]
SMALL = [case for case in UNIQUE if sum(len(arm["q"]) for arm in case["arms"]) <= 14][:12]
HELPERS = {
    "M": "mass_matrix",
    "J": "jacobian",
    "bias": "bias_torque",
    "tip_bias": "tip_bias_acceleration",
    "tip": "tip_position",
}


def name(case: dict) -> str:
    """Return a case's name, for test ids."""
    return case["name"]


def assert_stored_answer(case: dict, answer: dict, forces: bool = True) -> None:
    """Assert agreement with a stored answer, 1e-9 relative, arm by arm."""
    expected = case["expected"]
    assert relative_gap(answer["alpha_C"], expected["alpha_C"]) < 1e-9
    for key in ("qdd", "W_dot", "f")[: 3 if forces else 2]:
        for got, want in zip(answer[key], expected[key], strict=True):
            assert relative_gap(got, want) < 1e-9, key
    total = wrench_about_C(case, expected["f"])
    assert relative_gap(wrench_about_C(case, answer["f"]), total) < 1e-9


@pytest.mark.parametrize("case", UNIQUE, ids=name)
def test_float64_answer(case):
    """One LU of the KKT system gives the stored accelerations and forces."""
    assert_stored_answer(case, solve(case))


@pytest.mark.parametrize("case", [c for c in CASES if c not in UNIQUE], ids=name)
def test_least_squares_answer(case):
    """Where forces are not unique, accelerations and the total wrench still are."""
    answer = solve_min_norm(case)
    assert_stored_answer(case, answer, forces=False)
    assert answer["residual"] < 1e-11
    stored = sum(np.sum(np.square(f)) for f in case["expected"]["f"])
    assert sum(np.sum(np.square(f)) for f in answer["f"]) <= stored * (1 + 1e-9)


@pytest.mark.parametrize("case", SMALL, ids=name)
def test_many_digits_answer(case):
    """Forty digits give the stored answers; sixty the same float64s, zeros aside."""
    answer = solve(case, digits=40)
    assert_stored_answer(case, answer)
    more = solve(case, digits=60)
    for key in ("qdd", "f", "W_dot", "base_wrench"):
        for got, want in zip(answer[key], more[key], strict=True):
            np.testing.assert_allclose(got, want, rtol=0.0, atol=1e-30)


@pytest.mark.parametrize("case", CASES, ids=name)
def test_helpers(case):
    """Mass matrix, Jacobian, bias and tip match the stored ones."""
    answer = solve_min_norm(case)
    for key, stored in HELPERS.items():
        for got, debug in zip(answer[key], case["debug"], strict=True):
            assert relative_gap(got, debug[stored]) < 1e-11, key
    for got, arm in zip(answer["W"], case["arms"], strict=True):
        assert relative_gap(got, arm["grasp"]["W"]) < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_power_balance(seed):
    """Kinetic energy changes at the rate of the power of all efforts and bases."""
    case = well_conditioned_system(seed, moving_base=seed % 2 == 0)
    answer, dt = solve(case), 1e-4
    energies = [kinetic_energy(stepped(case, answer, step)) for step in (dt, -dt)]
    rate = (energies[0] - energies[1]) / (2.0 * dt)
    supplied = power(case, answer)
    assert abs(rate - supplied) < 1e-5 * (1.0 + abs(supplied) + kinetic_energy(case))


@pytest.mark.parametrize("seed", range(5))
def test_grasps_stay_closed(seed):
    """After a second-order step the gaps shrink with dt as its order says."""
    case = well_conditioned_system(seed, moving_base=seed % 2 == 1)
    answer = solve(case)
    coarse, fine = (closure_gaps(stepped(case, answer, dt)) for dt in (2e-3, 1e-3))
    assert coarse[0] > 6.0 * fine[0]  # position: third order
    assert coarse[1] > 3.0 * fine[1]  # velocity: second order
    assert coarse[2] == 0.0 or coarse[2] > 3.0 * fine[2]  # W against W + W_dot dt


def test_light_object_needs_digits():
    """Forty and sixty digits agree for an object of 1e-10 of its weight."""
    case = well_conditioned_system(3, arms=3, grasps="rigid", joints=6, object_scale=1e-10)
    answer, more = solve(case, digits=40), solve(case, digits=60)
    np.testing.assert_array_equal(answer["alpha_C"], more["alpha_C"])


def test_free_arm_and_free_object():
    """An arm that holds nothing moves by itself; so does an object nobody holds."""
    case = random_system(5, grasps=[None, None], moving_base=False, extras=False)
    answer = solve(case)
    for arm, qdd, M, bias in zip(case["arms"], answer["qdd"], answer["M"], answer["bias"], strict=True):
        np.testing.assert_allclose(M @ qdd + bias, arm["tau"], atol=1e-11)
    R, com = np.array(case["object"]["R"]), np.array(case["object"]["com"])
    omega, alpha = np.array(case["object"]["omega"]), answer["alpha_C"]
    lever = R @ com
    falling = alpha[3:] + np.cross(alpha[:3], lever) + np.cross(omega, np.cross(omega, lever))
    np.testing.assert_allclose(falling, case["gravity"], atol=1e-12)


def test_elimination_needs_pivoting():
    """A zero first pivot is swapped away; a singular matrix is reported."""
    x = solve_by_elimination(np.array([[0.0, 2.0], [4.0, 1.0]]), np.array([2.0, 5.0]))
    np.testing.assert_allclose(x.astype(float), [1.0, 1.0])
    with pytest.raises(ZeroDivisionError):
        solve_by_elimination(np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([1.0, 0.0]))


DIGITS = 50
EXACT = 1e-12
SLIDING = ("universal", "slider", "cylinder", "planar", "two slides", "three slides", "scara")


@pytest.mark.parametrize("name", mostly_slow(names(), names()[2::3]))
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
