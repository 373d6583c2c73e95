"""Torques under limits in one programme: 50-digit answers, Clarabel, forward dynamics, and the bits of machine code."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import clarabel_peer

import holdfast as hf
from holdfast.compiled import CompiledChain
from holdfast.compiled.structure import Options
from holdfast.compiler.interpret import interpret_schedule
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import length_scale
from holdfast.errors import StateError
from holdfast.forces import ForceCost, ForceLimits, distribution_parameters, grasp_margins
from holdfast.forces.elastic_distribution import DISTRIBUTE, ElasticDistribution, distributed, programme
from holdfast.forces.elastic_programme import ITERATIONS, solve
from holdfast.model.wrench_condition import NORMAL
from holdfast.questions.arrays import value_of
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import with_link_wrenches
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate
from tests.capabilities.chains import CHAINS, chain_with
from tests.codegen import problems as exported
from tests.codegen import test_export as export
from tests.control.two_pandas import two_pandas
from tests.forces.force_cases import Asked, all_cases, force_cases
from tests.longer import mostly_long

NAMES = [*force_cases()]
APEX, UNLIMITED = "no_weight_apex", "no_effort_limits"
MANY = (APEX, UNLIMITED, "unfelt_loads")  # multipliers that are not unique, or above the price
PRICED = [name for name, case in all_cases().items() if case.expected.prices and name not in MANY]
IN_WORLD = [name for name in CHAINS if "trunk" not in name and "floating" not in name]
COMPILED = ("two_soft_effort", "two_rigid_tight", "three_mixed_effort", "two_rigid_joint_acceleration_limits")


def case_of(chain: hf.ClosedChain, state: hf.State, acceleration: Array, inputs=None, **given) -> VariedCase:
    """Return what the question is asked about; parameters that are not given are the chain's."""
    own = {name: value_of(name, chain) for name in DISTRIBUTE.own(chain) if name != "acceleration"}
    own |= {name: np.asarray(x, dtype=float) for name, x in given.items()}
    return VariedCase(chain, state, with_link_wrenches(chain, inputs), own | {"acceleration": acceleration})


@np.errstate(all="ignore")  # a step beyond the last digit may overflow; the iterate is kept
def asked(*given, iterations: int = ITERATIONS, **more) -> ElasticDistribution:
    """Return what the text that machine code runs says of floats."""
    return ElasticDistribution(*distributed(case_of(*given, **more), iterations))


def numbers(found: ElasticDistribution) -> dict[str, Array]:
    """Return the arrays of an answer by name."""
    return {name: x for name, x in found._asdict().items() if x is not None}


@cache
def answered(name: str) -> ElasticDistribution:
    """Return the answer to a stored question; without effort limits, newton metres outweigh the usual price."""
    case = force_cases()[name]
    price = {"price": 1e7} if name == UNLIMITED else {}
    return asked(case.chain, case.state, case.arguments[4], **(case.call | price))


@cache
def fast(name: str) -> CompiledChain:
    """Return machine code of the chain of a stored question."""
    case = force_cases()[name]
    return CompiledChain(
        case.chain, Options(further=("acceleration_limits",) if "acceleration_limits" in case.call else ()), None
    )


def cost(case: Asked, found: ElasticDistribution) -> float:
    """Return the cost of a distribution, without that of passing limits."""
    call, scale = case.call, case.call["force_scale"]
    motion = chain_motion(case.chain, case.state, 0.0 * case.state.q, hf.Inputs().shaped(case.chain))
    unit = scale * np.repeat([length_scale([c.offset for c in motion.contacts]), 1.0], 3)
    off = [
        ((unrotate(c.frame, f) - wish) / unit)[list(c.rows)]
        for c, f, wish in zip(motion.contacts, found.grasp_wrench, call["wish"], strict=True)
    ]
    squares = ((found.tau / case.efforts) ** 2).sum(), (np.concatenate(off) ** 2).sum(), (found.qdd**2).sum()
    return 0.5 * (squares[0] + call["wrench_weight"] ** 2 * squares[1] + 1e-6 * squares[2])


@pytest.mark.parametrize("name", NAMES)
def test_answers_in_50_digits(name):
    """Verdicts, costs to 1e-8, torques to 1e-5 of their limits; v is at least the least violation."""
    case, found, expected = force_cases()[name], answered(name), force_cases()[name].expected
    assert found.residual < 1e-8
    passed = found.violation > 1e-6 * case.call["force_scale"]
    assert passed == (expected.status == "infeasible")
    if passed:
        assert found.violation > expected.least_violation - 1e-8 * case.call["force_scale"]
        return
    assert abs(cost(case, found) - expected.value) < 1e-8 * max(1.0, expected.value)
    # with zero force in its cone, the torques have half the digits of the cost
    bound = 1e-8**0.5 if name == APEX else 1e-5
    assert np.abs((found.tau - expected.tau) / case.efforts).max() < bound


@pytest.mark.parametrize("name", PRICED)
def test_prices_in_50_digits(name):
    """The multipliers by name, in the file's units, wherever they are unique."""
    case = all_cases()[name]
    found = asked(case.chain, case.state, case.acceleration, **case.call).prices(case.chain)
    expected: dict[str, float] = defaultdict(float)
    for words, z in case.expected.prices.items():
        what, _, of = words.rpartition(" of ")
        expected[f"{of} {what}".replace("normal", "normal force")] += z[0]
    known = {limit: x for limit, x in expected.items() if x > 1e-5}
    ours = {limit: x * case.call["force_scale"] for limit, x in found.items()}
    assert {limit for limit, x in ours.items() if x > 1e-5} == {*known}
    assert all(ours[limit] == pytest.approx(x, rel=1e-4, abs=1e-5) for limit, x in known.items())


@pytest.mark.parametrize("name", NAMES)
def test_forward_dynamics_returns_what_was_asked(name):
    """Torques that pass limits, too, give the acceleration, and where forces are unique the wrenches."""
    case, found = force_cases()[name], answered(name)
    back = hf.forward_dynamics(case.chain, case.state, found.tau)
    np.testing.assert_allclose(back.object_acceleration, case.arguments[4], atol=1e-10)
    np.testing.assert_allclose(back.qdd, found.qdd, atol=1e-9)
    assert found.missed < 1e-10
    if back.status == hf.dynamics.Status.OK:
        np.testing.assert_allclose(back.grasp_wrench, found.grasp_wrench, atol=1e-10 * case.call["force_scale"])


@pytest.mark.parametrize("kind", IN_WORLD)
def test_every_kind_of_chain(kind):
    """The acceleration that some torques give is given by others that cost less; what acts on the chain is taken in."""
    p = chain_with(kind)
    known = p.solved()
    found = asked(p.chain, p.state, known.object_acceleration, p.inputs, price=1e5)
    assert found.violation < 1e-9 and found.residual < 1e-8 and found.missed < 1e-10
    back = hf.forward_dynamics(p.chain, p.state, found.tau, inputs=p.inputs)
    np.testing.assert_allclose(back.object_acceleration, known.object_acceleration, atol=1e-10)
    np.testing.assert_allclose(back.qdd, found.qdd, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
@np.errstate(all="ignore")
def test_clarabel(name):
    """Another solver finds the same cost and the same violation of the same programme."""
    pytest.importorskip("clarabel", reason="needs Clarabel: pip install 'holdfast[dev]'")
    case, price = force_cases()[name], 1e7 if name == UNLIMITED else 1e3
    asked = case_of(case.chain, case.state, case.arguments[4], **case.call)
    motion = chain_motion(case.chain, case.state, 0.0 * case.state.q, asked.inputs)
    made = programme(motion, asked.own)
    ours, theirs = solve(made.blocks, made.e, price), clarabel_peer.solved(made.blocks, made.e, price)
    costs = [clarabel_peer.cost(made.blocks, *found, price) for found in (ours[:2], theirs)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-7, abs=1e-7)
    assert ours.v == pytest.approx(theirs[1], rel=1e-6, abs=1e-7)


def test_limits_hold():
    """Demanded margins, normal forces and shares of efforts are kept, and change the answer."""
    case = force_cases()["two_soft_effort"]
    chain, state = case.chain, case.state
    free = answered("two_soft_effort")
    R = state.object_frame.R
    frames = [R @ grasp.frame.R for grasp in chain.grasps.values()]

    def normals(found: ElasticDistribution) -> Array:
        return np.array([NORMAL @ unrotate(F, f) for F, f in zip(frames, found.grasp_wrench, strict=True)])

    def margin(found: ElasticDistribution) -> float:
        return grasp_margins(chain, state, found.grasp_wrench).min()

    least = margin(free)
    limits = [
        ({"demanded_margin": np.full(2, least + 3.0)}, margin, least + 3.0),
        ({"least_normal": normals(free) + 2.0}, lambda x: (normals(x) - normals(free)).min(), 2.0),
        ({"most_normal": normals(free) - 0.05}, lambda x: -(normals(x) - normals(free)).max(), 0.05),
        ({"effort_share": 0.98 * (used := np.abs(free.tau / case.efforts).max())},
            lambda x: -np.abs(x.tau / case.efforts).max(), -0.98 * used),
    ]  # fmt: skip
    for given, measured, wanted in limits:
        found = asked(chain, state, case.arguments[4], **(case.call | given))
        assert found.violation < 1e-7, given
        assert measured(found) == pytest.approx(wanted, abs=1e-5), given  # the limit is active, as the cost wants less


def test_what_is_beyond_the_possible_gives_way():
    """A margin of 1 kN is missed by nearly that, and torques remain finite."""
    case = force_cases()["two_soft_effort"]
    found = asked(case.chain, case.state, case.arguments[4], **case.call | {"demanded_margin": np.full(2, 1e3)})
    margins = grasp_margins(case.chain, case.state, found.grasp_wrench)
    assert found.residual < 1e-8
    assert found.violation == pytest.approx((1e3 - margins).max(), rel=1e-6)


def test_wishes():
    """A wish for wrenches or for joint accelerations is met where it costs nothing else."""
    case = force_cases()["two_soft_effort"]
    call = {"force_scale": 30.0, "wrench_weight": 1e3}
    wish = np.array([unrotate(case.state.object_frame.R @ grasp.frame.R, f) for grasp, f in zip(
        case.chain.grasps.values(), answered("two_soft_effort").grasp_wrench, strict=True)])  # fmt: skip
    found = asked(case.chain, case.state, case.arguments[4], **call, wish=wish)
    np.testing.assert_allclose(found.grasp_wrench, answered("two_soft_effort").grasp_wrench, atol=1e-4)
    moved = answered("two_rigid_effort").qdd
    case = force_cases()["two_rigid_effort"]
    found = asked(case.chain, case.state, case.arguments[4], wished_qdd=moved + 0.0, acceleration_weight=1e3)
    np.testing.assert_allclose(found.qdd, moved, atol=1e-4)


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-6, 1e-2])
def test_singular_postures(turn):
    """At a straight arm the numbers are bounded, and what the arm cannot follow is named; beside it all is given."""
    case = force_cases()["two_rigid_effort"]
    name = case.chain.names[0]
    arm, wrist = case.chain.arms[name], case.state.q.copy()
    joints = list(arm.joints)
    for k in (1, 2, 3):  # parallel axes in one plane
        joints[k] = replace(joints[k], axis=joints[0].axis, placement=hf.Pose(np.eye(3), (0.1, 0.0, 0.0)))
    chain = replace(case.chain, arms={**case.chain.arms, name: replace(arm, joints=joints)})
    wrist[1:4] = [turn, 0.0, 0.0]
    found = asked(chain, replace(case.state, q=wrist), case.arguments[4])
    assert all(np.isfinite(x).all() for x in numbers(found).values())
    assert (found.missed > 0.1) == (turn < 1e-9)
    assert np.abs(found.tau).max() < 1e12


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(COMPILED, ["two_soft_effort", "two_rigid_tight"]))
def test_machine_code(name):
    """Its numbers are those of the text on floats, its bits those of schedule, batches, threads and bound calls."""
    case, code = force_cases()[name], fast(name).distribute
    random = np.random.default_rng(1)
    many = [np.array([x] * 37) for x in case.arguments]
    many[0] += 0.05 * random.normal(size=many[0].shape)
    many[4] += random.normal(size=many[4].shape)
    found = code(*many, **case.call)
    rows = numbers(found)
    for threads in (1, 3):
        again = code(*many, **case.call, threads=threads)
        assert all(np.array_equal(x, y) for x, y in zip(found, again, strict=True))
    for k in (0, 5, 36):
        given = [x[k] for x in many]
        single = code(*given, **case.call)
        assert all(np.array_equal(x, rows[name][k]) for name, x in numbers(single).items())
        own = {name: x.astype(float) for name, x in code.calls.own.items()}
        own |= {name: np.asarray(x, dtype=float) for name, x in case.call.items()}
        schedule = interpret_schedule(
            code.computation.schedule(), own | dict(zip(DISTRIBUTE.inputs, given, strict=True))
        )
        assert all(np.array_equal(x, schedule[name]) for name, x in numbers(single).items())
        bound = code.bind(**dict(zip(DISTRIBUTE.inputs, map(np.array, given), strict=True)), **case.call)
        assert all(np.array_equal(x, y) for x, y in zip(single, bound(), strict=True))
        state = replace(case.state, q=given[0])
        text = asked(case.chain, state, given[4], **case.call)
        np.testing.assert_allclose(single.tau / case.efforts, text.tau / case.efforts, atol=1e-5)
        assert single.violation == pytest.approx(text.violation, abs=1e-6)


@pytest.mark.slow
def test_exported_code(tmp_path):
    """The program in C has the library's bits."""
    if not export.HERE:
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    chain, state = exported.chain_and_state("one holds")
    known = exported.answer("distribute", hf.compile(chain), state, 5)
    export.check_all([known], export.HERE[-1], True, ["gcc"], tmp_path)


@pytest.mark.parametrize("seed", mostly_long(range(30), range(4)))
def test_random_questions(seed):
    """Sixteen iterations reach 1e-6, whether or not the limits can be kept."""
    names = [name for name in IN_WORLD if name not in ("forces that are not unique",)]
    p = chain_with(names[seed % len(names)])
    random = np.random.default_rng(seed)
    known = p.solved()
    size = np.abs(p.tau).max() * random.uniform(0.2, 3.0, p.chain.joint_count)
    efforts, arms = iter(size), {}
    for name, arm in p.chain.arms.items():
        joints = [replace(joint, effort_limit=next(efforts)) for joint in arm.joints]
        arms[name] = replace(arm, joints=joints) if joints else arm
    chain = replace(p.chain, arms=arms)
    found = asked(chain, p.state, known.object_acceleration, p.inputs)
    assert found.residual < 1e-6
    back = hf.forward_dynamics(chain, p.state, found.tau, inputs=p.inputs)
    np.testing.assert_allclose(back.object_acceleration, known.object_acceleration, atol=1e-9)


@pytest.mark.parametrize("name", mostly_long(["one_contact", "hinge_soft_effort", "two_soft_effort"], ["one_contact"]))
def test_a_thousand_questions(name):
    """At most two residuals exceed 1e-6 after sixteen iterations, also where active limits leave nothing to choose."""
    case, code, random = force_cases()[name], fast(name).distribute, np.random.default_rng(len(name))
    many = [np.array([x] * 1000) for x in case.arguments]
    many[0] += 0.02 * random.normal(size=many[0].shape)
    many[4] = random.normal(size=many[4].shape) * random.choice([0.3, 2.0, 10.0], size=(1000, 1))
    margins = random.uniform(0.0, 5.0, (1000, len(case.chain.grasps)))
    found = code(*many, effort_share=random.uniform(0.2, 1.5, 1000), demanded_margin=margins)
    assert 0.2 < np.mean(found.violation < 1e-6) < 1.0
    assert (found.residual > 1e-6).sum() <= 2
    assert np.isfinite(found.tau).all()


@pytest.mark.slow
def test_cost_is_linear_in_arms():
    """Operations of two, three and four equal arms have no second difference."""
    base = force_cases()["three_soft_effort"].chain
    arm, grasp = base.arms[base.names[0]], base.grasps[base.names[0]]
    counts = []
    for number in (2, 3, 4, 5):
        names = [f"arm{k}" for k in range(number)]
        chain = hf.ClosedChain(dict.fromkeys(names, arm), base.held_object, dict.fromkeys(names, grasp), base.gravity)
        counts.append(CompiledChain(chain, Options(), None).distribute.computation.schedule().operation_count)
    assert np.ptp(np.diff(counts)) == 0


def test_overflow_is_refused():
    """Inputs that are not finite are named."""
    s = force_cases()["two_soft_effort"].state
    with pytest.raises(StateError, match="acceleration: expected finite numbers"):
        fast("two_soft_effort").distribute(s.q, s.qd, s.object_pose, s.object_twist, np.full(6, np.nan))


@pytest.mark.parametrize("kind", ["universal", "softfinger", "cylinder"])
def test_wishes_have_the_axes_of_contact_frames(kind):
    """Whatever axes a kind of grasp has: the reference and machine code are asked for the same wrenches."""
    chain, state = two_pandas(kind, "rigid")
    cost = ForceCost(wrench=10.0, wish=20.0 * np.random.default_rng(3).normal(size=(2, 6)))
    limits = ForceLimits(effort=None)
    given = distribution_parameters(chain, state, limits, cost)
    found = asked(chain, state, np.zeros(6), **given)
    expected = hf.forces.distribute(chain, state, np.zeros(6), limits=limits, cost=cost)
    assert found.tau == pytest.approx(expected.tau, abs=1e-6 * np.abs(expected.tau).max())
