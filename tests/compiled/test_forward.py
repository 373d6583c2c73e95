"""Compiled forward dynamics is the reference's, for every sort of chain."""

import numpy as np
import pytest

import holdfast
from holdfast.dynamics import Status
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.errors import MethodNotApplicable, SingularChainError, StateError
from holdfast.spatial.spatial_vector import shift_wrench
from tests.acceptance.comparison import errors, relative
from tests.compiled import problems
from tests.compiled.problems import CHAINS, answer, chain_named, chain_of, compiled, numbers, one
from tests.dynamics.problems import CASES, motion_of, random_case, stored
from tests.longer import mostly_slow
from tests.oracles.maximal_kkt import solve
from tests.systems import planar_parallelogram, planar_three_arms, two_collinear_stretched_6r
from tests.systems.as_chain import as_chain

TOLERANCE = 1e-11
UNIQUE = [name for name, case in CASES.items() if case["tags"]["f_unique"]]
# one of each sort; the others are compiled in tests/acceptance, as that takes a minute
HERE = {
    "rigid_1arm_7mixed_gravity", "rigid_short_arm_5_7", "mixed_3arm_moving_base", "stewart_6_RRP_ball",
    "tripod_3_RRRP_softfinger", "legs_3_RRP_ball_moving_base",
}  # fmt: skip


@pytest.mark.parametrize("name", mostly_slow(sorted(HERE), ("rigid_1arm_7mixed_gravity", "tripod_3_RRRP_softfinger")))
def test_stored_cases(name):
    """Every output is the reference's."""
    p = stored(name)
    expected = holdfast.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
    assert problems.relative_disagreement(answer(p), expected) <= TOLERANCE


def test_against_the_oracle():
    """A random system with everything on is what one LU in 50 digits says."""
    case = random_case(5, arms=3, joints=(6, 3, 5), grasps=("rigid", "ball", "hinge"), moving_base=True)
    assert max(errors(answer(as_chain(case)), solve(case, digits=50)).values()) <= 1e-12


@pytest.mark.parametrize("name", mostly_slow(CHAINS, {*CHAINS} - {"all kinds", "rows first"}))
def test_sorts_of_chains(name):
    """Arm types interleaved, few joints, no grasps, many of one type, moving bases, wrenches: the reference's."""
    chain, fast = chain_named(name), compiled(name)
    given = numbers(chain, 6) | problems.forces(chain, 6)
    for i in range(6):
        expected = problems.reference(chain, one(given, i))
        found = fast.forward_dynamics(**one(given, i))
        assert problems.relative_disagreement(found, expected) <= TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("method", ["recursive", "mass_matrix"])
def test_routes(method):
    """Both routes of an arm's answer at its tip; neither is the other's code."""
    name = "interleaved"
    chain, fast = chain_named(name), compiled(name, method)
    given = one(numbers(chain, 1) | problems.forces(chain, 1), 0)
    found = fast.forward_dynamics(**given)
    assert problems.relative_disagreement(found, problems.reference(chain, given, route=method)) <= TOLERANCE
    if method == "recursive":
        assert fast.operation_count > compiled(name, "mass_matrix").operation_count


@pytest.mark.slow
def test_parts_by_name():
    """`result[arm]` in a batch has a leading axis; mobility follows from the rank."""
    chain, fast = chain_named("all kinds"), compiled("all kinds")
    result = fast.forward_dynamics(**numbers(chain, 3))
    assert result["arm1"].qdd.shape == (3, 5)
    np.testing.assert_array_equal(result["arm2"].grasp_wrench, result.grasp_wrench[:, 2])
    np.testing.assert_array_equal(result["arm3"].contact_acceleration, result.contact_acceleration[:, 3:])
    assert result["arm4"].contact_acceleration.shape == (3, 0) and not result["arm4"].grasp_wrench.any()
    assert result.mobility.tolist() == [result.chain.joint_count + 6 + 6 - 24] * 3
    assert result.rank.dtype == np.int64 and result.condition.shape == result.status.shape == (3,)
    assert result.method == "sequential"
    single = fast.forward_dynamics(**one(numbers(chain, 3), 1))
    assert type(single.rank) is int and type(single.condition) is float and single.status is Status.OK


LOW = [planar_three_arms(1), planar_three_arms(2, tilted=True), planar_parallelogram(0.4)]


@pytest.mark.parametrize("case", mostly_slow(LOW, LOW[2:]), ids=lambda c: c["name"])
def test_indeterminate(case):
    """Constantly low rank: all that is unique is the reference's, and the forces satisfy every equation."""
    p = as_chain(case)
    found, expected = answer(p), holdfast.forward_dynamics(p.chain, p.state, p.tau)
    assert found.status is expected.status is Status.INDETERMINATE_FORCES
    assert (found.rank, found.mobility) == (expected.rank, expected.mobility)
    for name in ("qdd", "object_acceleration", "contact_acceleration"):
        assert relative(getattr(found, name), getattr(expected, name), floor=1.0) <= 1e-10
    s = Stacked(motion_of(p))
    f, e = found.grasp_wrench.ravel(), expected.grasp_wrench.ravel()
    assert relative(s.A.T @ f, s.A.T @ e, floor=1.0) <= 1e-10  # on the object
    assert relative(s.J.T @ f, s.J.T @ e, floor=1.0) <= 1e-10  # on the joints
    bases = [arm.base.p for arm in p.chain.arms.values()]
    totals = [sum(map(shift_wrench, bases, x.base_wrench)) for x in (found, expected)]
    assert relative(totals[0], totals[1], floor=1.0) <= 1e-10


@pytest.mark.parametrize(
    "case",
    [
        planar_parallelogram(0.0),
        pytest.param(two_collinear_stretched_6r(1), marks=pytest.mark.slow),
        two_collinear_stretched_6r(2, opposed=False),
    ],
)
def test_singular(case):
    """A single call at a singular configuration is refused with the reference's words."""
    p = as_chain(case)
    fast, given = problems.compiled_for(p)
    with pytest.raises(SingularChainError) as expected:
        holdfast.forward_dynamics(p.chain, p.state, p.tau)
    for _ in range(2):  # the second time the generic rank is known
        with pytest.raises(SingularChainError, match=str(expected.value)[:44]):  # why may be told otherwise
            fast.forward_dynamics(**given)


@pytest.mark.slow
def test_long_arm():
    """An arm of 18 joints, by recursion."""
    chain = chain_of(((18, "rigid"), (3, "ball")))
    given = one(numbers(chain, 1), 0)
    found = holdfast.compile(chain).forward_dynamics(**given)
    assert problems.relative_disagreement(found, problems.reference(chain, given)) <= TOLERANCE


def test_what_cannot_be_compiled():
    """Other algorithms, other numbers and unknown options are refused by name."""
    chain = chain_named("nine")
    for options, error, message in (
        ({"method": "kkt"}, MethodNotApplicable, "'kkt' runs as reference only; .* Try method='auto'"),
        ({"method": "recursiv"}, MethodNotApplicable, "recursiv"),
        ({"dtype": "float32"}, MethodNotApplicable, "dtype: expected float64, got 'float32'"),
        ({"parameters": ("link_mass",)}, StateError, "no optional parameter 'link_mass'"),
    ):
        with pytest.raises(error, match=message):
            holdfast.compile(chain, **options)
