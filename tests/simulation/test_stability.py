"""How fast damped chains settle; steps that cannot follow become implicit, or are named: none of it is a slip."""

import pickle
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast import ClosedChain, Friction, Release, State, WrenchLimits, forward_dynamics, simulate
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.dynamics import state_from_joints
from holdfast.errors import StepTooLongError
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.simulation.joint_friction import SMOOTHING_RATE, friction_slope, friction_torque
from holdfast.simulation.runge_kutta import RK4, SCHEMES, scheme
from holdfast.simulation.stability import fastest_decay, feedback_resistance, passive_resistance
from tests.control.two_pandas import rubber_pandas
from tests.longer import mostly_slow
from tests.simulation.damped import outcome, problem
from tests.simulation.gantries import squeezed
from tests.simulation.one_step import one_step
from tests.simulation.problems import PROBLEMS
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain

DAMPING = 1000.0  # N s/m of every slide
TURN = 0.6 * DAMPING  # 1/s: block and slides, 0.01333 + 2 * 0.1^2 kg m^2, turn about y and z
BALLS = ("ball", "ball")
SQUEEZE = 100.0  # N
RUBBER = Friction(0.5)
STEP = 1e-3
SEEDS = (9, 8)  # of random chains; h times their fastest rates are 0.64 and 325
SLIP = re.compile(r"^grasp '\w+' (slips|lifts off|gives way)")


def lifting(t, state, memory):
    """Push both slides up with 30 N."""
    return np.array([0.0, 0.0, 30.0, 0.0, 0.0, 30.0]), memory


@pytest.mark.parametrize("name", SCHEMES)
def test_stability_interval(name):
    """Steps of y' = -y grow beyond it and shrink before it."""
    tableau = scheme(name)
    x = tableau.stability_interval
    after = [abs(one_step(lambda t, y: -y, 0.0, np.ones(1), f * x, tableau)[0][0]) for f in (0.999, 1.001)]
    assert after[0] < 1.0 < after[1]
    shrinking = [one_step(lambda t, y: -y, 0.0, np.ones(1), f * x, tableau)[0] for f in np.arange(1, 100) / 100]
    assert np.abs(shrinking).max() < 1.0


def test_known_intervals():
    """2 for the midpoint rule, 2.785 for the classical one."""
    assert scheme("midpoint").stability_interval == pytest.approx(2.0, abs=1e-12)
    assert RK4.stability_interval == pytest.approx(2.7852935634, abs=1e-9)


def test_decay_on_paper():
    """Slides that carry a block between two balls: turning is damped fastest, by the slides across."""
    chain, state = squeezed(BALLS, damping=DAMPING)
    found = fastest_decay(chain, state, passive_resistance(chain, state.qd))
    assert found.rate == pytest.approx(TURN, rel=1e-12)
    assert found.joint.split("/")[1] in "yz"
    free, at = squeezed((None, None), damping=DAMPING)
    assert fastest_decay(free, at, passive_resistance(free, at.qd)).rate == pytest.approx(DAMPING, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_decay_of_forward_dynamics(seed):
    """The fastest rate is the largest eigenvalue of d(qdd)/d(tau) damping, as forward dynamics has it."""
    p = as_chain(well_conditioned_system(seed, arms=2, moving_base=False))
    chain, n = p.chain, p.chain.joint_count
    still = State(p.state.q, np.zeros(n), p.state.object_pose)
    damping = np.concatenate([arm.damping for arm in chain.arms.values()])
    torques = np.vstack([np.zeros(n), np.eye(n)])
    qdd = np.array([forward_dynamics(chain, still, tau).qdd for tau in torques])
    expected = np.linalg.eigvals((qdd[1:] - qdd[0]).T * damping).real.max()
    found = fastest_decay(chain, still, passive_resistance(chain, still.qd))
    assert found.rate == pytest.approx(expected, rel=1e-7)
    gains = np.random.default_rng(seed).uniform(0.0, 5.0, n)
    now = evaluate(Environment(chain), lambda t, x, m: (5.0 - gains * x.qd, m), 0.0, still, None)
    both = passive_resistance(chain, still.qd) + feedback_resistance(lambda t, x, m: (5.0 - gains * x.qd, m), now)
    expected = np.linalg.eigvals((qdd[1:] - qdd[0]).T * (damping + gains)).real.max()
    assert fastest_decay(chain, still, both).rate == pytest.approx(expected, rel=1e-6)


def test_slope_of_friction():
    """The derivative of the torque, largest at standstill."""
    size, qd = np.array([0.3, 2.0, 1.0]), np.array([0.0, 0.03, -0.4])
    change = 1e-6
    expected = (friction_torque(size, qd + change) - friction_torque(size, qd - change)) / (2 * change)
    assert friction_slope(size, qd) == pytest.approx(expected, rel=1e-6)
    assert friction_slope(size, np.zeros(3)) == pytest.approx(size / SMOOTHING_RATE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "used"), mostly_slow([("rk4", 0.9 * 2.7852935634), ("midpoint", 1.8)], [("midpoint", 1.8)])
)
def test_implicit_from_the_start(name, used):
    """Beyond 0.9 of the interval, not before; steps a hundred times as long lead where theory does."""
    chain, state = squeezed(BALLS, damping=DAMPING)
    limit = used / TURN
    below = simulate(chain, state, lifting, 0.99 * limit, 0.99 * limit, scheme=name)
    assert below.stopped is None and [one.kind for one in below.occurrences] == ["unresolved"]
    decay = 0.5 * DAMPING  # 4 kg slowed by two slides
    for step in (1.01 * limit, 100.0 * limit):
        run = simulate(chain, state, lifting, 20 * step, step, scheme=name)
        assert run.stopped is None
        (stiff,) = run.occurrences
        assert (stiff.t, stiff.kind) == (0.0, "stiff")
        assert re.search(rf"joint '(left|right)/[yz]' is slowed down at 600 1/s by damping, which {name}", stiff.text)
        expected = 30.0 / DAMPING * (1.0 - np.exp(-decay * run.t[-1]))
        assert run.qd[-1, 2] == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_implicit_when_asked_for():
    """The scheme itself may be named; second order in time."""
    chain, state = squeezed(BALLS, damping=DAMPING / 100)
    law = lambda t, x, m: (np.array([0.0, 0.0, 30.0 + 9.0 * np.sin(50 * t)] * 2), m)  # noqa: E731
    exact = simulate(chain, state, law, 0.04, 0.04, scheme="dop853", rtol=1e-12).qd[-1]
    errors = [np.abs(simulate(chain, state, law, 0.04, h, scheme="imex").qd[-1] - exact).max() for h in (4e-4, 2e-4)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)
    assert not simulate(chain, state, law, 0.04, 4e-3, scheme="imex").occurrences


def test_stiff_springs():
    """Slides of 1 kg on springs of 1e6 N/m swing at 1000 rad/s: steps of 0.1 s let that die out, and find the sag."""
    chain, state = squeezed((None, None))
    arms = {}
    for (name, arm), part in zip(chain.arms.items(), chain.arm_joints, strict=True):
        held = zip(arm.joints, state.q[part], strict=True)
        arms[name] = replace(arm, joints=[replace(joint, stiffness=1e6, rest=at) for joint, at in held])
    run = simulate(replace(chain, arms=arms), state, lifting, 1.0, 0.1)
    assert run.stopped is None
    assert "swings at 1e+03 rad/s by its spring, which rk4" in run.occurrences[0].text
    weight = -chain.gravity[2] * next(iter(chain.arms.values())).links[-1].mass
    sag = run.q[-1, [2, 5]] - state.q[[2, 5]]
    assert sag == pytest.approx((30.0 - weight) / 1e6, rel=1e-3)


def test_adaptive_steps_need_no_refusal():
    """They choose themselves."""
    chain, state = squeezed(BALLS, damping=100 * DAMPING)
    run = simulate(chain, state, lifting, 1e-3, 1e-3, scheme="dop853", rtol=1e-6, atol=1e-9)
    assert run.stopped is None
    assert run.qd[-1, 2] == pytest.approx(0.3 / DAMPING, rel=1e-4)


def test_drives_that_are_heavy_enough():
    """Armature slows the decay down."""
    chain, state = squeezed(BALLS, damping=DAMPING, armature=DAMPING)
    assert simulate(chain, state, lifting, 2.0, 2.0).stopped is None


def test_after_a_grasp_opens():
    """Free slides settle faster than those that carry the block; steps between the two become implicit there."""
    chain, state = squeezed(BALLS, damping=DAMPING)
    step = 2.5 / (0.5 * (TURN + DAMPING))
    run = simulate(chain, state, lifting, 4 * step, step, events=[Release(1.5 * step, "left")])
    assert run.stopped is None
    assert [one.kind for one in run.occurrences] == ["release", "stiff", "unresolved"]
    assert "joint 'left/" in run.occurrences[1].text
    assert run.occurrences[1].t == pytest.approx(1.5 * step)


@pytest.mark.slow
def test_after_a_motion():
    """An elbow that stretches: its inertia falls, and steps become implicit on the way, to the bit in a resumed run."""
    links = [hf.Link(1.0, [0.5, 0.0, 0.0], 0.01 * np.eye(3)) for _ in range(2)]
    elbow = hf.Pose.translation(1.0, 0.0, 0.0)
    arm = hf.Arm([hf.Joint(name="shoulder"), hf.Joint(placement=elbow, name="elbow", damping=20.0)], links, tip=elbow)
    body, grasps = hf.HeldObject(1.0, 0.01 * np.eye(3)), {"arm": hf.Grasp("rigid", hf.Pose.identity())}
    chain = ClosedChain({"arm": arm}, body, grasps, np.zeros(3))
    states = [state_from_joints(chain, [0.0, angle], np.zeros(2)) for angle in (2.0, 0.0)]
    bent, stretched = (fastest_decay(chain, at, passive_resistance(chain, at.qd)).rate for at in states)
    assert stretched > 2.0 * bent
    step = 0.9 * RK4.stability_interval / (1.2 * bent)
    saved = []
    given = chain, states[0], lambda t, x, m: (np.array([0.0, -20.0]), m), 60 * step, step
    run = simulate(*given, on_checkpoint=saved.append)
    assert run.stopped is None
    (stiff,) = [one for one in run.occurrences if one.kind == "stiff"]
    assert "joint 'arm/elbow' is slowed down" in stiff.text
    assert 0.0 < run.q[np.searchsorted(run.t, stiff.t), 1] < 1.9
    rest = simulate(*given, start=Checkpoint.from_data(*saved[-3].to_data()))
    assert np.array_equal(rest.q, run.q[-2:]) and np.array_equal(rest.grasp_wrench, run.grasp_wrench[-2:])


def test_friction_about_standstill_counts():
    """Friction of 10 N in slides about standstill: steep there, no longer so in motion."""
    chain, state = squeezed(BALLS, Friction(0.5), friction=10.0)
    (stiff,) = simulate(chain, state, lifting, 0.1, 0.1, on_slip="record").occurrences[:1]
    assert "is slowed down at 120 1/s by friction, which rk4" in stiff.text
    moving = State(state.q, np.array([0.0, 0.0, 1.0] * 2), state.object_pose, [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert fastest_decay(chain, moving, passive_resistance(chain, moving.qd)).rate < 121.0


def test_error_survives_a_pickle():
    """Between processes too."""
    error = pickle.loads(pickle.dumps(StepTooLongError("too long", "left/x", 1e-4)))
    assert (str(error), error.joint, error.step) == ("too long", "left/x", 1e-4)
    assert np.isnan(StepTooLongError("too long").step)


def test_problems_without_damping_are_not_checked(monkeypatch):
    """Nothing is computed for a chain without damping and friction."""
    monkeypatch.setattr("holdfast.simulation.stability.fastest_decay", None)
    chain, state = PROBLEMS["pandas"]()
    assert simulate(chain, state, lambda t, x, m: (np.zeros(14), m), 1e-3, 1e-3).stopped is None


def step_of(run):
    """Return the step that the end of a run suggests, having asserted that it blames the step, and no limit."""
    found = re.search(r"is too long for joint '.*try a step of (\S+) s$", str(run.stopped))
    assert found, run.stopped
    assert not run.occurrences
    return float(found[1])


def feedback(gain, up=5.0):
    """Return the controller that squeezes, pushes up and slows the slides down."""
    return lambda t, state, memory: (np.array([SQUEEZE, 0.0, up, -SQUEEZE, 0.0, up]) - gain * state.qd, memory)


@pytest.mark.parametrize(
    ("scheme", "ratio"),
    [("rk4", 3.0), ("midpoint", 3e4), *(pytest.param("rk4", x, marks=pytest.mark.long) for x in (11.0, 100.0))],
)
def test_feedback_that_blows_up_is_no_slip(scheme, ratio):
    """h gain / inertia beyond the interval: the run says so, names a joint and a step, and that step works."""
    chain, state = squeezed(BALLS, RUBBER)
    gain = ratio * 2.0 / STEP  # 4 kg against two slides, while the block turns at 1.2 of that
    run = simulate(chain, state, feedback(gain), 0.2, STEP, scheme=scheme)
    assert re.search("^[^\n]*the step of 0.001 s is too long for joint '[^\n]*slowed down at[^\n]*$", str(run.stopped))
    step = step_of(run)
    assert 0.2 < step * 1.2 * ratio / STEP < 2.0
    again = simulate(chain, state, feedback(gain), 20 * step, step, scheme=scheme)
    assert again.stopped is None
    expected = 5.0 / gain * (1.0 - np.exp(-0.5 * gain * again.t[-1]))
    assert again.qd[-1, 2] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
    ("limit", "on_limit"), [("position_limits", "stop"), ("rate_limit", "record"), ("effort_limit", "record")]
)
def test_nor_is_it_a_joint_limit(limit, on_limit):
    """Recorded or not: what only the long step shows is not in the log."""
    given: Any = (-1e-3, 1e-3) if limit == "position_limits" else 1e3 if limit == "effort_limit" else 0.02
    chain, state = squeezed(BALLS, **{limit: given})
    run = simulate(chain, state, feedback(6000.0), 0.2, STEP, on_limit=on_limit)
    step = step_of(run)
    assert simulate(chain, state, feedback(6000.0), 10 * step, step, on_limit=on_limit).stopped is None


def test_nor_a_run_that_goes_on():
    """With `record` and `release` neither is believed."""
    chain, state = squeezed(BALLS, RUBBER)
    for policy in ("record", "release"):
        run = simulate(chain, state, feedback(12000.0), 0.2, STEP, on_slip=policy)
        assert step_of(run) < STEP and run.holding.all()


def test_diverging_without_limits():
    """Nothing to slip: the run ends where a step fails, and names joint and step all the same."""
    chain, state = squeezed(BALLS)
    run = simulate(chain, state, feedback(40000.0), 0.5, STEP)
    assert step_of(run) < 2.5e-4


def test_springs_too_stiff_for_the_step():
    """No velocity is fed back: the joint swings, and the spring is named with its stiffness."""
    chain, state = squeezed(BALLS, RUBBER)
    springs = np.array([0.0, 0.0, 2e7] * 2)

    def controller(t, state, memory):
        return feedback(0.0)(t, state, memory)[0] - springs * state.q, memory

    run = simulate(chain, state, controller, 0.2, STEP)
    swinging = r"joint '(left|right)/z', swinging at (\S+) rad/s by its controller's gain of 2e\+07 N/m"
    found = re.search(swinging, str(run.stopped))
    assert found and float(found[2]) == pytest.approx(
        np.sqrt(4e7 / 4.0), rel=0.2
    )  # the block, by two slides, and it turns
    assert step_of(run) <= 5e-4


def test_true_slips_stay():
    """A force that grows beyond what friction holds, under feedback that the step can follow: on paper's time."""
    chain, state = squeezed(BALLS, RUBBER)

    def controller(t, state, memory):
        return feedback(10.0, 2000.0 * t)(t, state, memory)[0], memory

    runs = [simulate(chain, state, controller, 0.2, step) for step in (4e-3, 1e-3)]
    assert all(SLIP.match(run.stopped or "") for run in runs)
    assert runs[0].occurrences[-1].t == pytest.approx(runs[1].occurrences[-1].t, abs=1e-6)


def damped_pandas(damping: float) -> tuple[ClosedChain, State, TorqueSchedule]:
    """Return two Pandas with damped joints, a box between rubber fingers, and torques that push it about."""
    chain, state = rubber_pandas(0.8)
    damped = {name: [replace(x, damping=damping) for x in arm.joints] for name, arm in chain.arms.items()}
    chain = replace(chain, arms={name: replace(arm, joints=damped[name]) for name, arm in chain.arms.items()})
    hold = hf.holding_torques(chain, state, internal_force=40.0)
    push = hold + np.array([0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.5] + [0.0] * 7)
    return chain, state, TorqueSchedule.linear([0.0, 0.1], [hold, push])


@pytest.mark.slow
def test_damped_pandas():
    """20 N m s/rad: at 1 ms explicit steps would slip; the wrist is named, and implicit ones are right."""
    chain, state, torques = damped_pandas(20.0)
    run = simulate(chain, state, torques, 0.03, STEP)
    exact = simulate(chain, state, torques, 0.03, 0.03, scheme="dop853", rtol=1e-7)
    assert run.stopped is None and exact.stopped is None
    (stiff,) = run.occurrences
    assert re.search(r"\(imex\): joint 'right/joint7' is slowed down at .* 1/s by damping, which rk4", stiff.text)
    assert np.abs(run.q[-1] - exact.q[-1]).max() < 1e-6
    assert np.abs(run.qd[-1] - exact.qd[-1]).max() < 1e-5


@pytest.mark.long
def test_random_damped_chains():
    """Right, by explicit or by implicit steps; a thousand of them in `tests/acceptance`."""
    found = [outcome(problem(seed, 2), scheme) for seed, scheme in zip(SEEDS, ("rk4", "midpoint"), strict=True)]
    assert [one.implicit for one in found] == [False, True]
    assert all(one.stopped is None and one.position <= 1e-3 and one.velocity <= 1e-3 for one in found), found


@pytest.mark.slow
def test_wrench_limits_are_no_different():
    """A limit of what a rigid grasp bears is not passed either."""
    chain, state = squeezed(("rigid", "rigid"))
    limits = WrenchLimits(force=150.0)
    chain = replace(chain, grasps={name: replace(grasp, wrench_limits=limits) for name, grasp in chain.grasps.items()})
    run = simulate(chain, state, feedback(12000.0), 0.2, STEP)
    assert step_of(run) < STEP
