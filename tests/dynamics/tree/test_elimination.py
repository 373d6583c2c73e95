"""The elimination of forests against many digits, a dense second opinion, and what must hold for every forest."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.dynamics import Status
from holdfast.dynamics.tree import belief
from holdfast.dynamics.tree.elimination import eliminated, solved
from holdfast.dynamics.tree.forest_dynamics import FOREST_METHODS, forest_dynamics
from holdfast.dynamics.tree.forest_motion import ForestMotion, forest_motion
from holdfast.dynamics.tree.plan import plan_of
from holdfast.errors import MethodNotApplicable, ModelError, SingularChainError, StateError
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from tests.dynamics.tree.test_plan import cases
from tests.longer import mostly_slow
from tests.oracles.forest_equations import ForestEquations
from tests.systems.random_forests import random_forest

LINK = hf.Link(1.0, [0.3, 0.0, 0.0], np.eye(3) * 0.02)


def gap(found, wanted) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return float(np.abs(found - wanted).max(initial=0.0)) / max(1.0, float(np.abs(wanted).max(initial=0.0)))


def bar(name: str) -> float:
    """Return the largest error that a case may have."""
    return 1e-8 if "light" in name else 1e-9


def motion_of(case) -> ForestMotion:
    """Return a stored forest in motion."""
    damping = np.concatenate([np.full(b.joint.of_kind.freedoms, b.joint.damping) for b in case.forest.bodies])
    return forest_motion(case.forest, case.q, case.qd, case.tau - damping * case.qd, case.wrenches)


@pytest.mark.parametrize("method", mostly_slow(["sequential", "kkt"], ["sequential"]))
def test_stored_forests(method):
    """Sixty forests in ten families: accelerations, forces, the least ones where they are not unique, and ranks."""
    for case, notes in cases():
        found, e = forest_dynamics(case.forest, case.q, case.qd, case.tau, case.wrenches, method=method), case.expected
        errors = [
            gap(found.qdd, np.concatenate(e.qdd)),
            gap(found.acceleration, e.alpha),
            gap(found.closure_wrench, e.f),
            gap(found.coupling_force, e.coupling),
        ]
        assert max(errors) <= bar(case.name), (case.name, errors)
        assert (found.rank, found.mobility) == (notes["rank"], notes["mobility"]), case.name
        assert (found.status is Status.OK) == notes["f_unique"], case.name


def test_every_joint_a_step():
    """Without leaves, where every joint is a step of its own, ranks and accelerations are the same."""
    for case, notes in cases():
        motion = motion_of(case)
        found = eliminated(motion, plan_of(case.forest.topology, leaves=False))
        pairs = zip(motion.bodies, found.beta, strict=True)
        alpha = [body.true_acceleration(beta, case.forest.gravity) for body, beta in pairs]
        assert gap(alpha, case.expected.alpha) <= bar(case.name), case.name
        assert found.rank == notes["rank"], case.name


@pytest.mark.parametrize("seed", mostly_slow([*range(60), 699], [*range(0, 60, 3), 699]))
def test_fifty_digits(seed):
    """Random forests, with closures of every kind, against equations in which nothing is eliminated."""
    p = random_forest(seed)
    truth, found = ForestEquations(*p[1:], digits=50).solved(), forest_dynamics(*p[1:])
    assert found.rank == truth.rank
    errors = [gap(getattr(found, name), getattr(truth, name)) for name in truth._fields[:4]]
    assert max(errors) <= bar(p.name), errors


@cache
def traps() -> list:
    """Return the stored forests with loops of hinges and over-constrained hands, whose rows may be only rounding."""
    return [(case, notes) for case, notes in cases() if case.name.startswith(("inner_loops", "trunk_hands"))]


def test_size_of_a_row_is_not_its_own_variance(monkeypatch):
    """The rows of a planar loop that only rounding fills look independent beside their own variance.

    Sizes are traces of blocks; with the variance of the row itself as its size, ranks would be wrong.
    """

    def own_variance(now: belief.Belief, on, count: int) -> np.ndarray:
        P = now.factors
        F = [now.coefficients(on, count) @ w for w in P.w]
        return sum((D * f * f for D, f in zip(P.D, F, strict=True)), start=np.zeros(count))

    monkeypatch.setattr(belief.Belief, "sizes_of", own_variance)
    wrong = [
        case.name for case, n in traps() if eliminated(motion_of(case), plan_of(case.forest.topology)).rank != n["rank"]
    ]
    assert len(wrong) >= 5  # these forests are a trap
    monkeypatch.undo()
    for case, notes in traps():
        assert eliminated(motion_of(case), plan_of(case.forest.topology)).rank == notes["rank"], case.name


def test_rows_in_pivot_order(monkeypatch):
    """In the given order, the rows of over-constrained hands cost digits, which they do not in the order of pivots."""
    p = random_forest(91)
    motion, plan = motion_of(p), plan_of(p.forest.topology, leaves=False)
    truth = ForestEquations(*p[1:], digits=50).solved()
    rates = [part for part, body in zip(p.forest.velocities, motion.bodies, strict=True) if not body.floats]

    def error() -> float:
        found = eliminated(motion, plan).qdd
        jointed = [x for x, body in zip(found, motion.bodies, strict=True) if not body.floats]
        return gap(np.concatenate(jointed), np.concatenate([truth.qdd[part] for part in rates]))

    in_order = error()
    monkeypatch.setattr(belief, "first_by", lambda variance, table: (table[0], table[1:], [False] * (len(table) - 1)))
    assert error() > 10 * in_order


@pytest.mark.parametrize("seed", [101, 341])
def test_large_forces_that_balance(seed):
    """A heavy object costs the accelerations of light fingers digits, which a pass at rest brings back."""
    p = random_forest(seed)
    motion, plan, truth = motion_of(p), plan_of(p.forest.topology), ForestEquations(*p[1:], digits=50).solved()

    def error(found) -> float:
        pairs = zip(motion.bodies, found.beta, strict=True)
        return gap([body.true_acceleration(beta, p.forest.gravity) for body, beta in pairs], truth.acceleration)

    assert error(eliminated(motion, plan)) > 1e-10
    assert error(solved(motion, plan)) < 1e-13


@pytest.mark.parametrize("seed", mostly_slow([3, 5, 9, 12, 24, 37, 48], [3, 24]))
def test_responses_are_symmetric(seed):
    """At rest, the acceleration along one rate by a unit force along another is the same the other way round."""
    p = random_forest(seed)
    forest = Forest(p.forest.bodies, p.forest.closures, p.forest.couplings, np.zeros(3))
    n = forest.velocity_count
    response = np.array([forest_dynamics(forest, p.q, np.zeros(n), unit).qdd for unit in np.eye(n)])
    assert gap(response, response.T) < 1e-10
    assert np.linalg.eigvalsh((response + response.T) / 2)[0] > -1e-9 * np.abs(response).max()


def slider_crank(rate: float) -> tuple[Forest, list[float]]:
    """Return two bars in line, pinned at the far end, and rates that turn them out of line."""
    bodies = [
        ForestBody(LINK, BodyJoint()),
        ForestBody(LINK, BodyJoint(placement=hf.Pose(np.eye(3), [1.0, 0.0, 0.0])), 0),
    ]
    pin = Closure(None, 1, hf.Grasp("ball", hf.Pose(np.eye(3), [1.0, 0.0, 0.0])), hf.Pose(np.eye(3), [2.0, 0.0, 0.0]))
    return Forest(bodies, [pin]), [rate, -2.0 * rate]


def test_singular_posture_in_motion():
    """Bars in line cannot keep turning about three points of a line: no acceleration satisfies the closure."""
    forest, qd = slider_crank(1.0)
    for method in FOREST_METHODS:
        with pytest.raises(SingularChainError, match="rank 1 of 3"):
            forest_dynamics(forest, [0.0, 0.0], qd, [0.0, 0.0], method=method)


def test_locked_joint():
    """A coupling of one term locks a joint, and its multiplier is the torque that holds it."""
    forest = Forest([ForestBody(LINK, BodyJoint(axis=[0.0, 1.0, 0.0]))], couplings=[JointCoupling([(0, 0, 2.0)])])
    found = forest_dynamics(forest, [0.0], [0.0], [0.0])
    assert found.qdd == pytest.approx([0.0], abs=1e-15)
    assert 2.0 * found.coupling_force == pytest.approx([-9.81 * 0.3])
    assert (found.rank, found.mobility) == (1, 0)


def test_gear():
    """Two wheels geared 1 : -2 move like one with the inertia 1 + 1/4 of theirs, referred to the first."""
    wheel = hf.Link(1.0, np.zeros(3), np.eye(3) * 0.5)
    forest = Forest(
        [ForestBody(wheel, BodyJoint()), ForestBody(wheel, BodyJoint())],
        (),
        [JointCoupling([(0, 0, 1.0), (1, 0, 2.0)])],
    )
    found = forest_dynamics(forest, [0.0, 0.0], [0.0, 0.0], [1.0, 0.0])
    assert found.qdd == pytest.approx([1 / 0.625, -0.5 / 0.625])


def test_free_forest():
    """Bodies without closures fall, and one on a joint swings."""
    bodies = [
        ForestBody(hf.Link(2.0, [0.1, 0.2, 0.0], np.eye(3) * 0.1), BodyJoint("free")),
        ForestBody(LINK, BodyJoint(axis=[0.0, 1.0, 0.0])),
    ]
    found = forest_dynamics(Forest(bodies), [1, 0, 0, 0, 0, 0, 0, 0], np.zeros(7), np.zeros(7))
    np.testing.assert_allclose(found.acceleration[0], [0, 0, 0, 0, 0, -9.81], atol=1e-14)
    assert found.qdd[6] == pytest.approx(9.81 * 0.3 / (0.02 + 0.09))
    assert (found.rank, found.mobility, found.closure_wrench.shape) == (0, 7, (0, 6))


def test_massless_link():
    """A joint with nothing beyond it while the closures are open is refused by its body's name."""
    rod = hf.Link(0.0, name="rod")
    bodies = [
        ForestBody(LINK, BodyJoint()),
        ForestBody(rod, BodyJoint(placement=hf.Pose(np.eye(3), [1.0, 0.0, 0.0])), 0),
    ]
    with pytest.raises(ModelError, match="body 1 'rod': no inertia beyond its revolute joint"):
        forest_dynamics(Forest(bodies), [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"method": "rccfd1"}, MethodNotApplicable, "no method 'rccfd1' for a forest"),
        ({"q": [0.0]}, StateError, "q: expected shape"),
        ({"qd": [0.0, np.inf]}, StateError, "qd"),
        ({"tau": None}, StateError, "tau"),
        ({"q": [0.3, 0.0]}, StateError, "closure 0: position gap"),
        ({"qd": [0.3, 0.0]}, StateError, "closure 0: .*velocity gap 0.6"),
        ({"wrenches": np.zeros((3, 6))}, StateError, "wrenches"),
        ({"forest": "none"}, ModelError, "forest"),
    ],
)
def test_refusals(change, error, message):
    """What is wrong is said, with what was expected."""
    forest, _ = slider_crank(0.0)
    with pytest.raises(error, match=message):
        forest_dynamics(**({"forest": forest, "q": [0.0, 0.0], "qd": [0.0, 0.0], "tau": [0.0, 0.0]} | change))


@pytest.mark.parametrize(
    "ask",
    [
        lambda f: hf.forward_dynamics(f, None, None),
        lambda f: hf.inverse_dynamics(f, None, None, None),
        lambda f: hf.diagnose(f, None),
        lambda f: hf.close(f, None),
        lambda f: hf.linearise(f, None, None),
        lambda f: hf.simulate(f, None, None, duration=1.0, step=0.1),
        lambda f: hf.compile_rollout(f, None),
    ],
)
def test_other_questions(ask):
    """What is asked of chains refuses a forest by name."""
    with pytest.raises(ModelError, match=r"expected (a )?ClosedChain, got Forest"):
        ask(slider_crank(0.0)[0])


def test_quaternions():
    """The quaternion of a joint has unit length; a coupling's rates are checked, too."""
    forest = Forest([ForestBody(LINK, BodyJoint("spherical"))], couplings=[JointCoupling([(0, 1, 1.0)])])
    with pytest.raises(StateError, match="q of body 0: expected a unit quaternion"):
        forest_dynamics(forest, [2.0, 0.0, 0.0, 0.0], np.zeros(3), np.zeros(3))
    with pytest.raises(StateError, match=r"coupling 0: rate 0\.5"):
        forest_dynamics(forest, [1.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0], np.zeros(3))
    assert forest_dynamics(forest, [1.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0], np.zeros(3), check=False).rank == 1


@pytest.mark.parametrize("seed", mostly_slow([2, 4, 9, 13], [2]))
def test_traced(seed):
    """The text runs on traced scalars as it is: the traced program gives the same numbers, ranks included."""
    p = random_forest(seed)

    def found(*given) -> tuple:
        solution = eliminated(forest_motion(p.forest, *given), plan_of(p.forest.topology))
        wrenches = np.concatenate([np.zeros(0), *solution.wrenches])
        return np.concatenate(solution.qdd), wrenches, solution.rank

    program = trace(found, [x.shape for x in p[2:]])
    for traced, plain in zip(interpret(program, *p[2:]), found(*p[2:]), strict=True):
        assert gap(traced, plain) < 1e-11
