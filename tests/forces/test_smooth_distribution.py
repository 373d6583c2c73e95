"""Torques at a barrier: the optimality conditions of another text, derivatives beside differences, and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import MethodNotApplicable, SingularChainError, StateError
from holdfast.forces import ForceCost, ForceLimits, distribute, least_peak, lift_margin
from holdfast.forces.force_question import force_question
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.spatial.second_order_cone import cone_inverse
from tests.capabilities.chains import chain_with
from tests.control.two_pandas import two_pandas
from tests.longer import mostly_long, mostly_slow
from tests.systems.as_chain import Problem, as_chain
from tests.systems.limited import limited_problem
from tests.systems.special_systems import planar_parallelogram, two_collinear_stretched_6r

MU = 1e-5
SMOOTH = ForceCost(barrier=MU)
SEEDS = mostly_slow(range(12), (0, 4))
DIFFERENCES = [*mostly_slow((16, 43), ()), *mostly_long(range(300), ())]
ROWS = np.eye(6)[[0, 2, 3, 4, 5]] + 0.1
ASKED = [(None, None), (ROWS, None), (None, 10.0)]
SCATTER = 1e-5  # of differences at two steps, at most
NINE_POINTS = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
RESULTS = ("tau", "qdd", "grasp_wrench", "violation")


def problem(seed: int) -> tuple[Problem, Array]:
    """Return a random question about arms in the world: kept limits and conflicting ones, all kinds of grasps."""
    return limited_problem(seed, trunks=False), 2.0 * np.random.default_rng([seed, 43]).normal(size=6)


@pytest.mark.parametrize(("task", "weight"), ASKED, ids=["all", "rows", "weight"])
@pytest.mark.parametrize("seed", SEEDS)
def test_slope_along_every_motion(seed, task, weight):
    """cost + price v + v^2 / 2 - mu log (all slacks) has no slope along the motions of the reference's map.

    mu / s loses the digits that s has not: 1e-3 leaves enough of them where limits conflict.
    """
    (p, wanted), mu, smooth = problem(seed), 1e-3, ForceCost(barrier=1e-3, task=weight)
    falling = wanted - np.r_[np.zeros(3), p.chain.gravity]
    price = smooth.price * (1.0 + (0.0 if weight is None else 1e-3 * weight**2 * falling @ falling))
    wanted = wanted if task is None else task @ wanted
    found = distribute(p.chain, p.state, wanted, task=task, cost=smooth, inputs=p.inputs)
    asked = force_question(p.chain, p.state, wanted, task, smooth, None, p.inputs)
    of, size = asked.found, asked.found.force
    v, extra = np.zeros(len(of.v0)), found.violation / size
    v[of.qdd], v[of.alpha] = found.qdd, found.object_acceleration
    for one in of.grasps:
        v[one.part] = one.contact.K @ found.grasp_wrench[one.row]
    np.testing.assert_allclose(of.N @ np.linalg.lstsq(of.N, v - of.v0)[0], v - of.v0, atol=1e-9 * np.abs(v).max())
    slope, of_v = of.N.T @ (asked.costs.Q.T @ (asked.costs.Q @ v + asked.costs.r)), price + extra - mu / extra
    sizes = np.abs(slope)
    for limit in asked.limits:
        unit = 1.0 / (limit.weight * size)
        s = unit * (limit.h - limit.G @ v)
        z = mu * cone_inverse(s + extra * np.eye(len(s))[0])
        slope, of_v = slope + of.N.T @ (unit * limit.G.T @ z), of_v - z[0]
        sizes = np.maximum(sizes, np.abs(of.N.T @ (unit * limit.G.T @ z)))
    assert np.abs(slope).max() < 1e-6 * max(1.0, sizes.max())
    assert abs(of_v) < 1e-6 * price


def test_further_from_the_least_cost_by_mu():
    """The cost exceeds the least by at most mu for each condition, and torques move in proportion to mu."""
    p, wanted = problem(4)
    exact = distribute(p.chain, p.state, wanted, inputs=p.inputs)
    near = [distribute(p.chain, p.state, wanted, cost=ForceCost(barrier=mu), inputs=p.inputs) for mu in (1e-5, 1e-6)]
    count = 1 + len(force_question(p.chain, p.state, wanted, None, None, None, p.inputs).limits)
    assert all(0.0 < one.value - exact.value < count * mu for one, mu in zip(near, (1e-5, 1e-6), strict=True))
    far, nearer = (np.abs(one.tau - exact.tau).max() for one in near)
    assert 5.0 < far / nearer < 15.0
    assert near[0].margin > exact.margin - 1e-9
    costly = {name for name, price in exact.prices.items() if price > 1e-3}
    assert costly
    assert all(near[1].prices[name] == pytest.approx(exact.prices[name], rel=1e-2) for name in costly)


def test_limits_that_could_be_kept():
    """Without a barrier the price is raised until they are; with one, the answer says what to raise."""
    case = chain_with("friction cones and wrench limits")
    kept = distribute(case.chain, case.state, np.zeros(6), inputs=case.inputs)
    assert (kept.status, kept.violation) == ("optimal", 0.0)
    low, high = (
        distribute(case.chain, case.state, np.zeros(6), cost=ForceCost(price=price, barrier=MU), inputs=case.inputs)
        for price in (1e3, 1e7)
    )
    assert low.violation > 1.0 and "limits give way, but could be kept: try a higher price" in low.why
    assert high.violation < 1e-3 and "all limits are kept" in high.why


@pytest.mark.parametrize("seed", DIFFERENCES)
def test_differences(seed):
    """Rates along a motion of everything are differences of `distribute`; gradients are their adjoint."""
    p, wanted = problem(seed)
    random, s, n = np.random.default_rng([seed, 5]), p.state, p.chain.joint_count
    along = {"q": n, "qd": n, "object_pose": 6, "object_twist": 6, "acceleration": 6}
    along = {name: random.normal(size=size) for name, size in along.items()}

    def at(h: float) -> Any:
        turn, shift = h * along["object_pose"][:3], h * along["object_pose"][3:]
        pose = hf.Pose(rotation.exp(turn) @ s.object_frame.R, s.object_frame.p + shift)
        moved = hf.State(s.q + h * along["q"], s.qd + h * along["qd"], pose, s.object_twist + h * along["object_twist"])
        return distribute(p.chain, moved, wanted + h * along["acceleration"], cost=SMOOTH, inputs=p.inputs)

    rates = distribute.jvp(p.chain, s, wanted, cost=SMOOTH, inputs=p.inputs, along=along)
    sizes = {name: max(1.0, np.abs(rates[name]).max()) for name in RESULTS}

    def measured(step: float) -> dict[str, Array]:
        far = [(w, at(k * step), at(-k * step)) for k, w in NINE_POINTS.items()]
        return {
            name: sum(w * (np.asarray(getattr(a, name)) - getattr(b, name)) for w, a, b in far) / step / sizes[name]
            for name in RESULTS
        }

    # Differences scatter by rounding where limits conflict, the more the shorter the step is.
    off, before = dict.fromkeys(RESULTS, np.inf), measured(3e-3)
    for step in (1e-3, 1e-4, 1e-5):
        found = measured(step)
        for name in RESULTS:
            scatter = np.abs(found[name] - before[name]).max()
            error = np.abs(found[name] - rates[name] / sizes[name]).max()
            off[name] = min(off[name], max(0.0, error - scatter) if scatter < SCATTER else error)
        before = found
        if max(off.values()) < 1e-7:
            break
    assert max(off.values()) < 1e-7

    bars: dict[str, Any] = {name: random.normal(size=np.shape(rates[name])) for name in RESULTS}
    gradients = distribute.vjp(p.chain, s, wanted, cost=SMOOTH, inputs=p.inputs, by=tuple(along), **bars)
    parts = [float(np.sum(gradients[name] * x)) for name, x in along.items()]
    forward = sum(float(np.sum(bar * rates[name])) for name, bar in bars.items())
    assert sum(parts) == pytest.approx(forward, rel=0.0, abs=1e-9 * np.abs(parts).sum())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "weight"), [ASKED[1], pytest.param(*ASKED[2], marks=pytest.mark.slow)], ids=["rows", "weight"]
)
def test_differences_of_what_is_free(task, weight):
    """Rates along accelerations are differences where only rows S of them are asked, or where they give way.

    Of rows S a = s, it is the smallest a that moves.
    """
    p, wanted = problem(4)
    rows, cost = np.eye(6) if task is None else task, ForceCost(barrier=MU, task=weight)
    along = np.linalg.pinv(rows) @ rows @ np.array([0.3, -0.2, 0.5, 0.1, 0.4, -0.6])

    def at(h: float) -> Any:
        return distribute(p.chain, p.state, rows @ (wanted + h * along), task=task, cost=cost, inputs=p.inputs)

    given = {"task": task, "cost": cost, "inputs": p.inputs, "along": {"acceleration": along}}
    rates = distribute.jvp(p.chain, p.state, rows @ wanted, **given)
    for name in RESULTS:
        far = [(w, at(1e-4 * k), at(-1e-4 * k)) for k, w in NINE_POINTS.items()]
        slope = sum(w * (np.asarray(getattr(a, name)) - getattr(b, name)) for w, a, b in far) / 1e-4
        np.testing.assert_allclose(slope, rates[name], atol=1e-7 * max(1.0, np.abs(rates[name]).max()), err_msg=name)


def test_jacobian():
    """A row of the Jacobian is a gradient, and the answer comes with both."""
    chain, state = two_pandas("softfinger", "rigid")
    wanted = [0.3, 0.2, -0.1, 0.5, 0.4, 1.0]
    found = distribute.jacobian(chain, state, wanted, cost=SMOOTH, of=["tau"], by=["acceleration"])
    row = distribute.vjp(chain, state, wanted, cost=SMOOTH, by=["acceleration"], tau=np.eye(14)[3])
    np.testing.assert_allclose(found["tau", "acceleration"][3], row.acceleration, rtol=1e-12)
    np.testing.assert_array_equal(found.result.tau, distribute(chain, state, wanted, cost=SMOOTH).tau)


def test_refused():
    """No derivative without a barrier, and no barrier where machine code has none or where only limits count."""
    chain, state = two_pandas("softfinger", "rigid")
    bars: dict[str, Any] = {"tau": np.ones(14)}
    with pytest.raises(StateError, match=r"distribute\.vjp: barrier: expected one above 0, got 0.*ForceCost\.barrier"):
        distribute.vjp(chain, state, np.zeros(6), **bars)
    with pytest.raises(MethodNotApplicable, match="distribute: form: expected 'elastic' with a barrier"):
        distribute(chain, state, form="effort", cost=SMOOTH)
    with pytest.raises(MethodNotApplicable, match="no limit on the change of wrenches"):
        distribute(chain, state, limits=ForceLimits(last_wrench=np.zeros((2, 6)), wrench_change=1.0), cost=SMOOTH)
    with pytest.raises(StateError, match="cost: barrier: expected 0, got 1e-05: a largest margin lies on the limits"):
        distribute(chain, state, form="margin", cost=SMOOTH)
    for report in (least_peak, lift_margin):
        with pytest.raises(StateError, match="cost: barrier: expected 0"):
            report(chain, state, np.ones(6), cost=SMOOTH)


@pytest.mark.parametrize(
    ("case", "unfelt", "singular"),
    [
        (planar_parallelogram(0.5), 3, False),
        (planar_parallelogram(0.0), 4, True),
        (two_collinear_stretched_6r(0), 1, True),
    ],
)
def test_forces_that_no_joint_feels(case, unfelt, singular):
    """They are counted; a singular configuration, which forward dynamics refuses, has more of them than nearby ones."""
    p = as_chain(case)
    state = p.state.at_rest()
    found = distribute(p.chain, state)
    assert found.unfelt == unfelt
    assert f"forces that no joint feels ({unfelt}) are taken as the smallest" in found.why
    if not singular:
        back = hf.forward_dynamics(p.chain, state, found.tau)
        np.testing.assert_allclose(back.grasp_wrench, found.grasp_wrench, atol=1e-9)
        return
    with pytest.raises(SingularChainError):
        hf.forward_dynamics(p.chain, state, found.tau)


def test_torques_decide_all_forces():
    """Nothing is said where there are no such forces."""
    found = distribute(*two_pandas("softfinger", "rigid"))
    assert found.unfelt == 0
    assert "feels" not in found.why
