"""Violations that only a step that is too long shows are not reported; those that shorter ones show are."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from holdfast import ClosedChain, Friction, State, WrenchLimits, holding_torques, simulate
from holdfast.control.torque_schedule import TorqueSchedule
from tests.control.two_pandas import two_pandas
from tests.simulation.damped import outcome, problem
from tests.simulation.gantries import squeezed

SQUEEZE = 100.0  # N
RUBBER = Friction(0.5)
STEP = 1e-3
BALLS = ("ball", "ball")
SEEDS = (9, 8)  # of random chains; h times their fastest rates are 0.64 and 325
SLIP = re.compile(r"^grasp '\w+' (slips|lifts off|gives way)")


def step_of(stopped: str) -> float:
    """Return the step that a message suggests."""
    found = re.search(r"try a step of (\S+) s$", stopped)
    assert found, stopped
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
    assert run.stopped is not None
    assert "the step of 0.001 s is too long for joint '" in run.stopped, run.stopped
    assert "slowed down at" in run.stopped
    assert "\n" not in run.stopped
    assert not [one for one in run.occurrences if one.kind == "violation"]
    step = step_of(run.stopped)
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
    assert run.stopped is not None and "is too long for joint" in run.stopped
    assert not run.occurrences
    step = step_of(run.stopped)
    assert simulate(chain, state, feedback(6000.0), 10 * step, step, on_limit=on_limit).stopped is None


def test_nor_a_run_that_goes_on():
    """With `record` and `release` neither is believed."""
    chain, state = squeezed(BALLS, RUBBER)
    for policy in ("record", "release"):
        run = simulate(chain, state, feedback(12000.0), 0.2, STEP, on_slip=policy)
        assert run.stopped is not None and "is too long for joint" in run.stopped
        assert not run.occurrences and run.holding.all()


def test_diverging_without_limits():
    """Nothing to slip: the run ends where a step fails, and names joint and step all the same."""
    chain, state = squeezed(BALLS)
    run = simulate(chain, state, feedback(40000.0), 0.5, STEP)
    assert run.stopped is not None and "is too long for joint" in run.stopped
    assert step_of(run.stopped) < 2.5e-4


def test_stiff_springs():
    """No velocity is fed back: the joint is the one that halves of the step move otherwise."""
    chain, state = squeezed(BALLS, RUBBER)
    springs = np.array([0.0, 0.0, 2e7] * 2)

    def controller(t, state, memory):
        return feedback(0.0)(t, state, memory)[0] - springs * state.q, memory

    run = simulate(chain, state, controller, 0.2, STEP)
    assert run.stopped is not None and re.search(
        r"too long for joint '(left|right)/[yz]', whose motion changes", run.stopped
    )
    assert step_of(run.stopped) <= 5e-4


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
    chain, state = two_pandas("softfinger", "softfinger")
    arms = {
        name: replace(arm, joints=[replace(joint, damping=damping) for joint in arm.joints])
        for name, arm in chain.arms.items()
    }
    rubber = Friction(0.8, torsion_radius=0.02)
    grasps = {name: replace(grasp, contact=rubber) for name, grasp in chain.grasps.items()}
    chain = ClosedChain(arms, chain.held_object, grasps)
    hold = holding_torques(chain, state, internal_force=40.0)
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


def test_wrench_limits_are_no_different():
    """A limit of what a rigid grasp bears is not passed either."""
    chain, state = squeezed(("rigid", "rigid"))
    limits = WrenchLimits(force=150.0)
    chain = replace(chain, grasps={name: replace(grasp, wrench_limits=limits) for name, grasp in chain.grasps.items()})
    run = simulate(chain, state, feedback(12000.0), 0.2, STEP)
    assert run.stopped is not None and "is too long for joint" in run.stopped and not run.occurrences
