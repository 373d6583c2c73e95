"""Fastest timings: closed forms, laws of scale and reversal, limits between the nodes, a joint programme, refusals."""

import functools
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control.paths import Target
from holdfast.forces import ForceLimits, distribute
from holdfast.robots import ur5e
from holdfast.spatial import rotation

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
    return (chain if rates else without_rates(chain)), state


def without_rates(chain, factor=np.inf):
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


@functools.cache
def arc_timed(nodes: int, rates: bool = True):
    """Return the timing of the arc by the two arms."""
    chain, state = two_ur5e(rates=rates)
    return hf.time_path(chain, state, Arc(state.object_frame), GRIP, nodes=nodes)


@pytest.mark.parametrize(("rates", "nodes"), [(True, 21), (False, 11), (False, 41)])
def test_limits_between_nodes(rates, nodes):
    """At ten places of every interval, with forces of their own, limits are passed by 1e-3 N at most, rates by none."""
    timed = arc_timed(nodes, rates)
    chain = timed.chain
    most = np.array([joint.rate_limit for joint in chain.all_joints])
    for i in range(nodes - 1):
        for share in np.linspace(0.03, 0.97, 10):
            t = float(timed.t[i] + share * (timed.t[i + 1] - timed.t[i]))
            state = timed.state_at(t)
            found = distribute(chain, state, timed.at(t).acceleration, limits=GRIP, form="effort")
            assert found.violation <= 1e-3
            assert (np.abs(state.qd) <= most * (1 + 1e-3)).all()
    assert timed.violation <= 5e-4


def test_forward_dynamics_follows():
    """Its torques give the object and the joints the accelerations of the timed path."""
    timed = arc_timed(21)
    for t in np.linspace(0.01, 0.99, 7) * timed.duration:
        state, target = timed.state_at(t), timed.at(t)
        tau = distribute(timed.chain, state, target.acceleration, limits=GRIP).tau
        back = hf.forward_dynamics(timed.chain, state, tau)
        np.testing.assert_allclose(back.object_acceleration, target.acceleration, atol=1e-8)
        np.testing.assert_allclose(back.qdd, timed.joints_at(t)[2], atol=2e-2 * np.abs(back.qdd).max())
