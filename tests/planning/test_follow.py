"""A joint path follows the object's, keeps away from limits and singular postures, and is refused for a true reason."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.assembly.on_trunk import on_own_bases
from holdfast.assembly.reaching_configurations import reaching_configurations
from holdfast.assembly.starts import starting_configurations
from holdfast.control import PoseSpline, RestToRest
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.dynamics import Posture, closure, tip_pose
from holdfast.errors import ClosureError, MethodNotApplicable, ModelError, StateError
from holdfast.spatial.pose import Pose
from tests.control.two_pandas import two_pandas
from tests.longer import mostly_slow
from tests.planning.examples import TRAY, carried, mobile, plainly_followed, two_arms
from tests.systems.problems import largest_gaps

CLOSED = 1e-10
MIRROR = np.diag([1.0, -1.0, 1.0])


def rate_gaps(plan):
    """Return the joints' steps without what rates and accelerations say of them, O(h^5)."""
    h = plan.t[1] - plan.t[0]
    by_rates = h / 2 * (plan.qd[1:] + plan.qd[:-1]) - h * h / 12 * np.diff(plan.qdd, axis=0)
    return np.diff(plan.q, axis=0) - by_rates


def require_laws(plan, path):
    """Check closure, the object's place, rates against differences, and forward dynamics of the accelerations."""
    chain, h = plan.chain, plan.t[1] - plan.t[0]
    low, high = chain.position_limits.T
    assert ((low <= plan.q) & (plan.q <= high)).all()
    for k, t in enumerate(plan.t):
        target = path.at(float(t))
        state = hf.State(plan.q[k], plan.qd[k], target.pose, target.twist)
        positions, velocities = largest_gaps(closure(chain, state))
        assert max(positions, velocities) <= CLOSED
        assert plan.residual[k] == pytest.approx(positions, abs=CLOSED)
    assert np.abs(rate_gaps(plan)).max() <= 2e-4 * h * np.abs(plan.qd).max()
    increase = np.diff(plan.qd, axis=0) - h / 2 * (plan.qdd[1:] + plan.qdd[:-1])
    assert np.abs(increase).max() <= 0.03 * h * np.abs(plan.qdd).max()
    k = len(plan.t) // 3
    state, target = plan.state_at(float(plan.t[k])), path.at(float(plan.t[k]))
    wrenches = commanded_wrenches(chain, state, target.acceleration, 0.0)
    tau = hf.inverse_dynamics(chain, state, plan.qdd[k], wrenches)
    found = hf.forward_dynamics(chain, state, tau)
    assert found.qdd == pytest.approx(plan.qdd[k], abs=1e-9)
    assert found.object_acceleration == pytest.approx(target.acceleration, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("robot", mostly_slow(["panda", "gen3"], ["panda"]))
def test_laws(robot):
    """Two arms along a turn and a shift: closed, on the path, at rest at both ends, with consistent derivatives."""
    chain, state = two_arms(robot)
    path = carried(state, [0.03, 0.1, 0.1], [0, 0, 0.3])
    plan = hf.follow(chain, state, path, 2.0, 0.05)
    require_laws(plan, path)
    assert plan.q[0] == pytest.approx(state.q, abs=1e-9)
    assert np.abs(plan.qd[[0, -1]]).max() <= 1e-9
    assert plan.residual_between.max() <= 1e-6
    finer = hf.follow(chain, state, path, 2.0, 0.025)
    assert np.abs(rate_gaps(finer)).max() <= np.abs(rate_gaps(plan)).max() / 25
    assert plan.q[-1] == pytest.approx(finer.q[-1], abs=2e-3)  # the path, not its sampling, decides


@pytest.mark.slow
def test_at():
    """Between samples the joint path is smooth and nearly closed, and it rests before and after."""
    chain, state = two_arms("panda")
    path = carried(state, [0.0, 0.1, 0.1])
    plan = hf.follow(chain, state, path, 2.0, 0.05)
    assert plan.at(plan.t[7]).q == pytest.approx(plan.q[7], abs=1e-14)
    assert plan.at(plan.t[7]).qd == pytest.approx(plan.qd[7], abs=1e-12)
    assert plan.at(plan.t[7]).qdd == pytest.approx(plan.qdd[7], abs=1e-10)
    ahead, here, behind = plan.at(0.731 + 1e-5), plan.at(0.731), plan.at(0.731 - 1e-5)
    assert (ahead.q - behind.q) / 2e-5 == pytest.approx(here.qd, abs=1e-8)
    assert (ahead.qd - behind.qd) / 2e-5 == pytest.approx(here.qdd, abs=1e-7)
    for outside, k in ((-1.0, 0), (9.0, -1)):
        target = plan.at(outside)
        assert target.q == pytest.approx(plan.q[k], abs=1e-14) and not target.qd.any() and not target.qdd.any()
    state = plan.state_at(0.731)
    assert largest_gaps(closure(chain, state))[0] <= CLOSED
    assert state.object_pose == pytest.approx(path.at(0.731).pose.wxyz_xyz, abs=1e-15)
    assert state.q == pytest.approx(here.q, abs=1e-6)


@pytest.mark.slow
def test_limits_are_avoided():
    """A path on which the nearest configurations pass a joint limit, and the planned ones do not."""
    chain, state = two_arms("iiwa14")
    path = carried(state, [0.175, -0.068, 0.076], [-0.907, -0.753, -0.007])
    assert plainly_followed(chain, state, path, 41)[0] < -0.04
    plan = hf.follow(chain, state, path, 2.0, 0.05)
    require_laws(plan, path)
    assert plan.nearest_limit.value > 0.019  # where the start is
    assert plan.nearest_limit.value == pytest.approx(
        (plan.limit_distance / np.ptp(chain.position_limits, axis=1)).min()
    )


@pytest.mark.slow
def test_a_mobile_manipulator_drives():
    """Two arms on a platform carry a tray 0.3 m: the platform does most of it, the arms stay bent and inside limits."""
    chain, state = mobile()
    path = carried(state, [0.3, 0.0, 0.0], duration=3.0)
    plan = hf.follow(chain, state, path, 3.0, 0.1)
    require_laws(plan, path)
    base = plan.q[:, 0] - plan.q[0, 0]
    assert base[-1] == pytest.approx(0.261, abs=1e-3)  # of 0.3 m
    assert np.abs(np.diff(base)).sum() <= 1.001 * base[-1]  # it does not swing
    elbows = plan.q[:, [chain.joint_names().index(f"{name}/joint4") for name in ("left", "right")]]
    assert elbows.max() < -np.radians(5)  # a straight elbow is at 0
    assert plan.nearest_limit.value > 0.2
    heavy = hf.follow(chain, state, path, 3.0, 0.1, posture=Posture(weights={"trunk": 100.0}))
    assert heavy.q[-1, 0] - heavy.q[0, 0] < 0.18
    assert heavy.weakest.value < plan.weakest.value


@pytest.mark.slow
def test_a_platform_moves_where_the_arms_alone_do_not_reach():
    """What is out of reach of the arms on a platform that stands is reached by one that drives."""
    chain, state = mobile()
    path = carried(state, [1.2, 0.0, 0.0], duration=3.0)
    with pytest.raises(ClosureError, match=r"misses its grasp"):
        hf.follow(*on_own_bases(chain, state), path, 3.0, 0.1)
    plan = hf.follow(chain, state, path, 3.0, 0.1)
    require_laws(plan, path)
    assert plan.q[-1, 0] - plan.q[0, 0] > 0.9


@pytest.mark.slow
def test_straight_elbows_are_avoided():
    """Where a platform's weight lets the arms stretch, the zone of singular postures keeps them stronger."""
    chain, state = mobile()
    path = carried(state, [0.5, 0.0, 0.0], duration=3.0)
    heavy = Posture(weights={"trunk": 30.0})
    bare = hf.follow(chain, state, path, 3.0, 0.1, posture=heavy, strength=0.0)
    plan = hf.follow(chain, state, path, 3.0, 0.1, posture=heavy, strength=0.15)
    require_laws(plan, path)
    assert plan.weakest.value > 1.2 * bare.weakest.value
    assert plan.q[-1, 0] > bare.q[-1, 0]


@pytest.mark.slow
def test_it_is_a_minimum():
    """Other joint paths along the same path of the object cost more, by the definition of the cost."""
    chain, state = two_arms("panda")
    path = carried(state, [0.0, 0.1, 0.1])
    plan = hf.follow(chain, state, path, 2.0, 0.05, room=0.01, strength=0.01, smoothing=0.3)
    half = 0.5 * np.ptp(chain.position_limits, axis=1)
    ds = 1 / (len(plan.t) - 1)

    def cost(q):
        posture = 0.5 * (((q - chain.position_limits.mean(axis=1)) / half) ** 2).sum(axis=1)
        mirrored = np.concatenate([q[1:2], q, q[-2:-1]])  # at rest at both ends
        bend = np.diff(mirrored, 2, axis=0) / ds**2 / half
        return np.trapezoid(posture, dx=ds) + 0.5 * 0.3**4 * np.trapezoid((bend**2).sum(axis=1), dx=ds)

    best, s = cost(plan.q), np.linspace(0.0, 1.0, len(plan.t))
    for joint, shape in ((0, np.sin(np.pi * s) ** 2), (7, s**2 * (1.5 - s)), (9, np.sin(2 * np.pi * s) * s)):
        for size in (0.05, -0.05):
            moved = []
            for t, q, by in zip(plan.t, plan.q, size * shape, strict=True):
                guess = hf.State(q + by * np.eye(14)[joint], 0 * q, path.at(float(t)).pose)
                moved.append(hf.close(chain, guess, hold_object=True).q)
            assert np.abs(np.array(moved) - plan.q).max() > 0.01
            assert cost(np.array(moved)) > best


@pytest.mark.slow
def test_time_scaling():
    """Half the speed is the same path in space, with half the rates and a quarter of the accelerations."""
    chain, state = two_arms("panda")
    fast, slow = (hf.follow(chain, state, carried(state, [0.0, 0.1, 0.1], duration=T), T, T / 20) for T in (1.0, 2.0))
    assert slow.q == pytest.approx(fast.q, abs=1e-8)
    assert 2 * slow.qd == pytest.approx(fast.qd, abs=1e-7)
    assert 4 * slow.qdd == pytest.approx(fast.qdd, abs=1e-5)
    later = carried(state, [0.0, 0.1, 0.1], duration=1.0)
    shifted = hf.follow(chain, state, lambda t: later.at(t - 5.0), 1.0, 0.05, begin=5.0)
    assert shifted.q == pytest.approx(fast.q, abs=1e-8)
    assert shifted.t[0] == 5.0


@pytest.mark.slow
def test_mirror():
    """The mirrored question has the mirrored answer: left and right exchanged, and the signs of odd joints."""
    chain, state = two_arms("panda")
    signs, other = np.array([-1.0, 1, -1, 1, -1, 1, -1]), {"left": "right", "right": "left"}
    q = np.concatenate([signs * state.q[chain.joints[other[name]]] for name in chain.arms])
    grasps = {}
    for name in chain.arms:
        across = other[name]
        mirrored = tip_pose(chain.arms[across], state.q[chain.joints[across]]).R
        tip = tip_pose(chain.arms[name], q[chain.joints[name]]).R
        frame = chain.grasps[across].frame
        turned = MIRROR @ frame.R @ MIRROR @ (MIRROR @ mirrored @ MIRROR).T @ tip
        grasps[name] = hf.Grasp("rigid", Pose(turned, MIRROR @ frame.p))
    there = replace(chain, grasps=grasps)
    start = hf.State(q, 0 * q, state.object_pose)
    plan = hf.follow(chain, state, carried(state, [0.02, 0.1, 0.1], [0.1, 0.2, 0.3]), 2.0, 0.1)
    found = hf.follow(there, start, carried(start, [0.02, -0.1, 0.1], [-0.1, 0.2, -0.3]), 2.0, 0.1)
    expected = np.hstack([signs * plan.q[:, chain.joints[other[name]]] for name in chain.arms])
    assert found.q == pytest.approx(expected, abs=1e-7)
    assert found.strength[:, ::-1] == pytest.approx(plan.strength, abs=1e-7)


@pytest.mark.slow
def test_through_poses_and_in_motion():
    """A spline through poses; and a part of it, from a state in motion to one in motion."""
    chain, state = two_arms("panda")
    poses = [state.object_frame]
    poses += [Pose(state.object_frame.R, state.object_frame.p + by) for by in ([0, 0.1, 0.05], [0.05, 0, 0.1])]
    path = PoseSpline(poses, [0.0, 1.0, 2.0])
    plan = hf.follow(chain, state, path, 2.0, 0.05)
    require_laws(plan, path)
    part = hf.follow(chain, plan.state_at(0.5), path, 1.0, 0.05, begin=0.5)
    require_laws(part, path)
    assert part.qd[0] == pytest.approx(plan.qd[10], abs=1e-9)
    assert np.abs(part.qd[-1]).max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("softfinger", "softfinger"), ("hinge", "rigid"), ("ball", "softfinger")])
def test_other_grasps(kinds):
    """Soft fingers do not spin, which positions alone would not tell; hinges and balls may turn."""
    chain, state = two_pandas(*kinds)
    path = carried(state, [0.02, 0.05, -0.05], [0.1, 0.1, 0.1])
    plan = hf.follow(chain, state, path, 2.0, 0.1)
    require_laws(plan, path)
    assert plan.chain is chain


@pytest.mark.long
def test_bushings_keep_their_stretch():
    """An arm behind a bushing goes with the object: its tip stays where it is on the object."""
    chain, state = two_pandas()
    soft = replace(chain.grasps["right"], kind="bushing", stiffness=np.full(6, 1e3))
    chain = replace(chain, grasps={**chain.grasps, "right": soft})
    state = replace(state, q=state.q + 0.003 * np.eye(14)[9])
    path = carried(state, [0.05, 0.05, -0.1])
    plan = hf.follow(chain, state, path, 2.0, 0.1)
    before, after = (
        at.object_frame.inverse() @ tip_pose(chain.arms["right"], at.q[7:]) for at in (state, plan.state_at(2.0))
    )
    assert after.p == pytest.approx(before.p, abs=1e-10)
    assert pytest.approx(before.R, abs=1e-10) == after.R
    assert np.abs(plan.q[-1, 7:] - plan.q[0, 7:]).max() > 0.05


def lone(robot):
    """Return one arm that holds the tray."""
    grasp = hf.Grasp("rigid", hf.contact_frame([0, 0, 0.05], into=[0, 0, -1]))
    arms = {"arm": hf.robots.ROBOTS[robot]()}
    return hf.assemble(arms, TRAY, {"arm": grasp}, object_pose=hf.Pose.translation(0.5, 0, 0.35))


@pytest.mark.long
def test_refusals_are_true():
    """Random paths of one arm: one that is refused has a pose without any configuration within the limits.

    The oracle is a search from 300 starts per pose.
    """
    chain, state = lone("iiwa14")
    arm, random, refused = chain.arms["arm"], np.random.default_rng(1), 0
    for _ in range(12):
        shift, turn = random.uniform(-1, 1, 3) * [0.25, 0.5, 0.3], random.uniform(-1, 1, 3) * 1.2
        path = carried(state, shift, turn)
        try:
            assert hf.follow(chain, state, path, 2.0, 0.1).residual.max() <= CLOSED
        except ClosureError:
            refused += 1
            starts = [*starting_configurations(arm, state.q, 300)]
            found = [
                len(reaching_configurations(arm, chain.grasps["arm"], path.at(t).pose, starts, state.q))
                for t in (1.0, 1.3, 1.6, 2.0)
            ]
            assert 0 in found
    assert 0 < refused < 12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shift", "said"),
    [
        ([0.5, 0.0, 0.0], r"follow: at t = \d.*s, \d+ % of the way: .*arm '(left|right)' misses its grasp by"),
        ([0.0, 0.0, 1.5], r"follow: at t = .* % of the way: .*misses its grasp"),
    ],
)
def test_out_of_reach(shift, said):
    """The message names the arm, the time, the share of the way, and the gap."""
    chain, state = two_arms("panda")
    with pytest.raises(ClosureError, match=said):
        hf.follow(chain, state, carried(state, shift), 2.0, 0.05)


def test_beyond_a_limit():
    """A turn that takes a wrist beyond its limits in every configuration names a joint of it, where and how far."""
    chain, state = lone("ur5e")
    arm = chain.arms["arm"]
    ranges = [(x - 0.3, x + 0.3) for x in state.q]
    joints = [replace(joint, position_limits=pair) for joint, pair in zip(arm.joints, ranges, strict=True)]
    tight = replace(chain, arms={"arm": arm.of(joints)})
    with pytest.raises(ClosureError, match=r"at t = .* s, arm/\w+ would be 0\.\d+ \(rad or m\) beyond its limit"):
        hf.follow(tight, state, carried(state, [0, 0, 0], [0, 0, 1.0]), 2.0, 0.05)


def test_refused_questions():
    """What is asked wrongly is refused by name."""
    chain, state = two_arms("panda")
    path = carried(state, [0.0, 0.1, 0.0])
    with pytest.raises(StateError, match=r"the path begins 0\.1 m and 0 rad from the object"):
        hf.follow(chain, state, RestToRest(Pose.translation(0.5, 0.1, 0.35)), 1.0, 0.05)
    with pytest.raises(StateError, match="position gap"):
        hf.follow(chain, replace(state, q=state.q + 0.01), path, 2.0, 0.05)
    with pytest.raises(ModelError, match="follow: path: expected a path such as"):
        hf.follow(chain, state, [1, 2], 2.0, 0.05)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ModelError, match="expected a Target from it, got Pose"):
        hf.follow(chain, state, lambda t: path.at(t).pose, 2.0, 0.05)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ModelError, match="follow: step"):
        hf.follow(chain, state, path, 2.0, 0.3)
    with pytest.raises(ModelError, match=r"room < 0\.5"):
        hf.follow(chain, state, path, 2.0, 0.05, room=0.5)
    free = hf.Trunk(floating=hf.Link(100.0, inertia=np.eye(3)))
    flyer = replace(chain, trunk=free, mounts={"left": "base"})
    with pytest.raises(MethodNotApplicable, match="floating base"):
        hf.follow(flyer, replace(state, base_pose=Pose.identity()), path, 2.0, 0.05)
    with pytest.raises(MethodNotApplicable, match="no grasp"):
        hf.follow(replace(chain, grasps={}), state, path, 2.0, 0.05)
    pinned = hf.ClosedChain({"pin": hf.Anchor()}, TRAY, {"pin": hf.Grasp("ball")})
    with pytest.raises(MethodNotApplicable, match="no joint"):
        hf.follow(pinned, hf.State([], [], Pose.identity()), path, 2.0, 0.05)


@pytest.mark.slow
def test_a_path_that_leaps():
    """A path that is not continuous is refused where it leaps."""
    chain, state = two_arms("panda")
    path = carried(state, [0.0, 0.0, 0.1])
    away = carried(state, [0.0, 0.25, 0.1])
    with pytest.raises(ClosureError, match=r"at t = 1 s, 50 % of the way: .* leaps"):
        hf.follow(chain, state, lambda t: (path if t < 0.99 else away).at(t), 2.0, 0.1)


def test_report():
    """Printed, a path tells its nearest limit, weakest arm, fastest joint and closure, each with its place."""
    chain, state = two_arms("panda")
    plan = hf.follow(chain, state, carried(state, [0.0, 0.1, 0.1]), 2.0, 0.1)
    assert repr(plan) == "<JointPath: 21 samples of 14 joints, 0 to 2 s>"
    k = int(np.argmin(np.abs(plan.t - plan.weakest.t)))
    assert plan.strength[k].min() == plan.strength.min() == plan.weakest.value
    fast = plan.fastest
    j = chain.joint_names().index(fast.name)
    assert fast.value == pytest.approx(np.abs(plan.qd[:, j]).max() / chain.all_joints[j].rate_limit)
    for line in (f"nearest to a limit: {plan.nearest_limit.name}", f"configuration: {plan.weakest.name}", fast.name):
        assert line in str(plan)
