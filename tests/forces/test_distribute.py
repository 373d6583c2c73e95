"""Distribution of forces: forward dynamics gives it back, limits are kept, reports are borders of what is possible."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import Status
from holdfast.errors import HoldfastError, ModelError, StateError
from holdfast.forces import ForceCost, ForceLimits, distribute, explain, least_peak, lift_margin
from holdfast.forces.certificate import MOST_PRICES, certificate
from holdfast.forces.force_question import ForceQuestion
from holdfast.forces.limit_rows import highest_acceleration
from holdfast.forces.margins import grasp_margins
from tests.control.two_pandas import rubber_pandas, two_pandas
from tests.longer import mostly_slow
from tests.systems import planar_three_arms, two_collinear_stretched_6r
from tests.systems.anchored import pinned
from tests.systems.as_chain import Problem, as_chain
from tests.systems.bricard import bricard
from tests.systems.bushed import random_bushed
from tests.systems.limited import asked_of, limited_problem
from tests.systems.overconstrained import on_a_trunk, on_threads
from tests.systems.problems import random_problem
from tests.systems.random_trunks import random_trunk_system
from tests.systems.sprung import with_springs

UP = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
EFFORTS = np.array([joint.effort_limit for joint in rubber_pandas(0.8)[0].all_joints])
WEIGHT = 3.0 * 9.81


def assert_given_back(p, found, tolerance=1e-10):
    """Assert that forward dynamics with the torques returns accelerations and wrenches."""
    back = hf.forward_dynamics(p.chain, p.state, found.tau, inputs=p.inputs)
    sizes = max(1.0, float(np.abs(found.qdd).max())), max(1.0, float(np.abs(found.grasp_wrench).max()))
    assert np.abs(back.qdd - found.qdd).max() <= tolerance * sizes[0]
    assert np.abs(back.object_acceleration - found.object_acceleration).max() <= tolerance * sizes[0]
    assert np.abs(back.grasp_wrench - found.grasp_wrench).max() <= tolerance * sizes[1]
    if p.chain.floats:
        assert np.abs(back.base_acceleration - found.base_acceleration).max() <= tolerance * sizes[0]


@pytest.mark.parametrize("seed", mostly_slow(range(24), range(8)))
def test_given_back(seed):
    """By forward dynamics, for arms in the world, on trunks and on floating bases, limits kept or not."""
    p, (acceleration, task) = limited_problem(seed), asked_of(seed)
    found = distribute(p.chain, p.state, acceleration, task=task, inputs=p.inputs)
    rows = np.eye(6) if task is None else task
    np.testing.assert_allclose(rows @ found.object_acceleration, acceleration, atol=1e-10)
    assert_given_back(p, found)


@pytest.mark.parametrize("make", [random_bushed, lambda seed: sprung(seed), lambda seed: random_trunk_system(seed)])
@pytest.mark.parametrize("seed", [3, 5])
def test_known_forces_given_back(make, seed):
    """Bushings, springs, joint springs, driven bases and arms that hold nothing are part of the motion."""
    p = make(seed)
    found = distribute(p.chain, p.state, np.zeros(0), task=np.zeros((0, 6)), inputs=p.inputs)
    assert_given_back(p, found, 1e-9)


@pytest.mark.parametrize(
    "make",
    [bricard, on_threads, lambda: on_a_trunk(floating=False), lambda: on_a_trunk(floating=True)],
    ids=["bricard", "threads", "trunk", "floating"],
)
def test_overconstrained(make):
    """Chains that move although their equations say they cannot, with forces that no joint feels."""
    chain, state = make()
    found = distribute(chain, state, np.zeros(0), task=np.zeros((0, 6)))
    assert_given_back(Problem(chain, state, found.tau, hf.Inputs()), found)


def test_anchors():
    """The object pinned to the world turns about the pin."""
    p = pinned(random_problem(3, joints=(6, 7), grasps=("rigid", "ball")), ("ball",))
    found = distribute(p.chain, p.state, np.zeros(0), task=np.zeros((0, 6)), inputs=p.inputs)
    assert_given_back(p, found)


def sprung(seed):
    """Return a random chain with springs between its bodies."""
    p = limited_problem(seed, trunks=False)
    return replace(p, chain=with_springs(p.chain, seed))


def test_effort_limits_share():
    """80 % of the drives carry the box; the limits are kept, and the margin is what was demanded."""
    chain, state = rubber_pandas(0.8)
    found = distribute(chain, state, limits=ForceLimits(effort=0.8, least_margin=20.0))
    assert found.status == "optimal"
    assert found.violation == 0.0
    assert (np.abs(found.tau) <= 0.8 * EFFORTS * (1 + 1e-9)).all()
    assert found.margin == pytest.approx(20.0, abs=1e-6)
    assert found.margin == grasp_margins(chain, state, found.grasp_wrench).min()
    assert "left friction" in found.why
    assert explain(found) == found.why
    eager = distribute(chain, state)
    assert eager.value < found.value  # what is demanded costs


@pytest.mark.parametrize("seed", mostly_slow(range(16), range(6)))
def test_elastic(seed):
    """Where the limits can be kept they are, at the same cost as if they were hard; elsewhere the lack is the least."""
    p, (acceleration, task) = limited_problem(seed), asked_of(seed)
    given = {"task": task, "inputs": p.inputs}
    soft, hard = distribute(p.chain, p.state, acceleration, **given), None
    hard = distribute(p.chain, p.state, acceleration, form="effort", **given)
    assert soft.status == hard.status
    if soft.status == "optimal":
        assert soft.value == pytest.approx(hard.value, rel=1e-6)
        assert soft.violation == hard.violation == 0.0
        assert soft.margin >= -1e-5 * WEIGHT
        return
    assert soft.certificate is not None and hard.certificate is not None
    assert soft.certificate.lack == pytest.approx(hard.violation, rel=1e-7)
    assert soft.violation >= hard.violation * (1 - 1e-7)
    assert soft.violation <= 1.2 * hard.violation + 1.0
    assert sum(soft.certificate.shares.values()) == pytest.approx(1.0, abs=1e-4)
    assert f"{soft.certificate.lack:.3g} N" in soft.why


@pytest.mark.parametrize("acceleration", [200.0, -150.0])
def test_certificate(acceleration):
    """Multipliers in the cones make every motion miss by the same: no torques keep these limits, whatever they are."""
    chain, state = rubber_pandas(0.8)
    question, found = asked(chain, state, acceleration * UP), distribute(chain, state, acceleration * UP)
    proof = found.certificate
    assert proof is not None and proof.lack > 1.0
    of, rng = question.found, np.random.default_rng(0)
    for x in (np.zeros(of.N.shape[1]), *rng.normal(size=(20, of.N.shape[1]))):
        v, total = of.v0 + of.N @ x, 0.0
        for limit in question.limits:
            z = proof.multipliers.get(limit.words, np.zeros(len(limit.h)))
            assert z[0] >= np.linalg.norm(z[1:]) - 1e-12
            total += z @ (limit.h - limit.G @ v) / limit.weight
        assert total == pytest.approx(-proof.lack, rel=1e-6)
    assert proof.residual <= 1e-8


@pytest.mark.parametrize("count", [1, 2, 5, 40])
def test_words_of_a_certificate(count):
    """However many limits share in a conflict, some are named, and the others are counted."""
    names = [f"limit {k}" for k in range(count)]
    words = certificate(names, [np.ones(1)] * count, 7.0, 0.0).words
    assert words.count("limit ") == (count if count < 20 else MOST_PRICES) and "7 N" in words
    assert ("36 more conflict" in words) == (count == 40)


def asked(chain, state, acceleration, limits=None) -> ForceQuestion:
    """Return a question with the object's whole acceleration asked."""
    from holdfast.forces.force_question import force_question

    return force_question(chain, state, acceleration, None, None, limits, None)


def test_prices_are_slopes():
    """Of the cost by the limits, by central differences."""
    chain, state = rubber_pandas(0.8)
    margin = 0.9 * distribute(chain, state, form="margin").value
    limits = ForceLimits(least_margin=margin)
    found, h = distribute(chain, state, cost=same_weights(), limits=limits, form="effort"), 1e-4
    dear = [name for name, price in found.prices.items() if price > 1e-5]
    assert "left friction" in dear and any(name.endswith("effort") for name in dear)
    for name in (name for name in dear if name.endswith("effort")):
        values = [
            distribute(raised(chain, name, step), state, limits=limits, cost=same_weights(), form="effort").value
            for step in (-h, h)
        ]
        assert (values[0] - values[1]) / (2 * h) == pytest.approx(found.prices[name], rel=1e-4)
    values = [
        distribute(chain, state, cost=same_weights(), limits=ForceLimits(least_margin=margin + x), form="effort").value
        for x in (-h, h)
    ]
    frictions = [found.prices[f"{arm} {what}"] for arm in chain.grasps for what in ("friction", "pressing")]
    assert (values[1] - values[0]) / (2 * h) == pytest.approx(sum(frictions), rel=1e-4)


def same_weights() -> ForceCost:
    """Return the cost with the weights of the Pandas' own limits."""
    return ForceCost(effort=EFFORTS**-2.0, acceleration=0.01)


def raised(chain, name, step):
    """Return the chain with one effort limit raised."""
    arm, joint = name.removesuffix(" effort").split("/")
    k = chain.joint_names().index(f"{arm}/{joint}") - chain.joints[arm].start
    joints = list(chain.arms[arm].joints)
    joints[k] = replace(joints[k], effort_limit=joints[k].effort_limit + step)
    return replace(chain, arms={**chain.arms, arm: replace(chain.arms[arm], joints=joints)})


def test_least_peak():
    """A little less of every drive is too little, a little more is enough."""
    chain, state = rubber_pandas(0.8)
    peak = least_peak(chain, state, 3.0 * UP)
    assert np.abs(peak.tau / EFFORTS).max() == pytest.approx(peak.value, rel=1e-5)
    for share, status in ((0.999, "infeasible"), (1.001, "optimal")):
        limits = ForceLimits(effort=share * peak.value)
        assert distribute(chain, state, 3.0 * UP, limits=limits, form="effort").status == status


def test_lift_margin():
    """A little less of the acceleration is possible, a little more is not; likewise of the payload."""
    chain, state = rubber_pandas(0.8)
    most = lift_margin(chain, state, UP)
    np.testing.assert_allclose(most.object_acceleration, most.value * UP, atol=1e-4)
    for share, status in ((0.999, "optimal"), (1.001, "infeasible")):
        assert distribute(chain, state, share * most.value * UP, form="effort").status == status
    heaviest = lift_margin(chain, state, payload=True)
    for share, status in ((0.999, "optimal"), (1.001, "infeasible")):
        loaded = replace(chain, held_object=scaled(chain.held_object, share * heaviest.value))
        assert distribute(loaded, state, form="effort").status == status
    free = replace(chain, grasps={name: hf.Grasp("rigid", grasp.frame) for name, grasp in chain.grasps.items()})
    unlimited = lift_margin(free, state, UP, limits=ForceLimits(effort=None))
    assert (unlimited.value, unlimited.status, unlimited.why) == (np.inf, "unbounded", "no limit bounds the value")
    weak = lift_margin(chain, state, UP, limits=ForceLimits(least_normal=1e5))
    assert (weak.value, weak.status) == (-np.inf, "infeasible")
    assert "conflict" in weak.why or "not enough" in weak.why


def scaled(body: hf.HeldObject, share: float) -> hf.HeldObject:
    """Return an object of the same shape and another mass."""
    return replace(body, mass=share * body.mass, inertia=share * body.inertia)


def test_largest_margin():
    """It can be demanded, and a little more cannot; more than for given accelerations of redundant joints."""
    chain, state = rubber_pandas(0.8)
    most = distribute(chain, state, form="margin")
    assert most.margin == pytest.approx(most.value, rel=1e-5)
    for share, status in ((0.999, "optimal"), (1.001, "infeasible")):
        limits = ForceLimits(least_margin=share * most.value)
        assert distribute(chain, state, limits=limits, form="effort").status == status
    held = hf.forward_dynamics(chain, state, most.tau)
    same = hf.forces.largest_margin(chain, state, held, effort_limits=True)
    assert same.margin == pytest.approx(most.value, rel=1e-5)
    unlimited = distribute(chain, state, limits=ForceLimits(effort=None), form="margin")
    assert (unlimited.value, unlimited.status) == (np.inf, "unbounded")


@pytest.mark.parametrize("name", ["least_normal", "most_normal"])
def test_bounds_on_the_normal_force(name):
    """The force along the normal is within the bound of that grasp."""
    chain, state = rubber_pandas(0.8)
    bound = {"least_normal": 40.0, "most_normal": 15.0}[name]
    found = distribute(chain, state, limits=ForceLimits(**{name: {"left": bound}}))
    R = state.object_frame.R @ chain.grasps["left"].frame.R
    pressed = (R.T @ found.grasp_wrench[0, 3:])[2]
    if name == "least_normal":
        assert found.status == "optimal"
        assert pressed == pytest.approx(bound, abs=1e-5)
    else:  # friction needs some 18 N
        assert found.status == "infeasible"
        assert "most normal force of left" in found.why


def test_wrench_change():
    """No wrench differs from the last by more than allowed."""
    chain, state = rubber_pandas(0.8)
    last = distribute(chain, state, limits=ForceLimits(least_margin=20.0)).grasp_wrench
    found = distribute(chain, state, limits=ForceLimits(last_wrench=last, wrench_change=2.0))
    step = (found.grasp_wrench - last) / np.repeat([0.15, 1.0], 3)
    sizes = np.linalg.norm(step, axis=1)
    assert found.status == "optimal"
    np.testing.assert_allclose(sizes, 2.0, rtol=1e-5)  # the cheapest wrenches are farther away


def test_acceleration_limits():
    """Redundant joints keep their bounds while the object accelerates as asked."""
    chain, state = rubber_pandas(0.8)
    free = distribute(chain, state, UP)
    j = int(np.abs(free.qdd).argmax())
    name, bound = chain.joint_names()[j], 0.9 * abs(free.qdd[j])
    found = distribute(chain, state, UP, limits=ForceLimits(acceleration={name: (-bound, bound)}))
    assert found.status == "optimal"
    assert abs(found.qdd[j]) <= bound * (1 + 1e-8)
    np.testing.assert_allclose(found.object_acceleration, UP, atol=1e-10)


def test_wished_null_motion():
    """A wished acceleration that the object leaves free is taken, at a small weight of the rest."""
    chain, state = rubber_pandas(0.8)
    basis = hf.dynamics.motion_basis(chain, state)[:14]
    wish = 5.0 * basis[:, np.abs(hf.dynamics.motion_basis(chain, state)[14:20]).sum(axis=0).argmin()]
    before = distribute(chain, state)
    found = distribute(chain, state, cost=ForceCost(joint_acceleration=wish, acceleration=100.0))
    assert np.linalg.norm(found.qdd - wish) < np.linalg.norm(before.qdd - wish)
    pressed = distribute(chain, state, cost=ForceCost(wish=np.tile([0, 0, 0, 0, 0, 50.0], (2, 1)), wrench=100.0))
    R = state.object_frame.R @ chain.grasps["left"].frame.R
    assert (R.T @ pressed.grasp_wrench[0, 3:])[2] == pytest.approx(50.0, abs=0.1)


@pytest.mark.parametrize("seed", range(40))
def test_highest_acceleration(seed):
    """By search: the largest constant acceleration after which the rate is kept and braking ends before the limit."""
    rng = np.random.default_rng(seed)
    way, qd, rate, T, brake = rng.uniform(0.0, 0.4), rng.uniform(-1, 1), 1.2, rng.uniform(1e-3, 0.1), rng.uniform(2, 20)

    def kept(x):
        after, v = way - qd * T - 0.5 * x * T * T, qd + x * T
        return v <= rate and after >= 0.0 and (v <= 0.0 or v * v <= 2 * brake * after)

    tried = np.linspace(-4.0 / T, 4.0 / T, 40001)
    possible = [x for x in tried if kept(x)]
    found = highest_acceleration(way, qd, rate, T, brake)
    if possible:
        assert found == pytest.approx(max(max(possible), -2.0 * brake), abs=2 * (tried[1] - tried[0]))


@pytest.mark.parametrize(("way", "qd"), [(-0.01, 0.0), (-0.01, 0.5), (0.01, 1.0), (0.2, 3.0)])
def test_where_no_braking_is_enough(way, qd):
    """Beyond a limit, and too fast before it, a joint brakes twice as hard as certified, not within one sample."""
    assert highest_acceleration(way, qd, 1.2, 1e-3, 10.0) == -20.0


def test_sampled_limits():
    """A joint near its limit that moves towards it brakes; without a sample time nothing limits it."""
    chain, state = two_pandas()
    wish = distribute(chain, state).qdd[:7]
    j = int(np.abs(wish).argmax())
    joints, q = list(chain.arms["left"].joints), float(state.q[j])
    joints[j] = replace(joints[j], position_limits=(q - 1.0, q + 1e-4))
    near = replace(chain, arms={**chain.arms, "left": replace(chain.arms["left"], joints=joints)})
    wish = np.r_[30.0 * wish / wish[j], np.zeros(7)]
    cost, limits = ForceCost(joint_acceleration=wish, acceleration=10.0), ForceLimits(sample_time=0.01)
    free, kept = distribute(near, state, cost=cost), distribute(near, state, cost=cost, limits=limits)
    bound = highest_acceleration(1e-4, 0.0, joints[j].rate_limit, 0.01, 10.0)
    assert free.qdd[j] > bound
    assert kept.qdd[j] <= bound * (1 + 1e-6)


@pytest.mark.slow
def test_continuous_through_the_border():
    """Half the step in the acceleration is half the step in the torques, from what is possible to what is not."""
    chain, state = rubber_pandas(0.8)
    steps = []
    for count in (20, 40):
        asked = [distribute(chain, state, a * UP) for a in np.linspace(0.0, 200.0, count + 1)]
        assert {one.status for one in asked} == {"optimal", "infeasible"}
        taus = np.array([one.tau / EFFORTS for one in asked])
        steps.append(np.abs(np.diff(taus, axis=0)).max())
    assert steps[1] == pytest.approx(0.5 * steps[0], rel=0.2)


def test_pressing_counts_above_mu_one():
    """With mu = 1.5, f_n is less than mu f_n: the margin is how hard the grasp presses."""
    chain, state = rubber_pandas(1.5)
    found = distribute(chain, state, limits=ForceLimits(least_margin=60.0))
    R = state.object_frame.R @ chain.grasps["left"].frame.R
    assert found.margin == pytest.approx(60.0, abs=1e-6)
    assert (R.T @ found.grasp_wrench[0, 3:])[2] == pytest.approx(60.0, abs=1e-5)


def test_margin_beyond_the_possible():
    """A thousand newtons of margin: the lack is what is missing, and the drives at their limits are named."""
    chain, state = rubber_pandas(0.8)
    most = distribute(chain, state, form="margin").value
    found = distribute(chain, state, limits=ForceLimits(least_margin=1e3))
    assert found.status == "infeasible"
    assert 0.0 < found.violation < 1e3 - most + 1.0
    assert "effort limit" in found.why and "friction" in found.why


def test_without_effort_limits():
    """Drives without limits, however small the price: nothing is passed that could be kept."""
    chain, state = rubber_pandas(0.8)
    arms = {
        name: replace(arm, joints=[replace(joint, effort_limit=np.inf) for joint in arm.joints])
        for name, arm in chain.arms.items()
    }
    free = replace(chain, arms=arms)
    found = distribute(free, state, cost=ForceCost(price=0.1))
    assert found.status == "optimal"
    assert found.violation == 0.0
    assert found.margin >= -1e-4


def test_unfelt_loads():
    """Forces that no joint feels are the smallest, as in forward dynamics."""
    p = as_chain(planar_three_arms(1))
    still = replace(p, state=p.state.at_rest(), inputs=hf.Inputs())
    found = distribute(still.chain, still.state, np.zeros(3), task=np.eye(6)[2:5])
    back = hf.forward_dynamics(still.chain, still.state, found.tau)
    assert back.status is Status.INDETERMINATE_FORCES
    np.testing.assert_allclose(back.grasp_wrench, found.grasp_wrench, atol=1e-9)
    np.testing.assert_allclose(back.qdd, found.qdd, atol=1e-9)


def test_lost_directions():
    """Two balls cannot turn the object about their line: refused with that line, and possible without that row."""
    chain, state = rubber_pandas(0.8)
    balls = {name: hf.Grasp("ball", g.frame, hf.Friction(0.8)) for name, g in chain.grasps.items()}
    chain = replace(chain, grasps=balls)
    with pytest.raises(StateError, match=r"cannot change it along \[omega_dot; v_dot\] = \(-?1, 0, 0, 0, 0, 0\)"):
        distribute(chain, state, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = distribute(chain, state, np.zeros(5), task=np.eye(6)[1:])
    np.testing.assert_allclose(found.object_acceleration[1:], 0.0, atol=1e-10)


def test_straight_arms():
    """What straight arms cannot follow is refused, with their names."""
    p = as_chain(two_collinear_stretched_6r(0))
    with pytest.raises(StateError, match="arm 'arm1' in 1 of 6 directions"):
        distribute(p.chain, p.state, np.ones(6), inputs=p.inputs)


def test_nobody_holds_the_object():
    """It falls, as far as nothing is asked of it; an acceleration is refused."""
    chain, state = two_pandas()
    alone = replace(chain, grasps={})
    found = distribute(alone, state, np.zeros(0), task=np.zeros((0, 6)))
    np.testing.assert_allclose(found.object_acceleration, -9.81 * UP, atol=1e-12)
    with pytest.raises(StateError, match="no arm holds it"):
        distribute(alone, state)


def test_weightless_object():
    """Nothing to carry, nothing asked: nothing is done, although every force is at the apex of its cone."""
    chain, state = rubber_pandas(0.8)
    found = distribute(replace(chain, gravity=np.zeros(3)), state)
    assert found.status == "optimal"
    assert np.abs(found.tau / EFFORTS).max() <= 1e-5
    assert found.value <= 1e-9


def test_one_contact():
    """A single rigid grasp has no internal force: its wrench is what the object needs."""
    chain, state = two_pandas()
    alone = replace(chain, grasps={"left": chain.grasps["left"]})
    found = distribute(alone, state)
    assert found.grasp_wrench[0, 5] == pytest.approx(WEIGHT, rel=1e-12)
    assert not found.grasp_wrench[1].any()


WRONG = [
    ({"acceleration": [1.0, 2.0]}, StateError, r"acceleration: expected shape \(6,\)"),
    ({"task": [1.0, 2.0]}, StateError, r"task: expected shape \(r, 6\)"),
    ({"task": np.full((1, 6), np.nan)}, StateError, "task: "),
    ({"form": "margin", "limits": ForceLimits(least_margin=1.0)}, StateError, "expected none with form='margin'"),
    ({"form": "best"}, StateError, "form: expected one of elastic, effort, margin"),
    ({"limits": ForceLimits(least_margin={"middle": 1.0})}, ModelError, "no grasp 'middle'"),
    ({"limits": ForceLimits(acceleration={"left/joint9": (0, 1)})}, ModelError, "no joint 'left/joint9'"),
    ({"limits": ForceLimits(last_wrench=np.zeros(3), wrench_change=1.0)}, StateError, "limits: last_wrench"),
    ({"cost": ForceCost(effort=[1.0])}, StateError, "cost: effort"),
    ({"cost": ForceCost(effort=-np.ones(14))}, StateError, "expected weights >= 0"),
    ({"cost": ForceCost(wish=np.zeros(6))}, StateError, "cost: wish"),
]


@pytest.mark.parametrize(("given", "error", "message"), WRONG)
def test_wrong_arguments(given, error, message):
    """Each is refused by its name."""
    chain, state = rubber_pandas(0.8)
    with pytest.raises(error, match=message):
        distribute(chain, state, **given)


def test_wrong_limits():
    """Limits and costs are checked where they are made."""
    for make in (
        lambda: ForceLimits(effort=-1.0),
        lambda: ForceLimits(least_margin="much"),
        lambda: ForceLimits(acceleration={"left/joint1": (1.0, 0.0)}),
        lambda: ForceLimits(sample_time=0.0),
        lambda: ForceLimits(wrench_change=1.0),
        lambda: ForceCost(wrench=0.0),
        lambda: ForceCost(price=np.nan),
    ):
        with pytest.raises(HoldfastError):
            make()
    chain, state = rubber_pandas(0.8)
    with pytest.raises(StateError, match="payload=True"):
        lift_margin(chain, state)
