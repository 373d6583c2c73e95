"""Anchors, arms without joints: what they transmit, pendulums by their own equations, balances, in every way."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ellipk

import holdfast as hf
from holdfast.dynamics import METHODS, kinetic_energy, momentum, momentum_rate, object_mobility, power
from holdfast.dynamics.energy import bodies
from holdfast.simulation.balance import WORK_TERMS
from holdfast.spatial import rotation
from tests.laws.moving import moving
from tests.longer import mostly_long
from tests.oracles.every_body import EveryBody
from tests.simulation.rollout.problems import arrays, assert_rollout_is_run, without_torques
from tests.simulation.runs import limp
from tests.spatial.dual import slopes_of
from tests.systems.anchored import by_anchor, pinned, pinned_to_trunk
from tests.systems.as_chain import Problem
from tests.systems.problems import largest_gaps, random_problem, relative_gap
from tests.systems.trunk_problems import in_machine_code, on_trunk
from tests.systems.trunk_runs import swaying

KINDS = ("rigid", "hinge", "softfinger", "ball", "universal", "slider", "cylinder", "screw", "planar", "scara")
ANSWERS = ("qdd", "grasp_wrench", "object_acceleration", "base_wrench")
DIGITS = 50


def held_by_two(seed: int, kind: str, **options) -> Problem:
    """Return two arms on bases that move, and an anchor that moves too."""
    return pinned(random_problem(seed, joints=(7, 8), moving_base=True, **options), (kind,), seed)


@pytest.mark.slow
@pytest.mark.parametrize("kind", mostly_long(KINDS, ("hinge", "softfinger", "screw")))
def test_fifty_digits(kind):
    """Accelerations, grasp wrenches and base wrenches by the filter, the dense equations and machine code."""
    p = held_by_two(KINDS.index(kind), kind)
    oracle = EveryBody(p, DIGITS)
    expected, _ = oracle.solved()
    assert oracle.unique
    given = p.inputs.shaped(p.chain)
    fast = hf.compile(p.chain, parameters=["link_wrench"])
    acting = {"object_wrench": given.object_wrench, "link_wrench": given.link_wrenches}
    acting |= {"base_twist": given.base_twists, "base_acceleration": given.base_accelerations}
    one = fast.forward_dynamics(**arrays(p.state), tau=p.tau, **acting)
    for name in ANSWERS:
        truth = getattr(expected, name)
        assert relative_gap(getattr(p.solved(), name), truth) <= 1e-12
        assert relative_gap(getattr(p.solved(method="kkt"), name), truth) <= 1e-11
        assert relative_gap(getattr(one, name), truth) <= 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "floating"), mostly_long(itertools.product(range(3), [False, True]), [(0, True), (2, False)])
)
def test_on_a_trunk(seed, floating):
    """An anchor on a body of a trunk pins the object to it."""
    kind = ("ball", "hinge", "softfinger")[seed]
    on = on_trunk(random_problem(seed, arms=3, joints=7, moving_base=False), seed, 2, floating=floating)
    p = pinned_to_trunk(on, kind, seed)
    expected, _ = EveryBody(p, DIGITS).solved()
    found = p.solved()
    for answer in (found, p.solved(method="kkt"), in_machine_code(p)):
        assert relative_gap(answer.qdd, expected.qdd) <= 1e-11
        assert relative_gap(answer.grasp_wrench, expected.grasp_wrench) <= 1e-11
        assert relative_gap(answer.base_wrench, expected.base_wrench) <= 1e-11
    tau = hf.inverse_dynamics(p.chain, p.state, found.qdd, found.grasp_wrench, p.inputs, found.base_acceleration)
    assert relative_gap(tau, p.tau, np.abs(found.grasp_wrench).max()) <= 1e-11


@pytest.mark.parametrize("seed", range(3))
def test_an_arm_is_a_trunk_below_an_anchor(seed):
    """An arm that holds rigidly, and its joints as a trunk whose last link the object is anchored to."""
    p, anchored = by_anchor(seed)
    expected, found = p.solved(), anchored.solved()
    order = np.r_[anchored.chain.joints["arm1"], anchored.chain.joints["trunk"]]
    assert relative_gap(found.qdd[order], expected.qdd) <= 1e-11
    assert relative_gap(found.grasp_wrench, expected.grasp_wrench) <= 1e-11
    assert relative_gap(found.trunk_base_wrench, expected["arm2"].base_wrench) <= 1e-11


def test_the_papers_methods():
    """With rigid grasps every algorithm of the paper takes an anchor for an arm whose Lambda is zero."""
    p = pinned(random_problem(2, joints=(7, 8), grasps="rigid", moving_base=True), ("rigid",), 2)
    expected = p.solved()
    for method in METHODS:
        found = p.solved(method=method)
        for name in ANSWERS:
            assert relative_gap(getattr(found, name), getattr(expected, name)) <= 1e-9


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1e4, 1e8])
@pytest.mark.parametrize("kind", ["rigid", "hinge", "softfinger", "ball"])
def test_light_and_heavy_objects(kind, scale):
    """Accelerations and forces keep their digits whatever the object's mass is beside the arms'."""
    p = random_problem(4, joints=(7, 8), grasps=("rigid", "ball"), moving_base=False)
    held = p.chain.held_object
    body = replace(held, mass=scale * held.mass, inertia=scale * held.inertia)
    p = pinned(replace(p, chain=replace(p.chain, held_object=body), inputs=hf.Inputs()), (kind,), 4, moving=False)
    oracle = EveryBody(p, DIGITS)
    oracle.kept, oracle.dependent = list(range(len(oracle.system.rows))), []  # all rows, which it judges in float64
    expected, _ = oracle.solved()
    found = p.solved()
    assert relative_gap(found.qdd, expected.qdd) <= 1e-11
    assert relative_gap(found.grasp_wrench, expected.grasp_wrench) <= 1e-11


@pytest.mark.parametrize("seed", range(4))
def test_balances(seed):
    """Energy and momentum change as bases, the anchor's among them, drives and loads say; a moving anchor works."""
    p = held_by_two(seed, ("ball", "hinge", "rigid", "planar")[seed])
    found = p.solved()
    slopes = [getattr(body.kinetic_energy, "tangent", 0.0) for body in bodies(*moving(p, found))]
    armature = np.concatenate([arm.armature for arm in p.chain.arms.values()])
    supplied = power(p.chain, p.state, p.tau, found, p.inputs)
    weights = momentum(p.chain, p.state, inputs=p.inputs)[3:] @ p.chain.gravity
    rate = sum(slopes) + armature * p.state.qd @ found.qdd
    size = sum(map(abs, supplied)) + abs(weights) + kinetic_energy(p.chain, p.state, p.inputs)
    assert abs(supplied.total + weights - rate) <= 1e-11 * size
    anchors = found["pin1"].base_wrench @ p.inputs.base_twists[-1]
    assert abs(anchors) > 1e-3 * size
    chain, later, inputs = moving(p, found)
    expected = slopes_of(momentum(chain, later, None, inputs))
    assert relative_gap(momentum_rate(p.chain, p.state, found, inputs=p.inputs), expected) <= 1e-10


def test_inverse_dynamics():
    """Torques for given accelerations and wrenches; the anchor asks for none."""
    p = held_by_two(3, "ball")
    found = p.solved()
    tau = hf.inverse_dynamics(p.chain, p.state, found.qdd, found.grasp_wrench, p.inputs)
    assert relative_gap(tau, p.tau, np.abs(found.grasp_wrench).max()) <= 1e-12


BODY = hf.HeldObject(2.0, np.diag([0.03, 0.04, 0.05]), [0.1, 0.2, -0.4])
PIVOT = np.array([0.3, 0.2, 1.0])


def pendulum(kind: str = "ball", R: np.ndarray | None = None, w=(0.3, -0.4, 0.5)) -> Problem:
    """Return a body that hangs by its origin on an anchor, its grasp's x axis along the object's y; nothing else."""
    R = np.eye(3) if R is None else R
    grasp = hf.Grasp(kind, hf.Pose.from_rpy(0, 0, np.pi / 2))
    anchor = hf.Anchor(hf.Pose(R @ grasp.frame.R, PIVOT))
    chain = hf.ClosedChain({"pin": anchor}, BODY, {"pin": grasp})
    return Problem(chain, hf.State([], [], hf.Pose(R, PIVOT), [*w, 0, 0, 0]), np.zeros(0), hf.Inputs())


def about_pivot(R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return inertia about the pivot and the way to the mass centre, world axes."""
    c = R @ BODY.com
    return R @ BODY.inertia @ R.T + BODY.mass * (c @ c * np.eye(3) - np.outer(c, c)), c


def test_spherical_pendulum():
    """I dw/dt + w x I w = c x m (g - a) on a pivot that accelerates by a; the pin carries m (c'' + a - g)."""
    R, w, a = rotation.exp(np.array([0.3, -0.8, 0.5])), np.array([0.3, -0.4, 0.5]), np.array([1.0, 2.0, -0.5])
    p = pendulum("ball", R, w)
    g = p.chain.gravity
    found = replace(p, inputs=hf.Inputs(base_accelerations=[[*0 * a, *a]])).solved()
    inertia, c = about_pivot(R)
    turning = np.linalg.solve(inertia, np.cross(c, BODY.mass * (g - a)) - np.cross(w, inertia @ w))
    force = BODY.mass * (a + np.cross(turning, c) + np.cross(w, np.cross(w, c)) - g)
    assert relative_gap(found.object_acceleration, np.r_[turning, a]) <= 1e-13
    assert relative_gap(found["pin"].grasp_wrench, np.r_[0, 0, 0, force]) <= 1e-13
    assert relative_gap(found["pin"].base_wrench, np.r_[0, 0, 0, force]) <= 1e-13
    assert (found.rank, found.mobility, found.qdd.shape) == (6, 3, (0,))
    free = object_mobility(p.chain, p.state)
    assert relative_gap(free[:3, :3], np.linalg.inv(inertia)) <= 1e-13 and np.abs(free[3:]).max() <= 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("steps", ["simulate", "rollout"])
def test_period_of_a_hinged_pendulum(steps):
    """Released from rest, a body on a hinge is back after T = 4 sqrt(I / m g r) K(sin(h / 2)), h its height's angle."""
    p = pendulum("hinge", w=(0, 0, 0))
    inertia, c = about_pivot(np.eye(3))
    r = float(np.hypot(c[0], c[2]))  # about y
    height = float(np.arctan2(c[0], -c[2]))
    period = 4 * np.sqrt(inertia[1, 1] / (BODY.mass * 9.81 * r)) * ellipk(np.sin(height / 2) ** 2)
    if steps == "simulate":
        run = hf.simulate(p.chain, p.state, limp, period, period / 100, scheme="dop853", rtol=1e-12, atol=1e-13)
        pose, twist, tolerance = run.object_pose[-1], run.object_twist[-1], 1e-10
        assert np.ptp(run.kinetic + run.potential) <= 1e-11 * run.kinetic.max()
        assert run.position_gap.max() <= 1e-13 and run.kinetic.max() > 0.1
    else:
        after = without_torques(p.chain, p.state, period, period / 400)
        pose, twist, tolerance = after.object_pose[0], after.object_twist[0], 1e-7
    assert np.abs(pose - p.state.object_pose).max() <= tolerance
    assert np.abs(twist).max() <= 10 * tolerance


def test_door():
    """Two balls on a line hold like a hinge: one row of twelve follows from the others, and motion is unique."""
    R = rotation.exp(np.array([0.0, 0.2, 0.0]))
    hinge = pendulum("hinge", R, w=0.7 * (R @ [0, 1.0, 0]))
    along = [hf.Pose.translation(0, y, 0) for y in (0.0, 0.5)]
    pins = {f"pin{k}": hf.Anchor(hf.Pose(R, PIVOT) @ frame) for k, frame in enumerate(along)}
    grasps = {name: hf.Grasp("ball", frame) for name, frame in zip(pins, along, strict=True)}
    door = hf.ClosedChain(pins, BODY, grasps)
    found = hf.forward_dynamics(door, hinge.state, np.zeros(0))
    assert (found.rank, found.mobility) == (11, 1) and found.status.name == "INDETERMINATE_FORCES"
    assert relative_gap(found.object_acceleration, hinge.solved().object_acceleration) <= 1e-12
    assert abs((found["pin0"].grasp_wrench - found["pin1"].grasp_wrench) @ [0, 0, 0, *R[:, 1]]) <= 1e-12
    fast = hf.compile(door).forward_dynamics(**arrays(hinge.state), tau=np.zeros(0))
    assert relative_gap(fast.object_acceleration, found.object_acceleration) <= 1e-12
    assert hf.diagnose(door, hinge.state).mobility == 1


def still(seed: int, kind: str) -> Problem:
    """Return two arms on bases at rest, without loads, and an anchor at rest."""
    options = {"joints": (6, 7), "moving_base": False, "extras": False, "gravity": (0, 0, -9.81), "joint_speed": 0.7}
    p = random_problem(seed, grasps=("rigid", "ball"), **options)
    return replace(pinned(p, (kind,), seed, moving=False), inputs=hf.Inputs())


@pytest.mark.slow
def test_a_batch_and_bound_arrays():
    """Machine code of many systems at once, and bound to arrays, with the anchor elsewhere for each."""
    p = still(1, "ball")
    given = {**arrays(p.state), "tau": p.tau}
    expected = p.solved()
    fast = hf.compile(p.chain)
    many = fast.forward_dynamics(**{name: np.tile(x, (9, 1)) for name, x in given.items()})
    step = fast.bind(**{name: np.array(x) for name, x in given.items()})
    step()
    for name in ANSWERS:
        assert relative_gap(getattr(many, name)[8], getattr(expected, name)) <= 1e-11
        assert relative_gap(getattr(step.result, name), getattr(expected, name)) <= 1e-11
    assert fast.mass_matrix(p.state.q)["pin1"].shape == (0, 0)
    assert fast.jacobian(p.state.q)["pin1"].shape == (6, 0)
    assert fast.link_poses(p.state.q)["pin1"].p.shape == (0, 3)
    touched = p.state.object_frame @ p.chain.grasps["pin1"].frame
    assert relative_gap(fast.tip_poses(p.state.q)["pin1"].p, touched.p) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("kind", mostly_long(["ball", "hinge"], ["hinge"]))
def test_a_run(kind):
    """On an anchor that sways: what it puts in is what the chain gains, grasps stay closed; rollouts do the same."""
    p = still(2, kind)
    motion = {"pin1": swaying(p.chain.arms["pin1"].base)}
    options = {"scheme": "dop853", "rtol": 1e-12, "atol": 1e-13}
    run = hf.simulate(p.chain, p.state, limp, 0.1, 0.01, base_motion=motion, **options)
    work = run.work[:, WORK_TERMS.index("base")]
    left = run.kinetic + run.potential - run.kinetic[0] - run.potential[0] - run.work.sum(axis=1)
    assert np.abs(left).max() <= 1e-11 * run.kinetic.max() and np.abs(work).max() > 1e-3
    assert run.position_gap.max() <= 1e-12
    assert np.abs(run.momentum_imbalance).max() <= 1e-5 * np.abs(run.momentum).max()  # a quadrature over samples
    assert_rollout_is_run(p.chain, p.state, 0.02, relative_to_energy=True)


@pytest.mark.slow
def test_let_go_and_gripped():
    """An anchor lets go and grips again where the object is then, by the impulse that all grasps share."""
    p = still(3, "ball")
    grasp = p.chain.grasps["pin1"]
    events = [hf.Release(0.01, "pin1"), hf.Attach(0.02, "pin1", hf.Grasp("ball", grasp.frame), here=True)]
    run = hf.simulate(p.chain, p.state, limp, 0.03, 1e-3, events=events)
    assert run.stopped is None
    assert [bool(run.holding[k, 2]) for k in (5, 15, 25)] == [True, False, True]
    assert np.abs(run.grasp_wrench[12:18, 2]).max() == 0.0 < np.abs(run.grasp_wrench[25, 2]).max()


def test_held_still():
    """Torques that hold the chain still; what the anchor can carry no drive has to."""
    p = still(1, "ball")
    p = replace(p, state=p.state.at_rest())
    tau = hf.holding_torques(p.chain, p.state)
    assert np.abs(hf.forward_dynamics(p.chain, p.state, tau).qdd).max() <= 1e-9 * np.abs(tau).max()
    command, _ = hf.control.GravityCompensation(p.chain)(0.0, p.state, None)
    assert np.abs(hf.forward_dynamics(p.chain, p.state, command).qdd).max() <= 1e-9 * np.abs(tau).max()


def test_shares_and_wrists():
    """Internal forces keep their sum zero; what crosses an anchor's base is its base wrench in base axes."""
    p = still(4, "hinge")
    found = p.solved()
    parts = hf.forces.split(p.chain, p.state, found.grasp_wrench)
    assert relative_gap(parts.internal + parts.motion, found.grasp_wrench) <= 1e-12
    R = p.chain.arms["pin1"].base.R
    across = hf.forces.last_joint_wrenches(p.chain, p.state, found)[2]
    expected = found["pin1"].base_wrench.reshape(2, 3) @ R
    assert relative_gap(across, expected.ravel()) <= 1e-12
    assert np.isinf(hf.forces.grasp_margins(p.chain, p.state, found.grasp_wrench)).all()


def test_closing():
    """What is a little open is closed, the anchor staying where it is; an anchor out of reach is named."""
    p = still(0, "ball")
    pose = np.array(p.state.object_pose) + np.r_[np.zeros(4), 1e-2, 0, 0]
    closed = hf.close(p.chain, replace(p.state, object_pose=pose))
    assert largest_gaps(hf.dynamics.closure(p.chain, closed))[0] <= 1e-12
    near = replace(p.state, object_pose=p.state.object_pose + 1e-4 * np.eye(7)[4])
    projected = hf.project(p.chain, near)[0]
    assert largest_gaps(hf.dynamics.closure(p.chain, projected))[0] <= 1e-12
    with pytest.raises(hf.errors.ClosureError, match=r"arm 'pin1' misses its grasp by 0\.007"):
        hf.close(p.chain, replace(p.state, object_pose=pose), hold_object=True)
