"""Springs between bodies: the wrenches they are, energy, momentum, power, and the same in every way to compute them."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import link_poses, momentum_rate, potential_energy, power
from holdfast.dynamics.closed.force_elements import deformations
from holdfast.simulation.balance import WORK_TERMS
from tests.dynamics.problems import later
from tests.simulation.rollout.problems import arrays, assert_rollout_is_run
from tests.simulation.runs import assert_held_still, limp
from tests.systems import well_conditioned_system
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import random_problem, relative_gap
from tests.systems.sprung import with_springs

GRASPS = ("rigid", "hinge", "softfinger", "ball")


def sprung(seed: int) -> Problem:
    """Return a random chain of all grasps, everything on, with springs."""
    p = random_problem(seed, grasps=GRASPS, joints=(6, 7, 5, 4), moving_base=True)
    return replace(p, chain=with_springs(p.chain, seed))


def frame_of(p: Problem, end) -> hf.Pose:
    """Return the pose of the body that an end is on, by the library's poses of links and object."""
    if end.link is not None:
        return link_poses(p.chain.arms[end.body], p.state.q[p.chain.joints[end.body]])[end.link]
    return p.state.object_frame if end.body == "object" else hf.Pose.identity()


def ends_of(p: Problem, spring: hf.Spring):
    """Return where a spring's ends and the origins of their bodies are."""
    frames = [frame_of(p, end) for end in spring.ends]
    return [(frame.p + frame.R @ end.point, frame.p) for frame, end in zip(frames, spring.ends, strict=True)]


def with_wrenches(p: Problem, loads) -> hf.Inputs:
    """Return the inputs with wrenches added on the bodies of ends: (end, wrench) each."""
    given = p.inputs.shaped(p.chain)
    on_object, on_links = given.object_wrench.copy(), np.zeros((p.chain.joint_count, 6))
    if given.link_wrenches is not None:
        on_links += given.link_wrenches
    for end, wrench in loads:
        if end.link is not None:
            on_links[p.chain.joints[end.body].start + end.link] += wrench
        elif end.body == "object":
            on_object += wrench
    return replace(given, object_wrench=on_object, link_wrenches=on_links)


def stretched(p: Problem) -> np.ndarray:
    """Return how long the springs are."""
    found = []
    for spring in p.chain.springs:
        (a, _), (b, _) = ends_of(p, spring)
        found.append(np.linalg.norm(b - a))
    return np.array(found)


def rates(p: Problem) -> np.ndarray:
    """Return how fast the springs grow, by differences of positions."""
    h = 1e-6
    ahead, behind = (stretched(replace(p, chain=c, state=s)) for c, s in (later(p, h), later(p, -h)))
    return (ahead - behind) / (2 * h)


@pytest.mark.parametrize("seed", range(3))
def test_wrenches(seed):
    """A spring is two opposite forces on its line, given as external wrenches on links and object."""
    p, loads = sprung(seed), []
    chain, state = p.chain, p.state
    for spring, rate in zip(chain.springs, rates(p), strict=True):
        (a, _), (b, _) = ends_of(p, spring)
        s = np.linalg.norm(b - a)
        force = (spring.stiffness * (s - spring.length) + spring.damping * rate) * (b - a) / s
        for end, (at, origin), f in zip(spring.ends, ends_of(p, spring), (force, -force), strict=True):
            loads.append((end, np.r_[np.cross(at - origin, f), f]))
    acting = with_wrenches(p, loads)
    expected = hf.forward_dynamics(replace(chain, springs=()), state, p.tau, inputs=acting)
    found = hf.forward_dynamics(chain, state, p.tau, inputs=p.inputs)
    assert relative_gap(found.qdd, expected.qdd) < 1e-7  # of the differenced rates
    assert relative_gap(found.base_wrench, expected.base_wrench) < 1e-7
    rate = momentum_rate(chain, state, found, inputs=p.inputs)
    assert relative_gap(rate, momentum_rate(replace(chain, springs=()), state, expected, inputs=acting)) < 1e-7


@pytest.mark.parametrize("seed", range(2))
def test_methods_and_inverse(seed):
    """Dense algorithms agree, and forward dynamics of inverse dynamics is the identity."""
    p = sprung(seed)
    found = hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
    for method in ("kkt", "nonrigid"):
        other = hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs, method=method)
        assert relative_gap(other.qdd, found.qdd) < 1e-9
    tau = hf.inverse_dynamics(p.chain, p.state, found.qdd, found.grasp_wrench, p.inputs)
    assert relative_gap(tau, p.tau) < 1e-10


@pytest.mark.parametrize("seed", range(2))
def test_power(seed):
    """What springs store, and what dampers lose: c (ds/dt)^2."""
    p = sprung(seed)
    plain = replace(p.chain, springs=())
    found = hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
    stored = sum(0.5 * x.stiffness * (s - x.length) ** 2 for x, s in zip(p.chain.springs, stretched(p), strict=True))
    assert potential_energy(p.chain, p.state) - potential_energy(plain, p.state) == pytest.approx(stored, rel=1e-11)
    lost = sum(x.damping * rate**2 for x, rate in zip(p.chain.springs, rates(p), strict=True))
    with_, without = (power(chain, p.state, p.tau, found, p.inputs) for chain in (p.chain, plain))
    assert without.damping - with_.damping == pytest.approx(lost, rel=1e-6)


def still_bases(seed: int, *, damped: bool, joints=(4, 3)) -> tuple[hf.ClosedChain, hf.State, np.ndarray]:
    """Return a chain with springs on bases that stand still, its joints without damping, its state, and torques."""
    options = {"moving_base": False, "extras": False, "joint_speed": 0.7, "gravity": (0, 0, -9.81)}
    p = as_chain(well_conditioned_system(seed, joints=joints, grasps=["rigid", "ball", None][: len(joints)], **options))
    return with_springs(p.chain, seed, damped=damped), p.state, p.tau


@pytest.mark.slow
def test_machine_code():
    """Forward dynamics and energy, one system and many; an arm with a spring is of another type than its twin."""
    chain, state, tau = still_bases(3, damped=True, joints=(4, 3, 4))
    twin = {**chain.arms, "arm3": chain.arms["arm1"].at(chain.arms["arm3"].base)}
    chain = replace(chain, arms=twin)
    fast = hf.compile(chain)
    given = (state.q, state.qd, tau, state.object_pose, state.object_twist)
    expected, found = hf.forward_dynamics(chain, state, tau), fast.forward_dynamics(*given)
    many = fast.forward_dynamics(*(np.tile(x, (9, 1)) for x in given))
    for name in ("qdd", "grasp_wrench", "base_wrench", "object_acceleration"):
        assert relative_gap(getattr(found, name), getattr(expected, name)) <= 1e-11
        assert relative_gap(getattr(many, name)[8], getattr(expected, name)) <= 1e-11
    bases = {name: [*arm.base.wxyz_xyz[:4], *(arm.base.p + 0.1)] for name, arm in chain.arms.items()}
    moved = fast.forward_dynamics(*given, base_pose=list(bases.values()))
    expected_there = hf.forward_dynamics(chain.with_bases(bases), state, tau, check=False)
    assert relative_gap(moved.qdd, expected_there.qdd) <= 1e-11
    energy = fast.potential_energy(state.q, state.object_pose)
    assert energy == pytest.approx(potential_energy(chain, state), rel=1e-13)
    of_object = {"object_pose": state.object_pose, "object_twist": state.object_twist}
    back = fast.inverse_dynamics(state.q, state.qd, expected.qdd, expected.grasp_wrench, **of_object)
    assert relative_gap(back, tau) <= 1e-11


@pytest.mark.slow
def test_energy():
    """Kinetic, weights' and springs' energies together do not change."""
    chain, state, _ = still_bases(4, damped=False)
    run = hf.simulate(chain, state, limp, 0.05, 0.01, scheme="dop853", rtol=1e-13)
    assert run.stopped is None and np.ptp(run.potential) > 0.1
    damping = run.work[:, WORK_TERMS.index("damping")]
    assert np.ptp(run.kinetic + run.potential - damping) <= 1e-11 * np.abs(run.kinetic).max()


@pytest.mark.slow
def test_power_balance_of_a_run():
    """What is lost is what the dampers took, and momentum changes by what springs to the world pull."""
    chain, state, _ = still_bases(4, damped=True)
    run = hf.simulate(chain, state, limp, 0.03, 1e-3, scheme="dop853", rtol=1e-13)
    assert run.work[-1, WORK_TERMS.index("damping")] < -1e-3
    left = run.kinetic + run.potential - run.kinetic[0] - run.potential[0] - run.work.sum(axis=1)
    assert np.abs(left).max() <= 1e-11 * np.abs(run.kinetic).max()
    assert np.abs(run.momentum_imbalance).max() < 1e-6 * np.abs(run.momentum).max()


@pytest.mark.slow
def test_rollout():
    """Rollouts have the springs in their steps, and their work."""
    chain, state, _ = still_bases(4, damped=True)
    assert_rollout_is_run(chain, state)


@pytest.mark.parametrize("controlled", [False, True])
def test_holding(controlled):
    """Torques that hold the chain still, springs at links and object included."""
    options = {"moving_base": False, "extras": False, "joint_speed": 0.0, "gravity": (0, 0, -9.81)}
    p = as_chain(well_conditioned_system(5, joints=[6, 7], grasps=["rigid", "rigid"], **options))
    chain = with_springs(p.chain, 5)
    assert_held_still(chain, p.state, controlled)


def test_no_length():
    """At no length a spring of natural length 0 pulls nowhere, and neither does another; nothing is not a number."""
    p = as_chain(well_conditioned_system(1, joints=[6], grasps=["rigid"], moving_base=False, extras=False))
    plain = hf.forward_dynamics(p.chain, p.state, p.tau)
    for length in (0.0, 0.3):
        spring = hf.Spring(("object", (0, 0, 0)), ("world", p.state.object_pose[4:]), 50.0, length, 3.0)
        chain = replace(p.chain, springs=[spring])
        assert np.array_equal(hf.forward_dynamics(chain, p.state, p.tau).qdd, plain.qdd)
        fast = hf.compile(chain).forward_dynamics(**arrays(p.state), tau=p.tau)
        assert relative_gap(fast.qdd, plain.qdd) <= 1e-11


def test_links_by_name_and_what_is_refused():
    """A link by its name is the link of that number; each impossible end is refused with what there is."""
    links = [hf.Link(1.0, name="upper"), hf.Link(1.0, (0.1, 0, 0), np.eye(3) * 0.01, name="fore")]
    arm = hf.Arm([hf.Joint(), hf.Joint()], links)
    held = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)

    def chain(*springs):
        return hf.ClosedChain({"left": arm}, held, {}, springs=springs)

    world, zero = ("world", (0, 0, 1)), (0, 0, 0)
    by_name = chain(hf.Spring(("left", "fore", zero), world, 1.0))
    assert by_name.springs[0].a.link == 1
    assert replace(by_name, gravity=(0, 0, 0)).springs[0].a.link == 1
    for make, message in (
        (lambda: hf.Spring(("left", zero), world, 1.0), r"try \('left', link, point\)"),
        (lambda: hf.Spring("world", world, 1.0), "expected \\('world', point\\)"),
        (lambda: hf.Spring(world, ("object", (0, 0)), 1.0), "point on 'object'"),
        (lambda: hf.Spring(world, ("object", zero), -1.0), "stiffness: expected >= 0"),
        (lambda: hf.Spring(("left", 1.5, zero), world, 1.0), "expected a name or a number"),
        (lambda: chain(hf.Spring(("left", "for", zero), world, 1.0)), "Did you mean 'fore'"),
        (lambda: chain(hf.Spring(("left", 2, zero), world, 1.0)), "from 0 to 1, got 2"),
        (lambda: chain(hf.Spring(("right", 0, zero), world, 1.0)), "no arm 'right'"),
        (lambda: chain(3.0), "expected a list of Spring"),
    ):
        with pytest.raises(hf.errors.ModelError, match=message):
            make()


def test_mujoco():
    """MuJoCo's tendons, out of our MJCF, are as long and pull as our springs do."""
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")
    chain, state, _ = still_bases(4, damped=True)
    model = mujoco.MjModel.from_xml_string(hf.interop.to_mjcf(chain, state))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    n, springs = chain.joint_count, deformations(chain, state, hf.Inputs().shaped(chain))
    assert data.ten_length == pytest.approx([s.length for s in springs], rel=1e-12)
    assert data.ten_velocity == pytest.approx([s.rate for s in springs], abs=1e-12)
    # a spring's share of the joints' torques: what inverse dynamics asks for less without it
    qdd, none = np.zeros(n), np.zeros((len(chain.arms), 6))
    plain = replace(chain, springs=())
    share = hf.inverse_dynamics(plain, state, qdd, none) - hf.inverse_dynamics(chain, state, qdd, none)
    joint_damping = np.concatenate([arm.damping * state.qd[chain.joints[name]] for name, arm in chain.arms.items()])
    assert data.qfrc_passive[:n] + joint_damping == pytest.approx(share, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("question", [hf.forward_dynamics, hf.holding_torques, hf.control.GravityCompensation])
def test_overflow_names_the_spring(question):
    """A spring whose wrench overflows is named by its number and its bodies, not as a wrench that nobody gave."""
    chain, state, tau = still_bases(3, damped=True)
    far = hf.Spring(("world", (1e200, 0, 0)), ("object", (0, 0, 0)), 1e200)
    chain = replace(chain, springs=(*chain.springs, far))
    ask = {
        hf.forward_dynamics: lambda: hf.forward_dynamics(chain, state, tau),
        hf.holding_torques: lambda: hf.holding_torques(chain, state),
        hf.control.GravityCompensation: lambda: hf.control.GravityCompensation(chain)(0.0, state, None),
    }[question]
    place = f"wrench of spring {len(chain.springs) - 1}, from 'world' to 'object': expected finite numbers"
    with pytest.raises(hf.errors.StateError, match=place):
        ask()
