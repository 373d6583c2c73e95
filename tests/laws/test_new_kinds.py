"""A kind of grasp that is added as a table row, and screws and cylinders as joints, are answered by everything."""

import mpmath
import numpy as np
import pytest

import holdfast as hf
from holdfast.model.grasp_kinds import GRASP_KINDS, GraspKind
from holdfast.spatial import rotation
from holdfast.spatial.scalar import arctan2, array, concatenate, sqrt
from holdfast.spatial.vector import cross
from tests.laws.test_lower_pairs import mechanism
from tests.oracles.differenced_positions import exact, rotation_about
from tests.systems.problems import relative_gap

PITCH = 0.03  # m/rad


def cardan_axes(contact, tip):
    """A cardan joint's cross: its first axis is the tip's x, its second the object's y."""
    z = cross(tip[:, 0], contact[:, 1])
    z = z / sqrt(z @ z)
    return array([cross(contact[:, 1], z), contact[:, 1], z]).T


def cardan_turn(tip):
    """The two axes of the cross stay perpendicular."""
    sine = tip[1, 0]
    return array([0.0, 0.0, -arctan2(sine, sqrt(1.0 - sine * sine))])


def cardan_opening(tip):
    """The same as a sine, from contact to tip."""
    return concatenate([np.zeros(2), [tip[1, 0]]])


ROWS = {
    "cardan": GraspKind(
        free=(0, 1),
        carried_by=("tip", "object"),
        closed_angles=(2,),
        turn=cardan_turn,
        opening=cardan_opening,
        axes=cardan_axes,
    )
}

ARMS = {
    "left": ("revolute", "screw", "revolute", "cylindrical", "revolute", "revolute"),
    "right": ("prismatic", "revolute", "revolute", "screw", "revolute", "revolute", "revolute"),
    "third": ("revolute", "cylindrical", "revolute", "revolute", "screw"),
}
KINDS = {"left": "cardan", "right": "rigid", "third": "cardan"}


@pytest.fixture(scope="module", autouse=True)
def rows():
    """The rows, in the tables while these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        for name, row in ROWS.items():
            patch.setitem(GRASP_KINDS, name, row)
        yield


class Problem:
    """A closed chain with the new kinds, in motion, and what each joint was before it was taken apart."""

    def __init__(self) -> None:
        random = np.random.default_rng(5)

        def pose(size):
            return hf.Pose(rotation.exp(random.normal(size=3)), random.normal(size=3, scale=size))

        def inertia():
            Q = rotation.exp(random.normal(size=3))
            a, b, c = random.uniform(0.01, 0.05, 3)
            return Q @ np.diag([b + c, a + c, a + b]) @ Q.T

        def unit():
            v = random.normal(size=3)
            return v / np.linalg.norm(v)

        self.joints, arms = {}, {}
        for name, types in ARMS.items():
            pitch = {"screw": PITCH}
            joints = [hf.Joint(kind, unit(), pose(0.3), f"j{k}", pitch=pitch.get(kind)) for k, kind in enumerate(types)]
            links = [hf.Link(random.uniform(0.5, 2.0), 0.1 * unit(), inertia()) for _ in types]
            self.joints[name] = list(zip(joints, links, strict=True))
            arms[name] = hf.Arm(joints, links, pose(0.2), pose(0.5))
        body = hf.HeldObject(3.0, inertia(), 0.1 * unit())
        free = hf.ClosedChain(arms, body, {})
        q, held = random.normal(size=free.joint_count, scale=0.5), pose(0.3)
        tips = {name: hf.dynamics.tip_pose(arm, q[free.joints[name]]) for name, arm in arms.items()}
        about_x, about_y = rotation.exp(np.array([0.7, 0.0, 0.0])), rotation.exp(np.array([0.0, -0.4, 0.0]))
        turned = {name: about_x @ about_y if kind == "cardan" else np.eye(3) for name, kind in KINDS.items()}
        grasps = {
            name: hf.Grasp(kind, held.inverse() @ hf.Pose(tips[name].R @ turned[name], tips[name].p))
            for name, kind in KINDS.items()
        }
        self.chain = hf.ClosedChain(arms, body, grasps)
        rates = random.normal(size=self.chain.joint_count), random.normal(size=6)
        self.state = hf.dynamics.project_velocity(self.chain, hf.State(q, rates[0], held.wxyz_xyz, rates[1]))
        self.tau = random.normal(size=self.chain.joint_count, scale=5.0)

    def links(self, name, q):
        """Yield the links of an arm: joints as screws, cylinders in one."""
        base = self.chain.arms[name].base
        R, p, q = exact(base.R), exact(base.p), list(q)
        for joint, link in self.joints[name]:
            axis, turn, slide = exact(joint.axis), mpmath.mpf(0), mpmath.mpf(0)
            if joint.kind == "cylindrical":
                turn, slide = q.pop(0), q.pop(0)
            elif joint.kind == "prismatic":
                slide = q.pop(0)
            else:
                turn = q.pop(0)
                slide = PITCH * turn if joint.kind == "screw" else slide
            p = p + R @ (exact(joint.placement.p) + exact(joint.placement.R) @ (slide * axis))
            R = R @ exact(joint.placement.R) @ rotation_about(turn * axis)
            yield R, p, link


@pytest.fixture(scope="module")
def problem(rows):
    """The chain of this file."""
    return Problem()


@pytest.fixture(scope="module")
def truth(problem):
    """What follows from the positions."""
    y = np.concatenate([problem.state.q, np.zeros(6)])
    rates = np.concatenate([problem.state.qd, problem.state.object_twist])
    return mechanism(problem.chain, problem.state, problem.links).accelerations(
        y, rates, np.concatenate([problem.tau, np.zeros(6)])
    )


@pytest.mark.slow
def test_state_is_closed(truth):
    """The oracle's own constraints hold, in position and rate."""
    assert np.abs(truth["gap"]).max() < 1e-14
    assert np.abs(truth["rate"]).max() < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("method", ["sequential", "kkt", "nonrigid"])
def test_forward_dynamics(problem, truth, method):
    """Accelerations are those of the positions' differences."""
    n = problem.chain.joint_count
    found = hf.forward_dynamics(problem.chain, problem.state, problem.tau, method=method)
    assert relative_gap(found.qdd, truth["accelerations"][:n]) < 1e-9
    assert relative_gap(found.object_acceleration, truth["accelerations"][n:]) < 1e-9


def test_methods_for_rigid_grasps_refuse_by_name(problem):
    """The paper's methods for rigid grasps name the grasp that is none."""
    with pytest.raises(hf.errors.MethodNotApplicable, match="'left' is a cardan"):
        hf.forward_dynamics(problem.chain, problem.state, problem.tau, method="rccfd1")


def test_inverse_dynamics(problem):
    """The torques of the accelerations and wrenches found are those given."""
    found = hf.forward_dynamics(problem.chain, problem.state, problem.tau)
    tau = hf.inverse_dynamics(problem.chain, problem.state, found.qdd, found.grasp_wrench)
    assert relative_gap(tau, problem.tau) < 1e-11


def test_energies(problem, truth):
    """Kinetic energy is the oracle's."""
    assert hf.dynamics.kinetic_energy(problem.chain, problem.state) == pytest.approx(truth["energy"], rel=1e-13)


def test_projection(problem):
    """A state off the manifold is closed again, and has the rows of the new grasp."""
    chain, state = problem.chain, problem.state
    random = np.random.default_rng(2)
    off = hf.State(state.q + 1e-4 * random.normal(size=len(state.q)), state.qd, state.object_pose, state.object_twist)
    for closed in (hf.project(chain, off)[0], hf.close(chain, off)):
        gaps = hf.dynamics.closure(chain, closed)
        assert {name: len(gap.position) for name, gap in gaps.items()} == {"left": 4, "right": 6, "third": 4}
        assert max(np.abs(gap.position).max() for gap in gaps.values()) < 1e-12
        assert max(np.abs(gap.velocity).max() for gap in gaps.values()) < 1e-12


def test_machine_code(problem):
    """Compiled functions answer as the reference does."""
    chain, state = problem.chain, problem.state
    compiled = hf.compile(chain)
    given = {"q": state.q, "qd": state.qd, "object_pose": state.object_pose, "object_twist": state.object_twist}
    fast = compiled.forward_dynamics(tau=problem.tau, **given)
    found = hf.forward_dynamics(chain, state, problem.tau)
    assert relative_gap(fast.qdd, found.qdd) < 1e-11
    assert relative_gap(fast.grasp_wrench, found.grasp_wrench) < 1e-11
    assert compiled.kinetic_energy(**given) == pytest.approx(hf.dynamics.kinetic_energy(chain, state), rel=1e-12)
    expected, gaps = hf.dynamics.closure(chain, state), compiled.closure(**given)
    for name in chain.grasps:
        np.testing.assert_allclose(gaps[name].position, expected[name].position, atol=1e-14)
        np.testing.assert_allclose(gaps[name].velocity, expected[name].velocity, atol=1e-13)


@pytest.mark.slow
def test_simulation(problem):
    """A run without torques keeps energy and grasps."""
    chain = problem.chain
    run = hf.simulate(chain, problem.state, lambda t, state, memory: (np.zeros(chain.joint_count), memory), 0.2, 1e-3)
    assert run.stopped is None
    assert np.max(run.position_gap) < 1e-12
    energies = [
        hf.dynamics.kinetic_energy(chain, state) + hf.dynamics.potential_energy(chain, state)
        for state in (run.state(0), run.state(-1))
    ]
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)
