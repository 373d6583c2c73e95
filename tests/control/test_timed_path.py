"""Fastest timings: closed forms, laws of scale and reversal, limits between the nodes, a joint programme, refusals."""

import functools
import pickle
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq

import holdfast as hf
from holdfast.control import PoseSpline, RestToRest
from holdfast.control.paths import Target
from holdfast.errors import HoldfastError, MethodNotApplicable, ModelError, StateError
from holdfast.forces import ForceLimits, distribute
from holdfast.model.force_element import EndLoad, ForceElement
from holdfast.robots import ur5e
from holdfast.spatial import rotation
from holdfast.view.figure_style import drawn_text
from tests.control.two_pandas import rubber_pandas
from tests.longer import mostly_long, mostly_slow

WIDTH, RADIUS = 0.2, 0.12


@functools.cache
def two_ur5e(mu: float = 0.8, rates: bool = True) -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms of six joints, so that the object's motion fixes theirs, with a box between rubber fingers."""
    box = hf.HeldObject.box(3.0, WIDTH, WIDTH, WIDTH)
    rubber, grasps, arms = hf.Friction(mu, torsion_radius=0.02), {}, {}
    for name, x in (("left", -0.5), ("right", 0.5)):
        side = np.array([np.sign(x), 0.0, 0.0])
        grasps[name] = hf.Grasp("softfinger", hf.contact_frame(0.5 * WIDTH * side, into=-side), contact=rubber)
        arms[name] = ur5e(hf.Pose.from_rpy(0.0, 0.0, 0.0 if x < 0 else np.pi, [1.2 * x, 0.0, 0.0]))
    chain, state = hf.assemble(arms, box, grasps, object_pose=hf.Pose.translation(0.0, 0.0, 0.4))
    return (chain if rates else with_rates(chain, np.inf)), state


def with_rates(chain, factor):
    """Return the chain with all rate limits multiplied by a factor."""
    arms = {
        name: replace(one, joints=[replace(j, rate_limit=factor * j.rate_limit) for j in one.joints])
        for name, one in chain.arms.items()
    }
    return replace(chain, arms=arms)


class Arc:
    """An arc of a circle, followed at constant speed, while the box rocks about the line between the contacts."""

    def __init__(self, start, backward=False):
        self.start, self.backward = start, backward

    def at(self, s):
        """Return the target at s from 0 to 1."""
        sign = -1.0 if self.backward else 1.0
        s = 1.0 - s if self.backward else s
        sin, cos, x = np.sin(2.0 * s), np.cos(2.0 * s), np.array([1.0, 0.0, 0.0])
        p, v = RADIUS * np.array([0.0, sin, 1.0 - cos]), 2.0 * RADIUS * np.array([0.0, cos, sin])
        a = 4.0 * RADIUS * np.array([0.0, -sin, cos])
        angle, rate, curve = 0.2 * np.sin(3.0 * s), 0.6 * np.cos(3.0 * s), -1.8 * np.sin(3.0 * s)
        pose = hf.Pose(rotation.exp(angle * x) @ self.start.R, self.start.p + p)
        return Target(pose, sign * np.r_[rate * x, v], np.r_[curve * x, a])


GRIP = ForceLimits(effort=0.8, most_normal=60.0)


def pinned(timed, t: float, limits: ForceLimits = GRIP):
    """Return the limits with the accelerations of all joints given, up to 0.05 rad/s^2."""
    named = zip(timed.chain.joint_names(), timed.joints_at(t)[2], strict=True)
    return replace(limits, acceleration={name: (x - 0.05, x + 0.05) for name, x in named})


@functools.cache
def arc_timed(nodes: int, rates: bool = True):
    """Return the timing of the arc by the two arms."""
    chain, state = two_ur5e(rates=rates)
    return hf.time_path(chain, state, Arc(state.object_frame), GRIP, nodes=nodes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rates", "nodes", "places"),
    mostly_long([(True, 21, 10), (False, 11, 3), (False, 41, 10)], [(False, 11, 3)]),
)
def test_limits_between_nodes(rates, nodes, places):
    """At places of every interval, with forces of their own, limits are passed by 1e-3 N at most, rates by none."""
    timed = arc_timed(nodes, rates)
    chain = timed.chain
    most = np.array([joint.rate_limit for joint in chain.all_joints])
    for i in range(len(timed.u) - 1):
        for share in np.linspace(0.03, 0.97, places):
            t = float(timed.t[i] + share * (timed.t[i + 1] - timed.t[i]))
            state = timed.state_at(t)
            found = distribute(chain, state, timed.at(t).acceleration, limits=pinned(timed, t), form="effort")
            assert found.violation <= 1e-3
            assert (np.abs(state.qd) <= most * (1 + 1e-3)).all()
    assert timed.room.min() >= -5e-4


@pytest.mark.slow
def test_forward_dynamics_follows():
    """Torques found anew along the path give the object and the joints the accelerations of the timed path."""
    timed = arc_timed(21)
    for t in np.linspace(0.01, 0.99, 7) * timed.duration:
        state, target = timed.state_at(t), timed.at(t)
        tau = distribute(timed.chain, state, target.acceleration, limits=pinned(timed, t)).tau
        back = hf.forward_dynamics(timed.chain, state, tau)
        np.testing.assert_allclose(back.object_acceleration, target.acceleration, atol=1e-8)
        np.testing.assert_allclose(back.qdd, timed.joints_at(t)[2], atol=0.051)


@pytest.mark.slow
@pytest.mark.parametrize(
    "timed",
    [pytest.param(lambda: arc_timed(21), marks=pytest.mark.slow), lambda: from_rest_to_rest(21)],
    ids=["arc", "quintic"],
)
def test_derivatives(timed):
    """Twists and accelerations of the object, rates and accelerations of the joints are derivatives over time."""
    timed = timed()
    for t in np.linspace(0.1, 0.9, 5) * timed.duration + 1e-3:
        h = 1e-6
        (q0, qd0, _), (q1, qd1, _), (_, qd, qdd) = (timed.joints_at(x) for x in (t - h, t + h, t))
        np.testing.assert_allclose((q1 - q0) / (2 * h), qd, atol=1e-6 * np.abs(qd).max())
        np.testing.assert_allclose((qd1 - qd0) / (2 * h), qdd, atol=1e-6 * np.abs(qdd).max())
        before, after, here = timed.at(t - h), timed.at(t + h), timed.at(t)
        np.testing.assert_allclose((after.pose.p - before.pose.p) / (2 * h), here.twist[3:], atol=1e-7)
        turned = rotation.log(after.pose.R @ before.pose.R.T) / (2 * h)
        np.testing.assert_allclose(turned, here.twist[:3], atol=1e-7)
        np.testing.assert_allclose((after.twist - before.twist) / (2 * h), here.acceleration, atol=1e-5)
    for t, pose in ((-1.0, timed.route.object_at(0.0).pose), (timed.duration + 1.0, timed.route.object_at(1.0).pose)):
        assert not timed.at(t).twist.any() and not timed.at(t).acceleration.any()
        np.testing.assert_array_equal(timed.at(t).pose.p, pose.p)


def from_rest_to_rest(nodes, **path):
    """Return the timing of a path that rests at its ends."""
    chain, state = two_ur5e()
    given = RestToRest(state.object_frame, displacement=[0.0, 0.2, 0.1], turn=[0.3, 0.0, 0.0], duration=2.0)
    return hf.time_path(chain, state, given, GRIP, span=(0.0, 2.0), nodes=nodes)


@pytest.mark.long
def test_speed_of_the_given_path_does_not_matter():
    """A straight line takes the same time at constant speed, from rest to rest, or through poses."""
    chain, state = two_ur5e()
    start, way = state.object_frame, np.array([0.3, 0.0, 0.0, 0.0, 0.2, 0.1])

    def straight(s):
        pose = hf.Pose(rotation.exp(3.0 * s * way[:3]) @ start.R, start.p + 3.0 * s * way[3:])
        return Target(pose, 3.0 * way, np.zeros(6))

    even = hf.time_path(chain, state, straight, GRIP, span=(0.0, 1.0 / 3.0), nodes=21)
    assert from_rest_to_rest(21).duration == pytest.approx(even.duration, rel=1e-6)
    end = straight(1.0 / 3.0).pose
    spline = hf.time_path(chain, state, PoseSpline([start, end], [0.0, 5.0]), GRIP, span=(0.0, 5.0), nodes=21)
    assert spline.duration == pytest.approx(even.duration, rel=1e-6)
    np.testing.assert_allclose(spline.at(spline.duration).pose.p, end.p, atol=1e-12)


def slide(rate=np.inf, effort=20.0, gravity=(0.0, 0.0, 0.0), damping=0.0):
    """Return one arm with a sliding joint along x, which holds the object, and the moved mass."""
    one = hf.Arm(
        [hf.Joint("prismatic", (1, 0, 0), effort_limit=effort, rate_limit=rate, damping=damping)],
        [hf.Link(2.0, inertia=0.01 * np.eye(3))],
    )
    chain = hf.ClosedChain({"arm": one}, hf.HeldObject.box(3.0, 0.1, 0.1, 0.1), {"arm": hf.Grasp("rigid")}, gravity)
    return chain, hf.State(np.zeros(1), np.zeros(1), hf.Pose.identity()), 5.0


def along_x(s):
    """Return the target after s metres."""
    return Target(hf.Pose.translation(s, 0.0, 0.0), np.eye(6)[3], np.zeros(6))


@pytest.mark.slow
def test_bang_bang():
    """One joint: half the way with the largest force, half with the opposite one, 2 sqrt(way m / F)."""
    chain, state, mass = slide()
    timed = hf.time_path(chain, state, along_x, span=(0.0, 0.5), nodes=21)
    assert timed.duration == pytest.approx(2.0 * np.sqrt(0.5 * mass / 20.0), rel=1e-6)
    assert {name for by in timed.limited_by for name in by} == {f"{chain.joint_names()[0]} effort"}
    forces = [mass * timed.joints_at(float(t))[2][0] for t in 0.5 * (timed.t[1:] + timed.t[:-1])]
    np.testing.assert_allclose(np.abs(forces), 20.0, rtol=1e-5)


@pytest.mark.slow
def test_trapezoid():
    """With a rate limit r that is reached at a node: way / r + m r / F."""
    chain, state, mass = slide(rate=np.sqrt(2.0 * 4.0 * 0.1))
    timed = hf.time_path(chain, state, along_x, span=(0.0, 0.5), nodes=21)
    rate = np.sqrt(0.8)
    assert timed.duration == pytest.approx(0.5 / rate + mass * rate / 20.0, rel=1e-6)
    ends = zip(timed.u[:-1], timed.u[1:], timed.limited_by, strict=True)
    fast = [by for u, v, by in ends if u > 0.2 - 1e-9 and v < 0.8 + 1e-9]
    assert {next(iter(by)) for by in fast} == {f"{chain.joint_names()[0]} rate"}  # the first has the largest share


@pytest.mark.slow
def test_acceleration_limits():
    """Of joints: 2 sqrt(way / a), where acceleration and braking may differ: sqrt(2 way (1 / a + 1 / d))."""
    chain, state, _ = slide()
    name = chain.joint_names()[0]
    timed = hf.time_path(
        chain, state, along_x, ForceLimits(acceleration={name: (-1.0, 3.0)}), span=(0.0, 0.5), nodes=21
    )  # they meet at a quarter of the way, a node
    assert timed.duration == pytest.approx(np.sqrt(2.0 * 0.5 * (1.0 / 3.0 + 1.0)), rel=1e-6)


@pytest.mark.parametrize("damping", mostly_slow([5.0, 60.0], ()))
def test_dampers(damping):
    """One joint with a damper d: v' = (F - d v) / m up to a speed v, then v' = -(F + d v) / m, in closed form."""
    chain, state, m = slide(damping=damping)
    timed, force = hf.time_path(chain, state, along_x, span=(0.0, 0.5), nodes=21), 20.0

    def times(v):
        return -m / damping * np.log1p(-damping * v / force), m / damping * np.log1p(damping * v / force)

    def way(v):
        faster, slower = times(v)
        return (force * faster - m * v) / damping + (m * v - force * slower) / damping

    v = brentq(lambda v: way(v) - 0.5, 1e-6, (1.0 - 1e-12) * min(force / damping, 10.0))
    assert sum(times(v)) <= timed.duration <= 1.003 * sum(times(v))
    for t in np.linspace(0.0, timed.duration, 400)[1:-1]:
        _, qd, qdd = timed.joints_at(t)
        assert abs(m * qdd[0] + damping * qd[0]) <= force + 1e-3


@pytest.mark.long
def test_damped_arms():
    """Between nodes too, the torques of damped arms keep the limits, with forces found anew."""
    timed = hf.time_path(damped(10.0), STATE, ARC, GRIP, nodes=11)
    assert timed.duration > 1.05 * arc_timed(11).duration
    for t in np.linspace(0.01, 0.99, 60) * timed.duration:
        found = distribute(timed.chain, timed.state_at(t), timed.at(t).acceleration, limits=pinned(timed, t))
        assert found.violation <= 1e-3


@pytest.mark.long
def test_time_scales():
    """Without gravity, limits on forces times k^2, and rates times k, divide the time by k."""
    chain, state = two_ur5e()
    chain = replace(chain, gravity=np.zeros(3))
    arc = Arc(state.object_frame)
    slow = hf.time_path(chain, state, arc, ForceLimits(effort=0.5, most_normal=50.0), nodes=11)
    fast = hf.time_path(with_rates(chain, 1.3), state, arc, ForceLimits(effort=0.845, most_normal=84.5), nodes=11)
    assert fast.duration == pytest.approx(slow.duration / 1.3, rel=1e-5)


@pytest.mark.slow
def test_reversal():
    """The same way back takes the same time, at the same speeds."""
    chain, state = two_ur5e()
    there = arc_timed(21)
    arc = Arc(state.object_frame, backward=True)
    start = hf.close(chain, replace(there.state_at(there.duration)), hold_object=True)
    back = hf.time_path(chain, start, arc, GRIP, nodes=21)
    assert back.duration == pytest.approx(there.duration, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("rates", mostly_long([True, False], [False]))
def test_beside_a_joint_programme(rates):
    """Not faster than a fine programme over all nodes together, and at 40 intervals slower by less than 1 %."""
    pytest.importorskip("clarabel", reason="needs Clarabel: pip install clarabel")
    from tests.control.joint_timing import least_time, limits_between

    timed = arc_timed(41, rates)
    least = least_time(limits_between(timed, GRIP, 160), 1.0 / 160)
    assert 0.999 * least <= timed.duration <= 1.01 * least


@pytest.mark.slow
def test_given_joints():
    """Joints from a function and from the closed states at the same places take the same time; redundant ones too."""
    chain, state = rubber_pandas(0.8)
    arc = Arc(state.object_frame)
    first = hf.time_path(chain, state, arc, GRIP, nodes=11)
    again = hf.time_path(chain, first.route.joints, arc, GRIP, nodes=11)
    assert again.duration == pytest.approx(first.duration, rel=1e-9)


@pytest.mark.slow
def test_tracking():
    """Computed torque follows the timed path, and a law of its own keeps the box at the end."""
    chain, state = two_ur5e()
    limits = ForceLimits(effort=0.5, most_normal=25.0)
    timed = hf.time_path(chain, state, Arc(state.object_frame), limits, nodes=11)
    law = hf.control.ObjectTracking(chain, timed, internal_force=30.0)
    run = hf.simulate(chain, timed.state_at(0.0), law, timed.duration, 1e-3)
    np.testing.assert_allclose(run.object_pose[-1][4:], timed.at(timed.duration).pose.p, atol=1e-3)
    assert run.margin.min() > 0.0


@pytest.mark.slow
def test_speeds():
    """No speed is above the largest from which one can stop, and that not above what the place permits."""
    timed = arc_timed(21)
    assert (timed.rate <= timed.fastest * (1 + 1e-9)).all()
    assert (timed.fastest <= timed.maximum * (1 + 1e-6)).all()
    assert timed.rate[0] == timed.rate[-1] == timed.fastest[-1] == 0.0


@pytest.mark.slow
def test_plot(tmp_path):
    """The figure shows the three speeds, names what limits them, with units, and is written on request."""
    timed = arc_timed(21)
    figure = timed.plot(tmp_path / "timing.png")
    speeds, room = figure.axes
    np.testing.assert_array_equal(speeds.lines[0].get_ydata(), timed.rate)
    assert (speeds.get_ylabel(), room.get_ylabel(), room.get_xlabel()) == (
        "speed [1/s]", "room [N]", "share of the path",
    )  # fmt: skip
    first = {next(iter(by)) for by in timed.limited_by if by}
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {drawn_text(f"limited by {name}") for name in first} <= labels or "limited by others" in labels
    assert (tmp_path / "timing.png").stat().st_size > 10_000


@pytest.mark.slow
def test_pickles():
    """With its path and joints."""
    timed = arc_timed(21)
    same = pickle.loads(pickle.dumps(timed))
    np.testing.assert_array_equal(same.at(0.1).twist, timed.at(0.1).twist)
    assert repr(same) == repr(timed)


CHAIN, STATE = two_ur5e()
ARC = Arc(STATE.object_frame)


def weak():
    """Return the arms with rubber that cannot carry the box."""
    chain, state = two_ur5e(0.1)
    return hf.time_path(chain, state, ARC, ForceLimits(most_normal=60.0), nodes=4)


def still_joints(s):
    """Return joints that stand while the object moves."""
    return STATE.q, 0.0 * STATE.q + 1.0, 0.0 * STATE.q


def damped(damping):
    """Return the chain with a damper in each joint."""
    arms = {
        name: replace(one, joints=[replace(j, damping=damping) for j in one.joints]) for name, one in CHAIN.arms.items()
    }
    return replace(CHAIN, arms=arms)


class Dragged(NamedTuple):
    """Drag at one instant."""

    velocity: np.ndarray

    def loads(self):
        """Return -|v|^2 v on the second end."""
        drag = (self.velocity @ self.velocity) * self.velocity
        return EndLoad(drag), EndLoad(-drag)

    def energy(self):
        """Return zero."""
        return 0.0

    def loss(self):
        """Return |v|^4."""
        return (self.velocity @ self.velocity) ** 2


@dataclass(frozen=True, eq=False)
class Drag(ForceElement):
    """A force against a motion that grows with the cube of its speed."""

    def between(self, a, b):
        """Return the drag."""
        return Dragged(b.velocity - a.velocity)


def dragged():
    """Return the chain with drag on the box."""
    return replace(CHAIN, springs=[Drag(("world", [0, 0, 0]), ("object", [0, 0, 0]))])


PAUSED = PoseSpline([STATE.object_frame, STATE.object_frame, hf.Pose.translation(0.0, 0.0, 0.5)], [0.0, 1.0, 2.0])
REFUSED = {
    "held": (weak, StateError, "at s = 0: the object cannot even be held there: friction of"),
    "limits": (lambda: hf.time_path(CHAIN, STATE, ARC, 3.0), ModelError, "time_path: limits"),
    "samples": (lambda: hf.time_path(CHAIN, STATE, ARC, ForceLimits(sample_time=0.1)), ModelError, "sample_time"),
    "nodes": (lambda: hf.time_path(CHAIN, STATE, ARC, nodes=2), ModelError, "whole number from 4"),
    "span": (lambda: hf.time_path(CHAIN, STATE, ARC, span=(1.0, 1.0)), ModelError, "first < last"),
    "path": (lambda: hf.time_path(CHAIN, STATE, lambda s: s, nodes=4), ModelError, "Target"),
    "no path": (lambda: hf.time_path(CHAIN, STATE, 3.0), ModelError, "time_path: path"),
    "joints": (lambda: hf.time_path(CHAIN, lambda s: s, ARC, nodes=4), ModelError, "time_path: joints"),
    "rates": (lambda: hf.time_path(CHAIN, still_joints, ARC, nodes=4), StateError, "the grasps demand other rates"),
    "drag": (lambda: hf.time_path(dragged(), STATE, ARC, nodes=4), MethodNotApplicable, "in proportion to it or to"),
    "no braking": (
        lambda: hf.time_path(
            *slide()[:2], along_x, ForceLimits(acceleration={slide()[0].joint_names()[0]: (0.0, 1.0)}), nodes=4
        ),
        StateError,
        "no motion from which the path can be continued",
    ),
    "no grasp": (
        lambda: hf.time_path(replace(CHAIN, grasps={}), STATE, ARC, nodes=4), MethodNotApplicable, "no grasp",
    ),
    "no limit": (
        lambda: hf.time_path(*slide(effort=np.inf)[:2], along_x, nodes=4), StateError, "no limit bounds the speed",
    ),
    "stands": (
        lambda: hf.time_path(CHAIN, STATE, PAUSED, span=(0.0, 2.0), nodes=5), ModelError, "it stands at s =",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    """In words, with what to try."""
    ask, error, words = REFUSED[name]
    with pytest.raises(error, match=words) as caught:
        ask()
    assert isinstance(caught.value, HoldfastError)
