"""Forward dynamics of forests as machine code: numbers of the reference, equal bits in batches, named refusals."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import Status, forest_dynamics
from holdfast.errors import MethodNotApplicable, ModelError, SingularChainError, StateError, UnknownName
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody
from tests.dynamics.tree.problems import LINK, gap, slider_crank
from tests.longer import mostly_long
from tests.oracles.forest_equations import ForestEquations
from tests.systems.humanoid import humanoid
from tests.systems.random_forests import ForestProblem, random_forest


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long(range(10), range(4)))
def test_random_forests(seed):
    """Fifty digits with nothing eliminated: ten families, generic axes and right angles, moving and at rest."""
    p = random_forest(seed)
    truth = ForestEquations(*p[1:], digits=50).solved()
    found = hf.compile(p.forest, parameters=["link_wrench"]).forward_dynamics(p.q, p.qd, p.tau, link_wrench=p.wrenches)
    assert found.rank == truth.rank
    assert gap(found.qdd, truth.qdd) <= (1e-8 if "_light_" in p.name else 1e-9)
    if found.status is Status.OK:
        assert gap(found.closure_wrench, truth.closure_wrench) <= 1e-9
        assert gap(found.coupling_force, truth.coupling_force) <= 1e-9
    assert found.status is (Status.OK if truth.rank == p.forest.constraint_row_count else Status.INDETERMINATE_FORCES)
    assert found.mobility == p.forest.velocity_count - truth.rank


@pytest.fixture(scope="module")
def problem():
    """A small forest with quaternions, an object and a closed loop."""
    return random_forest(13)


@pytest.fixture(scope="module")
def compiled(problem):
    return hf.compile(problem.forest)


def several(p, count=7):
    """Return a batch of inputs near those of a problem; quaternions stay as they are."""
    random = np.random.default_rng(5)
    return [np.array([x + s for s in random.normal(scale=1e-3, size=count)]) for x in (p.qd, p.tau)]


def test_same_bits(problem, compiled):
    """Single, bound, batch, threads, results to be overwritten, pickled: one text, the same bits."""
    p, (qd, tau) = problem, several(problem)
    batch = compiled.forward_dynamics(p.q, qd, tau)
    threads = compiled.forward_dynamics(p.q, qd, tau, threads=2)
    other = pickle.loads(pickle.dumps(compiled)).forward_dynamics(p.q, qd, tau)
    bound, out = compiled.bind(), compiled.forward_dynamics(p.q, p.qd, p.tau)
    for i in range(len(qd)):
        single = compiled.forward_dynamics(p.q, qd[i], tau[i], out=out)
        assert single is out
        bound.q[...], bound.qd[...], bound.tau[...] = p.q, qd[i], tau[i]
        assert bound() is single.status
        for name in ("qdd", "closure_wrench", "coupling_force", "condition"):
            rows = [np.asarray(getattr(of, name))[i] for of in (batch, threads, other)]
            assert all((row == getattr(single, name)).all() for row in rows), name
            assert np.all(getattr(bound.result, name) == getattr(single, name))
    wanted = forest_dynamics(p.forest, p.q, qd[0], tau[0], check=False)
    assert gap(batch.qdd[0], wanted.qdd) <= 1e-12
    assert (batch.rank == wanted.rank).all()


def test_inputs(problem, compiled):
    """Wrong shapes, numbers, quaternions and names are refused by name; in a batch such systems have no answer."""
    p = problem
    with pytest.raises(StateError, match="qd: expected shape"):
        compiled.forward_dynamics(p.q, p.qd[1:], p.tau)
    with pytest.raises(StateError, match="tau: expected finite numbers, got nan"):
        compiled.forward_dynamics(p.q, p.qd, p.tau * np.nan)
    free = next(k for k, body in enumerate(p.forest.bodies) if body.joint.of_kind.pose)
    at = p.forest.positions[free].start
    q = np.array([p.q, p.q])
    q[1, at : at + 4] *= 1.1
    with pytest.raises(StateError, match="expected a unit quaternion"):
        compiled.forward_dynamics(q[1], p.qd, p.tau)
    found = compiled.forward_dynamics(q, p.qd, p.tau)
    assert found.status[1] is Status.INVALID and np.isnan(found.qdd[1]).all()
    assert found.status[0] is Status.OK and np.isfinite(found.qdd[0]).all()
    with pytest.raises(StateError, match="link_wrench: expected none; try"):
        compiled.forward_dynamics(p.q, p.qd, p.tau, link_wrench=p.wrenches)
    with pytest.raises(MethodNotApplicable, match="generic_rank: expected its default for a forest"):
        hf.compile(p.forest, generic_rank=3)
    with pytest.raises(StateError, match="no optional parameter 'link_inertia'"):
        hf.compile(p.forest, parameters=["link_inertia"])
    with pytest.raises(StateError, match="out: expected a result of one system, got one of a batch"):
        compiled.forward_dynamics(p.q, p.qd, p.tau, out=found)


def test_angles():
    """Angles beyond 1e5 rad are refused."""
    pendulum = hf.compile(Forest([ForestBody(LINK, BodyJoint(axis=[0, 1, 0]))]))
    with pytest.raises(StateError, match="q: expected angles of at most 100000 rad, got 1e"):
        pendulum.forward_dynamics([1e6], [0.0], [0.0])
    assert pendulum.forward_dynamics([1e4], [0.0], [0.0]).status is Status.OK


def test_springs():
    """Springs and dampers in joints act as in the reference, in limbs and outside."""
    p = random_forest(9)
    bodies = [
        replace(b, joint=replace(b.joint, stiffness=3.0 + k, rest=0.2, damping=0.5))
        if b.joint.of_kind.freedoms == 1
        else b
        for k, b in enumerate(p.forest.bodies)
    ]
    forest = replace(p.forest, bodies=bodies)
    found = hf.compile(forest).forward_dynamics(p.q, p.qd, p.tau)
    wanted = forest_dynamics(forest, p.q, p.qd, p.tau)
    assert gap(found.qdd, wanted.qdd) <= 1e-11
    assert gap(found.qdd, forest_dynamics(p.forest, p.q, p.qd, p.tau).qdd) > 1e-3


def test_singular():
    """A stretched slider-crank has the reference's error alone, and a status in a batch."""
    forest = slider_crank()
    code = hf.compile(forest)
    n = forest.velocity_count
    q, none = np.zeros(forest.position_count), np.zeros(n)
    moving = np.array([1.0, *none[1:]])
    with pytest.raises(SingularChainError):
        forest_dynamics(forest, q, moving, none, check=False)
    with pytest.raises(SingularChainError):
        code.forward_dynamics(q, moving, none)
    found = code.forward_dynamics(np.array([q, q]), np.array([none, moving]), none)
    assert [*found.status] == [Status.INDETERMINATE_FORCES, Status.SINGULAR]
    assert np.isnan(found.qdd[1]).all() and np.isinf(found.condition[1])


def test_no_inertia():
    """A joint with nothing beyond it that resists is named as by the reference."""
    bodies = [ForestBody(LINK, BodyJoint()), ForestBody(hf.Link(0.0), BodyJoint(), 0)]
    with pytest.raises(ModelError, match="no inertia beyond its revolute joint"):
        hf.compile(Forest(bodies)).forward_dynamics([0.1, 0.2], [0.0, 0.0], [0.0, 0.0])


@pytest.mark.slow
def test_humanoid():
    """29 joints, feet on the ground and a box in its hands: accelerations and wrenches in fifty digits; operations."""
    p = humanoid()
    truth = ForestEquations(*p[1:], digits=50).solved()
    code = hf.compile(p.forest)
    found = code.forward_dynamics(p.q, p.qd, p.tau)
    assert found.rank == 24 and found.mobility == 17
    assert gap(found.qdd, truth.qdd) <= 1e-12
    assert gap(found.closure_wrench, truth.closure_wrench) <= 1e-12
    assert code.operation_count <= 27_100


@pytest.mark.slow
@pytest.mark.parametrize("what", ["legs", "arms"])
def test_linear(what):
    """Further legs, or arms, cost the same number of operations each."""
    from holdfast.compiled.forest import CompiledForest

    counts = [
        CompiledForest(humanoid(**{"legs": 2, "arms": 2, what: n}).forest).function.schedule().operation_count
        for n in (3, 4, 5)
    ]
    assert counts[2] - counts[1] == counts[1] - counts[0] > 0


def test_what_is_not_among_results(problem):
    """The accelerations of all bodies, say: an error of ours, which is Python's too."""
    found = hf.compile(problem.forest).forward_dynamics(problem.q, problem.qd, problem.tau)
    with pytest.raises(UnknownName, match="'CompiledForestResult' object has no attribute 'acceleration'"):
        _ = found.acceleration
    assert not hasattr(found, "acceleration")


def test_closure_kinds():
    """A closure whose contact point moves on the limb's last body is solved joint by joint."""
    kinds = ["rigid", "ball", "hinge"]
    for kind in kinds:
        bodies = [ForestBody(LINK, BodyJoint(axis=axis), k - 1 if k else None) for k, axis in enumerate(np.eye(3))]
        place = hf.Pose.translation(0.3, 0.1, 0.2)
        forest = Forest([*bodies, ForestBody(LINK, BodyJoint("free"))], [])
        q = np.array([0.3, -0.4, 0.7, 1.0, 0, 0, 0, 0.5, 0.2, 0.1])
        poses = forest.poses(q)
        closure = Closure(3, 2, hf.Grasp(kind, place), poses[3].inverse() @ poses[2] @ place)
        p = ForestProblem("", Forest(forest.bodies, [closure]), q, np.zeros(9), np.ones(9), np.zeros((4, 6)))
        found = hf.compile(p.forest).forward_dynamics(p.q, p.qd, p.tau)
        wanted = forest_dynamics(*p[1:])
        assert found.rank == wanted.rank
        assert gap(found.qdd, wanted.qdd) <= 1e-12
