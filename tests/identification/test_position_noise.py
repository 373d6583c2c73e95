"""Encoders with noise, for arms that hold one object together: errors are as deviations say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.identification import Recording
from holdfast.simulation.joint_friction import friction_torque
from tests.identification import free_robot as in_a_plane
from tests.identification.recorded import recorded

BOX = hf.HeldObject(2.0, np.diag([0.02, 0.05, 0.04]), [0.02, 0.0, 0.03])
DAMPING, FRICTION, OFFSET = 0.3, 0.5, 0.3
POSITIONS = 1e-3  # rad
TORQUES, WRENCHES = 0.02, np.array([0.005, 0.005, 0.005, 0.05, 0.05, 0.05])


def planar_arm(x: float) -> hf.Arm:
    """Return an arm of three joints about y, and its base."""
    at = [hf.Pose.translation(0.0, 0.0, z) for z in (0.0, 0.5, 0.5, 0.2)]
    joints = [hf.Joint(axis=[0, 1, 0], placement=one, damping=DAMPING, friction=FRICTION) for one in at[:3]]
    links = [hf.Link(2.0, [0.01, 0.0, 0.2], np.diag([0.03, 0.03, 0.005]))] * 2
    return hf.Arm(joints, [*links, hf.Link(1.0, [0, 0, 0.1], np.diag([0.01, 0.01, 0.002]))], at[3]).at(
        hf.Pose.translation(x, 0.0, 0.0)
    )


def carried(samples: int) -> tuple[hf.ClosedChain, Recording]:
    """Return two arms that hold a box, and exactly what they do and feel while it moves in their plane."""
    arms = {"left": planar_arm(-0.55), "right": planar_arm(0.55)}
    grasps = {
        name: hf.Grasp("rigid", hf.Pose.from_rpy(0, -sign * 0.5 * np.pi, 0, [0.15 * sign, 0, 0]))
        for name, sign in (("left", -1.0), ("right", 1.0))
    }
    q = {"left": [-0.9, 1.9, 0.57], "right": [0.9, -1.9, -0.57]}
    chain, state = hf.assemble(arms, BOX, grasps, q=q)

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        f, size = 2 * np.pi * np.array([0, 0.41, 0, 0.53, 0, 0.37]), np.array([0, 0.25, 0, 0.08, 0, 0.08])
        x = f * t[:, None] + np.arange(6)
        return size * np.sin(x), size * f * np.cos(x), -size * f * f * np.sin(x)

    exact = recorded(chain, state, duration=5.0, rate=samples / 5.0, motion=motion)
    assert exact.qd is not None and exact.tau is not None
    dry = friction_torque(np.full(6, FRICTION), exact.qd.T).T
    return chain, replace(exact, tau=exact.tau + dry)


@pytest.mark.long
@pytest.mark.parametrize("by", ["tau", "wrist_wrench"])
def test_noise_of_positions_enters_deviations_of_a_closed_chain(by):
    """Squares of errors in units of deviations have the mean 1 if these are right; the object has no pose."""
    chain, exact = carried(100)
    assert exact.tau is not None and exact.wrist_wrench is not None
    model = replace(chain, held_object=hf.HeldObject.box(1.0, 0.2, 0.2, 0.2))
    body = [BOX.mass, *BOX.com, *BOX.inertia[np.triu_indices(3)]]
    right = np.array([*body, *[DAMPING] * 6, *[FRICTION] * 6] if by == "tau" else [*body, *[OFFSET] * 12])
    kinds = {"tau": ["payload", "damping", "friction"], "wrist_wrench": ["payload", "sensor_offset"]}[by]
    squares = []
    for seed in range(3):
        random = np.random.default_rng(seed)
        q = exact.q + POSITIONS * random.normal(size=exact.q.shape)
        if by == "tau":
            given = Recording(t=exact.t, q=q, tau=exact.tau + TORQUES * random.normal(size=q.shape))
        else:
            felt = exact.wrist_wrench + OFFSET + WRENCHES * random.normal(size=exact.wrist_wrench.shape)
            given = Recording(t=exact.t, q=q, wrist_wrench=felt)
        noise = TORQUES if by == "tau" else WRENCHES
        found = hf.identify(model, given, by=by, unknowns=kinds, noise=noise)
        sure = np.isfinite([found.deviations[name] for name in found.names])
        squares += ((found.values - right) ** 2 / np.diag(found.covariance))[sure].tolist()
        assert any("positions have noise of up to" in note for note in found.notes)
    assert len(squares) > 20
    assert 0.2 < np.mean(squares) < 2.5 and max(squares) < 20.0


def carried_by_a_floating_robot(samples: int) -> tuple[hf.ClosedChain, Recording]:
    """Return an arm on a free body with a box in its hand, without gravity, and a simulated run of it."""
    at = [hf.Pose.translation(0.0, y, z) for y, z in ((0.2, 0.1), (0.0, 0.2), (0.0, 0.4), (0.0, 0.2))]
    joints = [hf.Joint(axis=axis, placement=one) for axis, one in zip(np.eye(3)[::-1], at[:3], strict=True)]
    links = [hf.Link(2.0, [0.01, 0.0, 0.2], np.diag([0.03, 0.03, 0.005]))] * 2
    arm = hf.Arm(joints, [*links, hf.Link(1.0, [0, 0, 0.1], np.diag([0.01, 0.01, 0.002]))], at[3])
    trunk = hf.Trunk(floating=hf.Link(10.0, [0.02, 0.01, 0.05], np.diag([0.4, 0.3, 0.5])))
    grasps = {"arm": hf.Grasp("rigid", hf.Pose.translation(0.0, 0.0, -0.1))}
    chain = hf.ClosedChain({"arm": arm}, BOX, grasps, np.zeros(3), trunk, {"arm": "base"})
    q, still, here, duration = np.array([0.3, 0.5, -0.4]), np.zeros(6), np.r_[1.0, np.zeros(6)], 2.0
    state = hf.close(chain, hf.State(q, np.zeros(3), here, still, base_pose=here, base_twist=still))

    def law(t: float, now: hf.State, memory: object) -> tuple[np.ndarray, object]:
        wanted = q + np.sin(np.pi * t / duration) ** 4 * np.sin(2.0 * np.pi * np.array([0.9, 1.3, 1.1]) * t)
        return 60.0 * (wanted - now.q) - 6.0 * now.qd, memory

    run = hf.simulate(chain, state, law, duration, duration / samples / 4, every=4)
    unseen = dict.fromkeys(("object_pose", "object_twist", "object_acceleration"))
    return chain, replace(Recording.of_run(run), **unseen)


@pytest.mark.long
@pytest.mark.parametrize("noisy", ["torques", "positions", "base"])
def test_what_no_sensor_measures_on_a_floating_base_does_not_count_as_exact(noisy):
    """The balance of the base would: with noisy positions, deviations were 1e-13 of the errors."""
    chain, exact = carried_by_a_floating_robot(100)
    assert exact.tau is not None and exact.base_acceleration is not None
    model = replace(chain, held_object=hf.HeldObject.box(1.0, 0.2, 0.2, 0.2))
    right, squares = np.array([BOX.mass, *BOX.com, *BOX.inertia[np.triu_indices(3)]]), []
    for seed in range(3):
        random = np.random.default_rng(seed)
        given = replace(exact, tau=exact.tau + TORQUES * random.normal(size=exact.tau.shape))
        if noisy == "positions":
            given = replace(given, q=exact.q + 1e-4 * random.normal(size=exact.q.shape), qd=None, qdd=None)
        elif noisy == "base":
            off = 0.05 * random.normal(size=exact.base_acceleration.shape)
            given = replace(given, base_acceleration=exact.base_acceleration + off)
        for kinds in (["payload"], None):
            found = hf.identify(model, given, by="tau", unknowns=kinds)
            sure = np.isfinite([found.deviations[name] for name in found.names])
            assert sure.all()
            squares += ((found.values - right) ** 2 / np.diag(found.covariance)).tolist()
    assert 0.2 < np.mean(squares) < 4.0 and max(squares) < 25.0


@pytest.mark.long
def test_a_robot_on_a_free_base_by_newton_and_euler():
    """What a plane motion tells comes back exactly; noisy positions leave errors as deviations say."""
    chain, exact = in_a_plane.recorded(base_mass=3.0, duration=4.0, samples=160)
    body, told = chain.held_object, [0, 1, 3, 7]
    right = np.array([body.mass, *body.com, *body.inertia[np.triu_indices(3)]])[told]
    model = replace(chain, held_object=hf.HeldObject(1.0, 0.02 * np.eye(3), [0.02, 0.0, 0.1]))
    found = hf.identify(model, exact, by="tau")
    assert found.values[told] == pytest.approx(right, rel=1e-8)
    assert exact.tau is not None
    random = np.random.default_rng(0)
    given = exact.part(slice(None, None, 2))
    assert given.tau is not None
    tau = given.tau + TORQUES * random.normal(size=given.tau.shape)
    tau[[20, 50]] += [2.0, -1.5]
    given = replace(given, q=given.q + 1e-4 * random.normal(size=given.q.shape), qd=None, qdd=None, tau=tau)
    for kinds in (None, ["payload"]):
        found = hf.identify(model, given, by="tau", unknowns=kinds)
        z = (found.values[told] - right) / np.sqrt(np.diag(found.covariance))[told]
        assert np.abs(z).max() < 4.0
        assert any("2 samples are beyond chance and were left out, at 1.006, 2.516 s" in one for one in found.notes)
