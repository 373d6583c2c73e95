"""Rollouts on bases that move, under wrenches on links, with links of their own, up to joint limits: as `simulate`."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast import ClosedChain, ControlLaw, Friction, Inputs, Pose, State, compile_rollout, simulate
from holdfast.compiler.errors import CompileError
from holdfast.dynamics import closure, kinetic_energy
from holdfast.errors import StateError
from holdfast.scenario.parts import SwayingBase
from holdfast.simulation import Rollout, RolloutStatus, RolloutSystems, Trajectory
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.compiled_steppers import stepper_for
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.runge_kutta import RK4
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.spatial import rotation
from holdfast.spatial.scalar import concatenate, cos, sin
from tests.compiler.programs import same_bits
from tests.simulation.gantries import squeezed
from tests.simulation.rollout.problems import arrays, difference, generic_rank, numbers, problem, swinging_law, tiled

STEP, STEPS = 1e-3, 20
AGREEMENT = 1e-11  # gaps of projection apart, steps are the same to rounding

Motion = Callable[[Any], tuple[Any, Any, Any]]
DAMPING = 1000.0  # N s/m of every slide: 600 1/s
LAW = ControlLaw(lambda t, state, memory, given: (np.array([0.0, 0.0, 30.0 + t, 0.0, 0.0, 30.0 - t]), memory))


def shaken(base: Pose, seed: int, quaternion: bool) -> Motion:
    """Return the motion of a base that turns and shifts about where it stands, starting from there."""
    random = np.random.default_rng(seed)
    turning, shift, rate = random.normal(size=3), 0.05 * random.normal(size=3), 5.0
    w0 = base.wxyz_xyz[:4]

    def motion(t: Any) -> tuple[Any, Any, Any]:
        p = base.p + shift * sin(rate * t)
        twist = concatenate([turning, rate * shift * cos(rate * t)])
        acceleration = concatenate([np.zeros(3), -(rate**2) * shift * sin(rate * t)])
        if quaternion:
            wxyz = rotation.quaternion_product(rotation.quaternion_exp(turning * t), w0)
            return concatenate([wxyz, p]), twist, acceleration
        return Pose(rotation.exp(turning * t) @ base.R, p), twist, acceleration

    return motion


def motions(chain: ClosedChain, every: int = 2) -> dict[str, Motion]:
    """Return motions of every second base or of all, one of them given as a quaternion."""
    return {arm: shaken(chain.arms[arm].base, k, k == 0) for k, arm in enumerate(chain.names) if k % every == 0}


def carried_along(chain: ClosedChain, state: State, bases: dict[str, Motion]) -> State:
    """Return the state nearest to one whose velocities the moving bases allow at t = 0."""
    return hf.project(chain, state, Environment(chain, bases).at(0.0, state)[1])[0]


def reference(chain: ClosedChain, state: State, law: ControlLaw, steps: int, step: float = STEP, **options: Any) -> Any:
    """Return a run of the reference's steps that goes on where a grasp slips."""
    options = {"make_stepper": ReferenceStepper, "on_slip": "record"} | options
    return hf.simulate(chain, state, law, steps * step, step, **options)


def agree(systems: RolloutSystems, row: int, run: Trajectory) -> None:
    """Compare one system with the last sample of a run."""
    assert run.stopped is None and systems.running[row]
    names = ("t", "q", "qd", "qdd", "tau", "object_pose", "object_twist", "object_acceleration", "grasp_wrench", "work")
    expected = {name: np.array(getattr(run, name)[-1]) for name in names}
    found = {name: np.array(getattr(systems, name)[row]) for name in names}
    assert difference(found, expected) <= AGREEMENT


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scheme"), [("five", "midpoint"), pytest.param("legs", "rk4", marks=pytest.mark.long)]
)
def test_moving_bases(name, scheme):
    """A law of time, state and memory on bases that turn and shift; another system stands a little elsewhere."""
    chain, state = problem(name)
    bases, law = motions(chain), swinging_law(chain.joint_count)
    state = carried_along(chain, state, bases)
    rollout = compile_rollout(chain, law, scheme=scheme, base_motion=bases)
    where = tiled(state, 2)
    where["qd"][1] *= 1.001
    systems = rollout.start(**where)
    rollout.step(systems, STEP, steps=STEPS)
    agree(systems, 0, reference(chain, state, law, STEPS, base_motion=bases, scheme=scheme))
    assert systems.running.all() and systems.gap.max() <= 1e-12
    there = Environment(chain, bases).chain_at(STEPS * STEP)
    gaps = closure(there, systems.state(1)).values()
    assert max((np.abs(gap.position).max() for gap in gaps), default=0.0) <= 1e-12
    assert not np.allclose(systems.q[0], systems.q[1], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_moving_bases_travel():
    """A rollout whose bases' motions are closures goes on to the same bits after a pickle, and recompiles to them."""
    chain, state = problem("nobody holds")
    bases, law = motions(chain, 1), swinging_law(chain.joint_count)
    rollout = compile_rollout(chain, law, scheme="midpoint", base_motion=bases)
    systems = rollout.start(**arrays(carried_along(chain, state, bases)))
    other, there = pickle.loads(pickle.dumps((rollout, systems)))
    for name, motion in other.base_motion.items():
        (mine, *rates), (theirs, *others) = (
            Environment(chain, {name: motion}).at(0.3, state),
            Environment(chain, {name: bases[name]}).at(0.3, state),
        )
        assert np.abs(mine.arms[name].base.R - theirs.arms[name].base.R).max() <= 1e-15
        assert np.array_equal(rates[0].base_twists, others[0].base_twists)
    rollout.step(systems, STEP, steps=3)
    other.step(there, STEP, steps=3)
    assert all(same_bits(x, there.arrays[key]) for key, x in systems.arrays.items())


@pytest.mark.slow
def test_scenes_bases_are_machine_code():
    """The swaying bases of scenes are part of a step; it is the reference's."""
    chain, state = problem("legs")
    random = np.random.default_rng(4)
    bases = {
        name: SwayingBase(arm.base, *(random.uniform(0.05, 2.0, 6) * size for size in (0.02, 1.0, 1.0)), 0.02)
        for name, arm in chain.arms.items()
    }
    environment, law, rank = Environment(chain, bases), swinging_law(chain.joint_count), generic_rank(chain, state)
    stepper = stepper_for(environment, law, rank, RK4, Tolerance(), 1000)
    assert isinstance(stepper, FusedStepper)
    found, expected = (
        one.advance(one.start(0.0, state, None)[0], [0.01])[0].instant
        for one in (stepper, ReferenceStepper(environment, law, rank, RK4))
    )
    assert found is not None and expected is not None
    assert difference(numbers(found), numbers(expected)) <= 1e-12


def test_what_no_base_does():
    """Motions of no arm, poses of bases that move, quaternions that are none, functions that cannot be traced."""
    chain, state = problem("nobody holds")
    name = chain.names[0]
    base = chain.arms[name].base
    zeros = np.zeros(6)

    def moved(motion: Motion, name: str = name) -> Rollout:
        return compile_rollout(chain, scheme="midpoint", base_motion={name: motion})

    with pytest.raises(hf.errors.ModelError, match="base motion 'nobody': no such arm"):
        moved(lambda t: (base, zeros, zeros), "nobody")
    tau = np.zeros(chain.joint_count)
    for pose in (lambda t: (1.0 + t) * base.wxyz_xyz, lambda t: Pose(base.R * (1.0 + t), base.p)):
        rollout = moved(lambda t, pose=pose: (pose(t), zeros, zeros))
        systems = rollout.start(**arrays(state), tau=tau)
        assert systems.running.all()
        rollout.step(systems, STEP)
        assert systems.status[0] is RolloutStatus.BROKEN and systems.t[0] == 0.0
        with pytest.raises(StateError, match=f"base_pose: expected none, as {name} moves"):
            rollout.step(systems, STEP, base_pose=np.array([arm.base.wxyz_xyz for arm in chain.arms.values()]))
    branching = moved(lambda t: (base, zeros if t < 1 else 1 + zeros, zeros))
    with pytest.raises(CompileError, match=r"test_surroundings\.py"):
        branching.start(**arrays(state), tau=tau)


@pytest.mark.slow
def test_links():
    """Wrenches on the links and inertias of the links, given per system and kept."""
    chain, state = problem("one")
    law, n = swinging_law(chain.joint_count), chain.joint_count
    rollout = compile_rollout(chain, law, scheme="midpoint", parameters=["link_wrench", "link_inertia"])
    random = np.random.default_rng(3)
    links = [link for arm in chain.arms.values() for link in arm.links]
    wrench, factor = random.normal(size=(2, n, 6)), random.uniform(0.8, 1.2, (2, n))
    heavier = {
        "link_mass": factor * [link.mass for link in links],
        "link_com": np.array([[link.com for link in links]] * 2),
        "link_inertia": factor[..., None, None] * [link.inertia for link in links],
    }
    where = tiled(state, 2)
    systems = rollout.start(**where, **heavier)
    rollout.step(systems, STEP, steps=STEPS // 2, link_wrench=wrench)
    rollout.step(systems, STEP, steps=STEPS - STEPS // 2)
    for row in range(2):
        other, k = {}, 0
        for name, arm in chain.arms.items():
            scaled = zip(factor[row, k:], arm.links, strict=False)
            links = [hf.Link(x * link.mass, link.com, x * link.inertia) for x, link in scaled]
            other[name], k = replace(arm, links=links), k + arm.joint_count
        given = {"scheme": "midpoint", "inputs": Inputs(link_wrenches=wrench[row])}
        agree(systems, row, reference(replace(chain, arms=other), state, law, STEPS, **given))
    with pytest.raises(StateError, match=r"link_wrench: the machine code .* parameters=\['link_wrench'\]"):
        compile_rollout(chain, law).start(**arrays(state), link_wrench=wrench[0])
    with pytest.raises(StateError, match="rollout: no optional parameter 'link_mass'"):
        compile_rollout(chain, law, parameters=["link_mass"])


def growing(joint_count: int) -> ControlLaw:
    """Return torques that grow with time."""
    size = np.random.default_rng(1).normal(size=joint_count)
    return ControlLaw(
        lambda t, state, memory, given: ((2.0 + 40.0 * t) * size - state.qd, memory), key="tests: growing"
    )


def limited(chain: ClosedChain, number: int, limits: dict[str, Any]) -> ClosedChain:
    """Return the chain with limits on the joint of a number."""
    arms, k = dict(chain.arms), number
    for name, arm in chain.arms.items():
        if 0 <= k < arm.joint_count:
            joints = list(arm.joints)
            joints[k] = replace(joints[k], **limits)
            arms[name] = replace(arm, joints=joints)
        k -= arm.joint_count
    return replace(chain, arms=arms)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["position", "rate", "effort"])
def test_joint_limits(quantity):
    """A system stops where `simulate` does, to the instant; without the option it goes on and its margins are known."""
    chain, state = problem("one")
    law, array = growing(chain.joint_count), {"position": "q", "rate": "qd", "effort": "tau"}[quantity]
    free = compile_rollout(chain, law, scheme="midpoint")
    course = free.run(free.start(**arrays(state)), STEPS * STEP, STEP, record=(array,))[array][:, 0]
    course = course if quantity == "position" else np.abs(course)
    joint = int(np.argmax((np.diff(course, axis=0) > 0.0).all(axis=0)))
    bound = float(course[12:14, joint].mean())  # reached in the thirteenth step
    limit = {"position_limits": (-10.0, bound)} if quantity == "position" else {f"{quantity}_limit": bound}
    there = limited(chain, joint, limit)
    rollout = compile_rollout(there, law, scheme="midpoint")
    systems = rollout.start(**arrays(state))
    record = rollout.run(systems, STEPS * STEP, STEP, stop_at_limits=True)
    run = reference(there, state, law, STEPS, on_limit="stop", scheme="midpoint")
    assert run.stopped is not None and f"{there.joint_names()[joint]}' reaches its {quantity} limit" in run.stopped
    assert record.systems.status[0] is RolloutStatus.LIMITED
    assert record.systems.t[0] == pytest.approx(12 * STEP, abs=1e-15)
    assert record.stopped[0] == pytest.approx(run.occurrences[-1].t, abs=1e-11)
    last = ["position", "rate", "effort"].index(quantity)
    assert np.unravel_index(np.argmin(record.systems.joint_margin[0]), (3, there.joint_count)) == (last, joint)
    assert 0.0 <= record.systems.joint_margin[0, last, joint] < np.ptp(course[:, joint])
    on = rollout.run(systems, STEPS * STEP, STEP)
    assert on.systems.running.all() and on.systems.joint_margin[0, last, joint] < 0.0
    plain = free.run(free.start(**arrays(state)), STEPS * STEP, STEP).systems
    assert same_bits(on.systems.q, plain.q) and same_bits(on.systems.grasp_wrench, plain.grasp_wrench)


@pytest.mark.parametrize(("share", "status"), [(0.1, RolloutStatus.LIMITED), (0.4, RolloutStatus.SLIPPED)])
def test_which_comes_first(share, status):
    """Where a grasp slips and a joint passes its limit within one step, the earlier one is the status."""
    chain, state = squeezed(("ball", "ball"), (Friction(0.5025), Friction(2.0)))

    def torque(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
        return np.array([30.0, 0.0, 600.0 * t, -30.0, 0.0, 600.0 * t]), memory

    slip, limit = 0.05025, (50 + share) * STEP  # each contact passes on half of one push: mu f_n = 300 t
    law = ControlLaw(torque, key="tests: pushed harder and harder")
    rollout = compile_rollout(limited(chain, 2, {"effort_limit": 600.0 * limit}), law, scheme="midpoint")
    record = rollout.run(rollout.start(**arrays(state)), 0.06, STEP, least_margin=0.0, stop_at_limits=True)
    assert record.systems.status[0] is status
    assert record.stopped[0] == pytest.approx(min(slip, limit), abs=1e-9)


def test_a_step_too_long_shows_no_limit():
    """Where damping makes rates and torques grow from step to step, no limit is passed: the step is too long."""
    chain, state = squeezed(("ball", "ball"), effort_limit=200.0, rate_limit=5.0)

    def torque(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
        up = 10.0 * t
        return np.array([30.0, 0.0, up, -30.0, 0.0, up]) - given["gain"] * state.qd, memory

    rollout = compile_rollout(chain, ControlLaw(torque, parameters={"gain": ()}))
    gain = np.array([0.0, 1.0, 4.0, 10.7, 30.0, 1e3]) * 2.0 / STEP  # over inertia: what a step may follow, and far more
    systems = rollout.start(**tiled(state, 6), gain=gain)
    record = rollout.run(systems, 60 * STEP, STEP, stop_at_limits=True)
    assert list(record.systems.status) == [RolloutStatus.RUNNING] * 2 + [RolloutStatus.TOO_LONG] * 4


@pytest.mark.slow
def test_long_steps_are_parted():
    """Steps that drift too far go in as many parts as in `simulate`, in each system as many as it needs."""
    chain, state = problem("legs")
    law = growing(chain.joint_count)
    rollout = compile_rollout(chain, law)
    speeds, step, limit = (0.5, 1.0), 1e-2, 6e-10
    where = {key: np.array([x] * len(speeds)) for key, x in arrays(state).items()}
    for name in ("qd", "object_twist"):
        where[name] *= np.array(speeds)[:, None]
    initial = rollout.start(**where)
    systems = rollout.step(initial.copy(), step, steps=5, largest_drift=limit)
    whole = rollout.step(initial.copy(), step, steps=5)
    for row in range(len(speeds)):
        run = reference(chain, initial.state(row), law, 5, step, largest_drift=limit, on_slip="stop")
        agree(systems, row, run)
        assert systems.drift[row] == pytest.approx([run.position_gap[-1, 0], run.velocity_gap[-1, 0]], abs=1e-12)
    assert (systems.drift[:, 0] <= 2 * limit).all()
    for name in ("q", "qd", "work"):  # the second needs no parts: the bits of whole steps
        same = [same_bits(a, b) for a, b in zip(getattr(systems, name), getattr(whole, name), strict=True)]
        assert same == [False, True]
    record = rollout.run(initial, 5 * step, step, largest_drift=limit)
    assert same_bits(record.systems.q, systems.q) and same_bits(record.systems.t, systems.t)


@pytest.mark.slow
def test_grasps_that_open_and_close():
    """A rollout that takes over lets go and grips as the events of `simulate`, impulse included.

    Steps are short: where a grasp is open when it closes, the order of closing it and of the impulse matters.
    """
    chain, state = problem("five")
    law, name, step = growing(chain.joint_count), list(chain.grasps)[3], 1e-5
    without = replace(chain, grasps={arm: grasp for arm, grasp in chain.grasps.items() if arm != name})
    held, free = (compile_rollout(one, law, scheme="midpoint") for one in (chain, without))
    gravity = np.array([0.0, 0.5, -9.0])
    where = tiled(state, 2)
    systems = held.step(held.start(**where, gravity=gravity), step, steps=5)
    before = systems.copy()
    let_go = free.step(free.take_over(systems), step)
    gripped = held.take_over(let_go)
    impact = kinetic_energy(chain, let_go.state(1)) - kinetic_energy(chain, gripped.state(1))
    end = held.step(gripped, step, steps=4)
    events = [hf.Release(5 * step, name), hf.Attach(6 * step, name, chain.grasps[name])]
    run = reference(replace(chain, gravity=gravity), state, law, 10, step, events=events, scheme="midpoint")
    agree(end, 0, run)
    assert impact > 1e-9 and -run.impact[-1] == pytest.approx(impact, rel=0.01)
    assert all(same_bits(x, systems.arrays[key]) for key, x in before.arrays.items())
    for steps, measured in ((3, True), (30, False)):  # some 40 micrometres away, and more than a centimetre
        away = free.step(free.take_over(systems), STEP, steps=steps)
        far = held.take_over(away)
        assert (far.status == RolloutStatus.OPEN).all() and same_bits(far.q, away.q) and same_bits(far.t, away.t)
        assert not measured or (far.drift[:, 0] > 1e-6).all()
    with pytest.raises(StateError, match="systems: expected those of a rollout with the joints"):
        held.take_over(compile_rollout(problem("one")[0]).start(**arrays(problem("one")[1]), tau=np.zeros(6)))


@pytest.fixture(scope="module")
def damped():
    """Return a damped gantry, where it is, and its rollout."""
    chain, state = squeezed(("ball", "ball"), damping=DAMPING)
    return chain, state, compile_rollout(chain, LAW, scheme="midpoint")


@pytest.mark.slow
def test_as_simulate(damped):
    """Steps of 20 ms are implicit, steps of 1 ms are not, side by side."""
    chain, state, rollout = damped
    systems = rollout.start(**{name: np.array([x, x]) for name, x in arrays(state).items()})
    rollout.step(systems, np.array([2e-2, 1e-3]), steps=10)
    assert systems.running.all()
    for row, (step, implicit) in enumerate([(2e-2, True), (1e-3, False)]):
        run = simulate(chain, state, LAW, 10 * step, step, scheme="midpoint")
        assert [one.kind for one in run.occurrences] == ["stiff" if implicit else "unresolved"]
        found = systems.state(row)
        assert found.q == pytest.approx(run.q[-1], abs=1e-12)
        assert found.qd == pytest.approx(run.qd[-1], abs=1e-12)


@pytest.mark.slow
def test_systems_do_not_depend_on_each_other(damped):
    """The bits of a system that takes implicit steps are the same alone, among others, and on two threads."""
    _, state, rollout = damped
    given = {name: np.array([x, x, x]) for name, x in arrays(state).items()}
    given["qd"][1] *= 1.0 + 1e-3
    steps = np.array([2e-2, 2e-2, 1e-3])
    some, threaded = rollout.start(**given), rollout.start(**given)
    rollout.step(some, steps, steps=3)
    rollout.step(threaded, steps, steps=3, threads=2)
    assert all(same_bits(x, threaded.arrays[name]) for name, x in some.arrays.items())
    for row, step in enumerate(steps):
        alone = rollout.start(**{name: x[row] for name, x in given.items()})
        rollout.step(alone, step, steps=3)
        assert same_bits(alone.q[0], some.q[row]) and same_bits(alone.grasp_wrench[0], some.grasp_wrench[row])
