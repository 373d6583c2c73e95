"""Bushings: wrenches that are the gradient of what they store, oscillators, balances, the same in every way."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import kinetic_energy, momentum, momentum_rate, potential_energy, power
from holdfast.dynamics.energy import bodies
from holdfast.simulation.balance import WORK_TERMS
from holdfast.spatial import rotation
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from tests.laws.moving import moving
from tests.longer import mostly_long
from tests.oracles.differenced_positions import exact, rotation_about
from tests.simulation.rollout.problems import arrays, assert_rollout_is_run, without_torques
from tests.simulation.runs import limp
from tests.spatial.dual import slopes_of
from tests.systems.anchored import pinned_to_trunk
from tests.systems.as_chain import Problem
from tests.systems.bushed import bushed, random_bushed, still_bushed
from tests.systems.problems import random_problem, relative_gap
from tests.systems.trunk_problems import in_machine_code, on_trunk

ANSWERS = ("qdd", "grasp_wrench", "object_acceleration", "base_wrench", "contact_acceleration")
STEP = mpmath.mpf(10) ** -20


def tip_of(p: Problem, name: str) -> hf.Pose:
    """Return an arm's tip."""
    return hf.dynamics.tip_pose(p.chain.arms[name], p.state.q[p.chain.joints[name]])


def tip_twist_of(p: Problem, name: str) -> np.ndarray:
    """Return its twist, by differences of poses."""
    twist, arm = p.inputs.shaped(p.chain).base_twists[p.chain.names.index(name)], p.chain.arms[name]
    q, qd = p.state.q[p.chain.joints[name]], p.state.qd[p.chain.joints[name]]
    tip = hf.dynamics.tip_pose(arm, q).p
    return hf.dynamics.tip_jacobian(arm, q) @ qd + shift_twist(tip - arm.base.p, twist)


def stored(grasp: hf.Grasp, tip: hf.Pose, held: hf.Pose, dx) -> mpmath.mpf:
    """Return a bushing's energy after displacements of tip and object, [turn; shift] each, in sixty digits.

    x = [2 sin(t / 2) axis; shift]: the angle from the trace, the axis from the turn that is left of half a turn.
    """
    with mpmath.workdps(60):
        dx = [mpmath.mpf(0) + x for x in dx]
        R_t = rotation_about(np.array(dx[:3])) @ exact(tip.R)
        R_o = rotation_about(np.array(dx[6:9])) @ exact(held.R)
        p_t, p_o = exact(tip.p) + np.array(dx[3:6]), exact(held.p) + np.array(dx[9:])
        Q = R_t.T @ R_o @ exact(grasp.frame.R)
        p = R_t.T @ (p_o + R_o @ exact(grasp.frame.p) - p_t)
        angle = mpmath.acos((Q[0, 0] + Q[1, 1] + Q[2, 2] - 1) / 2)
        axis = np.array([Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]]) / (2 * mpmath.sin(angle))
        x = np.concatenate([2 * mpmath.sin(angle / 2) * axis, p])
        return x @ exact(np.array(grasp.of_kind.bushing.stiffness)) @ x / 2


@pytest.mark.parametrize("turned", [1e-3, 0.3, 1.5])
@pytest.mark.parametrize("seed", range(3))
def test_gradient(seed, turned):
    """At rest the wrenches on object and tip are minus the derivatives of the energy by their displacements."""
    p = random_problem(seed, joints=(6, 7), grasps=("rigid", "rigid"), moving_base=False, extras=False)
    p = bushed(replace(p, state=p.state.at_rest()), ("arm2",), seed, damped=False, turned=turned)
    p = replace(p, state=p.state.at_rest())
    grasp, tip, held = p.chain.grasps["arm2"], tip_of(p, "arm2"), p.state.object_frame
    slopes = []
    with mpmath.workdps(60):
        for unit in np.eye(12, dtype=int):
            ahead, behind = (stored(grasp, tip, held, sign * STEP * unit) for sign in (1, -1))
            slopes.append(float((ahead - behind) / (2 * STEP)))
    on_object, on_tip = -np.array(slopes[6:]), -np.array(slopes[:6])
    found = hf.forward_dynamics(p.chain, p.state, p.tau)["arm2"].grasp_wrench  # about the tip
    assert relative_gap(shift_wrench(tip.p - held.p, found), on_object) <= 1e-11
    assert relative_gap(-found, on_tip) <= 1e-11
    plain = replace(p.chain, grasps={"arm1": p.chain.grasps["arm1"]})
    energy = potential_energy(p.chain, p.state) - potential_energy(plain, p.state)
    assert energy == pytest.approx(float(stored(grasp, tip, held, np.zeros(12, dtype=int))), rel=1e-11)


@pytest.mark.parametrize("seed", range(3))
def test_an_external_wrench(seed):
    """A bushing is opposite wrenches on object and last link; its damper's is C V at the contact's origin, tip axes."""
    p = random_bushed(seed)
    chain, state, given = p.chain, p.state, p.inputs.shaped(p.chain)
    grasp, tip, held = chain.grasps["arm2"], tip_of(p, "arm2"), state.object_frame
    still = replace(p, state=state.at_rest(), inputs=hf.Inputs())
    slack = still.solved(check=False)["arm2"].grasp_wrench
    contact = held @ grasp.frame
    lever = contact.p - tip.p
    of_tip = shift_twist(lever, tip_twist_of(p, "arm2"))
    V = shift_twist(contact.p - held.p, state.object_twist) - of_tip
    V = V.reshape(2, 3) @ tip.R  # moving with the tip's link, v at the contact's origin already
    lost = np.array(grasp.of_kind.bushing.damping) @ V.ravel()
    damper = shift_wrench(lever, -(lost.reshape(2, 3) @ tip.R.T).ravel())
    f = slack + damper
    last = chain.joints["arm2"].stop - 1
    arm, q = chain.arms["arm2"], state.q[chain.joints["arm2"]]
    origin = hf.dynamics.link_poses(arm, q)[-1].p
    links = np.zeros((chain.joint_count, 6)) if given.link_wrenches is None else np.array(given.link_wrenches)
    links[last] -= shift_wrench(tip.p - origin, f)
    acting = replace(given, object_wrench=given.object_wrench + shift_wrench(tip.p - held.p, f), link_wrenches=links)
    expected = hf.forward_dynamics(chain.without_grasp("arm2"), state, p.tau, inputs=acting)
    found = p.solved()
    assert relative_gap(found["arm2"].grasp_wrench, f) <= 1e-12
    for name in ("qdd", "object_acceleration", "base_wrench"):
        assert relative_gap(getattr(found, name), getattr(expected, name)) <= 1e-11
    assert (found.rank, expected.rank) == (expected.rank + 6, found.rank - 6) and found.mobility == expected.mobility


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long(range(3), [0]))
def test_every_method(seed):
    """Dense equations, inverse dynamics and machine code, one system, many and bound; whose answers are the same."""
    p = random_bushed(seed)
    found, given, s = p.solved(), p.inputs.shaped(p.chain), p.state
    for method in ("kkt", "nonrigid"):
        other = p.solved(method=method)
        assert all(relative_gap(getattr(other, name), getattr(found, name)) <= 1e-9 for name in ANSWERS)
    with pytest.raises(hf.errors.MethodNotApplicable, match="'arm2' is a bushing"):
        p.solved(method="rccfd1")
    zeros = found.grasp_wrench * np.array([[1], [0], [1]])
    for f in (found.grasp_wrench, zeros):
        assert relative_gap(hf.inverse_dynamics(p.chain, s, found.qdd, f, p.inputs), p.tau) <= 1e-11
    with pytest.raises(hf.errors.StateError, match="arm 'arm2' holds by a bushing, which exerts"):
        hf.inverse_dynamics(p.chain, s, found.qdd, found.grasp_wrench + 1.0, p.inputs)
    fast = hf.compile(p.chain, parameters=["link_wrench"])
    acting = {"object_wrench": given.object_wrench, "link_wrench": given.link_wrenches}
    acting |= {"base_twist": given.base_twists, "base_acceleration": given.base_accelerations}
    one = fast.forward_dynamics(**arrays(s), tau=p.tau, **acting)
    many = fast.forward_dynamics(**{k: np.tile(x, (9, 1)) for k, x in {**arrays(s), "tau": p.tau}.items()}, **acting)
    for name in ANSWERS:
        assert relative_gap(getattr(one, name), getattr(found, name)) <= 1e-11
        assert relative_gap(getattr(many, name)[8], getattr(found, name)) <= 1e-11
    assert fast.potential_energy(s.q, s.object_pose) == pytest.approx(potential_energy(p.chain, s), rel=1e-12)
    assert fast.closure(s.q, s.qd, s.object_pose, s.object_twist)["arm2"].position.shape == (0,)
    acting = {name: acting[name] for name in ("link_wrench", "base_twist", "base_acceleration")}
    acting |= {"object_pose": s.object_pose, "object_twist": s.object_twist}
    for f in (found.grasp_wrench, zeros):
        assert relative_gap(fast.inverse_dynamics(s.q, s.qd, found.qdd, f, **acting), p.tau) <= 1e-11


def test_elsewhere_in_machine_code():
    """Contact frames and bases are run-time parameters of bushings too; an arm of another stiffness is another type."""
    p = still_bushed(1, damped=True)
    fast, random = hf.compile(p.chain), np.random.default_rng(0)
    frames = {name: grasp.frame @ hf.Pose(rotation.exp(0.1 * random.normal(size=3)), 0.02 * random.normal(size=3))
              for name, grasp in p.chain.grasps.items()}  # fmt: skip
    frames["arm1"] = p.chain.grasps["arm1"].frame
    moved = replace(p.chain, grasps={name: replace(g, frame=frames[name]) for name, g in p.chain.grasps.items()})
    poses = np.array([frame.wxyz_xyz for frame in frames.values()])
    found = fast.forward_dynamics(**arrays(p.state), tau=p.tau, grasp_pose=poses)
    expected = hf.forward_dynamics(moved, p.state, p.tau)
    assert relative_gap(found.qdd, expected.qdd) <= 1e-11
    assert relative_gap(found.grasp_wrench, expected.grasp_wrench) <= 1e-11
    energy = fast.potential_energy(p.state.q, p.state.object_pose, grasp_pose=poses)
    assert energy == pytest.approx(potential_energy(moved, p.state), rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_balances(seed):
    """Energy changes by what goes in and what dampers lose; momentum by weights, loads and bases."""
    p = random_bushed(seed)
    found = p.solved()
    chain, later, inputs = moving(p, found)
    slopes = [getattr(body.kinetic_energy, "tangent", 0.0) for body in bodies(chain, later, inputs)]
    armature = np.concatenate([arm.armature for arm in p.chain.arms.values()])
    supplied = power(p.chain, p.state, p.tau, found, p.inputs)
    plain = power(replace(p.chain, grasps={}), p.state, p.tau, found, p.inputs)
    h = 1e-6
    ahead, behind = (moved_by(p, sign * h) for sign in (1, -1))
    filling = (potential_energy(*ahead) - potential_energy(*behind)) / (2 * h)
    rate = sum(slopes) + armature * p.state.qd @ found.qdd + filling
    size = sum(map(abs, supplied)) + kinetic_energy(p.chain, p.state, p.inputs) + abs(filling)
    assert abs(supplied.total - rate) <= 1e-7 * size  # of the differenced energy
    assert supplied.damping < plain.damping - 1e-3 * abs(plain.damping)
    expected = slopes_of(momentum(chain, later, None, inputs))
    assert relative_gap(momentum_rate(p.chain, p.state, found, inputs=p.inputs), expected) <= 1e-10


def moved_by(p: Problem, dt: float) -> tuple[hf.ClosedChain, hf.State]:
    """Return chain and state moved along their velocities, in turns about fixed axes."""
    given = p.inputs.shaped(p.chain)
    bases = {
        name: hf.Pose(rotation.exp(dt * V[:3]) @ arm.base.R, arm.base.p + dt * V[3:])
        for (name, arm), V in zip(p.chain.arms.items(), given.base_twists, strict=True)
    }
    frame, V = p.state.object_frame, p.state.object_twist
    there = hf.Pose(rotation.exp(dt * V[:3]) @ frame.R, frame.p + dt * V[3:])
    return p.chain.with_bases(bases), hf.State(p.state.q + dt * p.state.qd, p.state.qd, there)


def oscillator(stiffness, damping=None, *, pose=None, gravity=(0, 0, 0)) -> Problem:
    """Return a body on a bushing at its mass centre, whose other side is anchored to the world."""
    body = hf.HeldObject(2.0, np.diag([0.03, 0.04, 0.05]))
    grasp = hf.Grasp("bushing", stiffness=stiffness, damping=damping)
    chain = hf.ClosedChain({"pin": hf.Anchor()}, body, {"pin": grasp}, gravity)
    state = hf.State([], [], hf.Pose.identity() if pose is None else pose)
    return Problem(chain, state, np.zeros(0), hf.Inputs())


@pytest.mark.slow
@pytest.mark.parametrize("steps", ["simulate", "rollout"])
def test_damped_oscillator(steps):
    """m x'' + c x' + k x = 0 along each axis, each at its own rate."""
    k, c, x0, t = np.array([50.0, 80.0, 200.0]), np.array([0.0, 2.0, 5.0]), np.array([0.1, -0.05, 0.02]), 0.8
    p = oscillator([1, 1, 1, *k], [0, 0, 0, *c], pose=hf.Pose.translation(*x0))
    if steps == "simulate":
        run = hf.simulate(p.chain, p.state, limp, t, 0.1, scheme="dop853", rtol=1e-12, atol=1e-13)
        x, v = run.object_pose[-1, 4:], run.object_twist[-1, 3:]
        lost = run.work[-1, WORK_TERMS.index("damping")]
        change = run.kinetic[-1] + run.potential[-1] - run.kinetic[0] - run.potential[0]
        assert lost < -1e-2 and change == pytest.approx(lost, rel=1e-9)
        tolerance = 1e-11
    else:
        after = without_torques(p.chain, p.state, t, t / 2000)
        x, v, tolerance = after.object_pose[0, 4:], after.object_twist[0, 3:], 1e-9
    m, d = 2.0, c / 4.0
    w = np.sqrt(k / m - d**2)
    decay = np.exp(-d * t)
    expected = decay * x0 * (np.cos(w * t) + d / w * np.sin(w * t))
    assert np.abs(x - expected).max() <= tolerance
    assert np.abs(v + decay * x0 * (k / m) / w * np.sin(w * t)).max() <= 10 * tolerance


def test_a_turn_is_a_pendulums():
    """Of one stiffness k about all axes it stores k (1 - cos t) of a turn by t, and turns back by k sin t."""
    k, n = 3.0, np.array([0.36, 0.48, 0.8])
    for t in (0.1, 1.0, 3.0, np.pi):
        p = oscillator([k, k, k, 0, 0, 0], pose=hf.Pose(rotation.exp(t * n), np.zeros(3)))
        assert potential_energy(p.chain, p.state) == pytest.approx(k * (1 - np.cos(t)), rel=1e-12)
        found = p.solved()
        assert found["pin"].grasp_wrench == pytest.approx(np.r_[-k * np.sin(t) * n, 0, 0, 0], abs=1e-12)
        assert found["pin"].base_wrench == pytest.approx(found["pin"].grasp_wrench, abs=1e-12)


def test_sag():
    """A body hangs on its bushing by m g / k, and is at rest there."""
    p = oscillator([5, 5, 5, 300, 300, 100], pose=hf.Pose.translation(0, 0, -2.0 * 9.81 / 100), gravity=(0, 0, -9.81))
    assert np.abs(p.solved().object_acceleration).max() <= 1e-13
    assert p.solved()["pin"].grasp_wrench == pytest.approx([0, 0, 0, 0, 0, 2.0 * 9.81], rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("floating", mostly_long([False, True], [True]))
def test_on_a_trunk(floating):
    """Arms on a trunk hold by bushings, and an anchor on it does: as the dense equations and machine code say."""
    p = on_trunk(random_problem(2, arms=3, joints=7, grasps="rigid", moving_base=False), 2, 2, floating=floating)
    p = bushed(pinned_to_trunk(p, "rigid", 2), ("arm1", "pin"), 2)
    found = p.solved()
    for other in (p.solved(method="kkt"), in_machine_code(p)):
        for name in ("qdd", "grasp_wrench", "object_acceleration", "base_wrench"):
            assert relative_gap(getattr(other, name), getattr(found, name)) <= 1e-11
    assert np.abs(found["pin"].grasp_wrench).max() > 1
    torques = hf.inverse_dynamics(p.chain, p.state, found.qdd, found.grasp_wrench, p.inputs, found.base_acceleration)
    assert relative_gap(torques, p.tau, np.abs(found.grasp_wrench).max()) <= 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("damped", mostly_long([True, False], [True]))
def test_runs(damped):
    """Energy is kept, or lost as the dampers say; rollouts take the same steps."""
    p = still_bushed(2, damped=damped)
    run = hf.simulate(p.chain, p.state, limp, 0.05, 0.01, scheme="dop853", rtol=1e-12, atol=1e-13)
    left = run.kinetic + run.potential - run.kinetic[0] - run.potential[0] - run.work.sum(axis=1)
    assert np.abs(left).max() <= 1e-11 * run.kinetic.max() and np.ptp(run.potential) > 0.1
    assert_rollout_is_run(p.chain, p.state, relative_to_energy=True)


def test_gripped_by_a_bushing():
    """An arm grips by a bushing where it is, which is slack then, and lets go; without an impulse."""
    p = still_bushed(3, damped=True)
    grasp = p.chain.grasps["arm2"]
    chain = p.chain.without_grasp("arm2")
    events = [hf.Attach(0.004, "arm2", grasp, here=True), hf.Release(0.008, "arm2")]
    run = hf.simulate(chain, p.state, limp, 0.012, 1e-3, events=events)
    assert run.stopped is None and abs(run.impact[-1]) <= 1e-20
    k = int(np.searchsorted(run.t, 0.006))
    assert np.abs(run.grasp_wrench[k, 1]).max() > 0 == np.abs(run.grasp_wrench[-1, 1]).max()
    gripped = next(i for i in range(len(run.t)) if run.holding[i, 1])
    assert run.potential[gripped] == pytest.approx(run.potential[gripped - 1], abs=1e-9)


def test_closed_and_assembled():
    """Closing and projecting leave bushings as they are; assembling brings arms to where they are slack."""
    p = still_bushed(1, damped=True)
    off = replace(p.state, q=p.state.q + 1e-3)
    closed = hf.close(p.chain, off)
    gaps = hf.dynamics.closure(p.chain, closed)
    assert gaps["arm2"].position.shape == gaps["arm2"].velocity.shape == (0,)
    assert np.abs(gaps["arm1"].position).max() <= 1e-12
    part = p.chain.joints["arm2"]
    assert closed.q[part] == pytest.approx(off.q[part], abs=1e-12)
    assert hf.project(p.chain, closed)[0].q[part] == pytest.approx(off.q[part], abs=1e-12)
    found = hf.assemble(p.chain.arms, p.chain.held_object, p.chain.grasps, object_pose=p.state.object_frame)
    assert found.chain.grasps["arm2"].kind == "bushing"
    slack = hf.forward_dynamics(*found, np.zeros(13))["arm2"].grasp_wrench
    assert np.abs(slack).max() <= 1e-7
    assert "closed to 0.0e+00" in str(found.report)


def test_held_still():
    """Torques that hold the chain still bear what the bushing does; shares count it as carrying."""
    p = still_bushed(4, damped=True)
    p = replace(p, state=p.state.at_rest())
    tau = hf.holding_torques(p.chain, p.state, internal_force=5.0)
    found = hf.forward_dynamics(p.chain, p.state, tau)
    assert np.abs(found.object_acceleration).max() <= 1e-9 * np.abs(tau).max()
    command, _ = hf.control.GravityCompensation(p.chain, internal_force=5.0)(0.0, p.state, None)
    held = hf.forward_dynamics(p.chain, p.state, command)
    assert np.abs(held.object_acceleration).max() <= 1e-9 * np.abs(tau).max()
    parts = hf.forces.split(p.chain, p.state, found.grasp_wrench)
    assert relative_gap(parts.motion + parts.internal, found.grasp_wrench) <= 1e-12
    assert np.abs(parts.motion[1]).max() > 1e-3
    across = hf.forces.last_joint_wrenches(p.chain, p.state, found)
    joint = p.chain.arms["arm2"].joints[-1]
    along = across[1] @ np.concatenate([np.zeros(3) if h is None else h for h in joint.motion_subspace])
    drive = tau[p.chain.joints["arm2"]][-1] - joint.armature * found.qdd[p.chain.joints["arm2"]][-1]
    assert along == pytest.approx(drive, rel=1e-9, abs=1e-9)
    limited = replace(p.chain.grasps["arm2"], wrench_limits=hf.WrenchLimits(force=1e3))
    margins = hf.forces.grasp_margins(replace(p.chain, grasps={**p.chain.grasps, "arm2": limited}), p.state,
                                      found.grasp_wrench)  # fmt: skip
    assert margins[1] == pytest.approx(1e3 - np.linalg.norm(found["arm2"].grasp_wrench[3:]), rel=1e-9)


def test_what_is_refused():
    """No stiffness, another kind's, shapes and matrices that would give energy away; MJCF has no bushing."""
    for make, message in (
        (lambda: hf.Grasp("bushing"), r"needs a stiffness, \(6,\) or \(6, 6\), turns first; try np.zeros\(6\)"),
        (lambda: hf.Grasp("rigid", stiffness=np.ones(6)), "a rigid grasp has no stiffness; try a bushing"),
        (lambda: hf.Grasp("ball", damping=np.ones(6)), "a ball grasp has no damping"),
        (lambda: hf.Grasp("bushing", stiffness=np.ones(3)), r"expected shape \(6,\) or \(6, 6\), got shape \(3,\)"),
        (lambda: hf.Grasp("bushing", stiffness=[1, 1, 1, 1, 1, -1]), "stiffness: expected numbers >= 0"),
        (lambda: hf.Grasp("bushing", stiffness=np.arange(36.0).reshape(6, 6)), "expected a symmetric matrix"),
        (lambda: hf.Grasp("bushing", stiffness=np.eye(6) + 2 * np.eye(6)[::-1]), "positive semidefinite"),
        (lambda: hf.Grasp("bushing", stiffness=np.ones(6), damping=-np.eye(6)), "damping: expected numbers >= 0"),
        (lambda: hf.Grasp("bushing", contact=hf.Friction(0.5), stiffness=np.ones(6)), "two-sided"),
    ):
        with pytest.raises(hf.errors.ModelError, match=message):
            make()
    p = oscillator(np.ones(6))
    with pytest.raises(hf.errors.ModelError, match=r"no equality of MJCF says what a bushing grasp does"):
        hf.interop.to_mjcf(p.chain)
