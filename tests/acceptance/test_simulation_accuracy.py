"""Simulation by machine code keeps its laws and its digits: closure, energy, order, 30 digits, SUNDIALS; dips; a catch.

`tests/simulation/test_accuracy.py` asks the same of the traced functions on floats, of `ReferenceStepper`, for shorter.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.dynamics import attach, kinetic_energy, momentum
from holdfast.simulation.rollout.compiled_steppers import StagewiseStepper
from holdfast.simulation.runge_kutta import scheme
from holdfast.simulation.simulate import simulate
from holdfast.simulation.stepper import SubdividingStepper
from tests.oracles import sundials
from tests.oracles.planar_linkage import Motion
from tests.simulation.dips import Dips, found_dips
from tests.simulation.gantries import PUSHED, pressed
from tests.simulation.problems import PROBLEMS
from tests.simulation.runs import adaptive, balances_of, differences, fixed, numbers, stepper_of
from tests.systems.as_case import as_case
from tests.systems.five_bar import FiveBar, five_bar_chain, five_bar_state
from tests.systems.trunk_runs import still_base

MAKE = StagewiseStepper
ANGLES, RATES = (0.2, -0.5), (0.0, 0.0)  # of the five-bar linkage

pytestmark = pytest.mark.long


def times(duration: float, step: float) -> np.ndarray:
    """Return the times of equal steps [s]."""
    return np.linspace(0.0, duration, round(duration / step) + 1)


@pytest.mark.parametrize(
    ("scheme_name", "step", "drift", "parts"),
    [
        ("rk4", 1e-3, 1e-7, True),
        ("rk4", 1e-3, 5e-6, False),
        ("rk4", 2.5e-4, 1e-7, False),
        ("dop853", 1e-3, 1e-7, False),
    ],
)
def test_two_pandas_fall(scheme_name, step, drift, parts):
    """Two limp Pandas and their box fall for 2 s: closed to 1e-12, velocities to 1e-11, energy kept to 1e-7.

    They whip through outstretched wrists, at up to 80 rad/s for some milliseconds; that is
    where whole steps of order 4 lose energy, 3e-6 of the peak kinetic energy at 1 ms and a
    sixteenth for every halving. `largest_drift` has those taken in parts.
    """
    stepper, now = stepper_of(*PROBLEMS["pandas"](), scheme(scheme_name), make=MAKE)
    stepper = SubdividingStepper(stepper, 1e-10) if parts else stepper
    balances = balances_of(fixed(stepper, now, times(2.0, step)))
    print(f"\n{scheme_name} at {step:g} s{', parted' if parts else ''}, for 2 s: {balances}", end="")
    assert balances.peak_rate > 40
    assert balances.position <= 1e-12
    assert balances.velocity <= 1e-11
    assert balances.drift <= drift * balances.peak_kinetic


def test_order_of_the_fall():
    """Halving RK4's step divides the error of the whole state after 0.4 s by 2^3.8 or more."""
    chain, state = PROBLEMS["pandas"]()
    exact = balances_of(adaptive(*stepper_of(chain, state, scheme("dop853"), 1e-12, MAKE), 0.4)).end
    steps = (4e-3, 2e-3, 1e-3)
    ends = [balances_of(fixed(*stepper_of(chain, state, make=MAKE), times(0.4, h))).end for h in steps]
    errors = np.array([np.abs(end - exact).max() for end in ends])
    orders = np.log2(errors[:-1] / errors[1:])
    print(f"\nerrors {errors} at {steps} s, orders {orders}", end="")
    assert orders.min() >= 3.8


def test_adaptive_fall():
    """At rtol 1e-12 the same fall keeps its energy to 1e-10 of the peak kinetic energy, closed all the while."""
    stepper, now = stepper_of(*PROBLEMS["pandas"](), scheme("dop853"), 1e-12, MAKE)
    balances = balances_of(adaptive(stepper, now, 2.0))
    print(f"\nrtol 1e-12 for 2 s: {balances}", end="")
    assert balances.peak_rate > 40
    assert balances.position <= 1e-12
    assert balances.velocity <= 1e-11
    assert balances.drift <= 1e-10 * balances.peak_kinetic


@pytest.mark.parametrize("problem", [problem for problem in PROBLEMS if problem != "pandas"])
def test_every_grasp(problem):
    """Hinges, balls, soft fingers, mixtures, a Stewart platform, a parallelogram: closed to 1e-12 and 1e-11."""
    balances = balances_of(fixed(*stepper_of(*PROBLEMS[problem](), make=MAKE), times(0.5, 1e-3)))
    print(f"\n{problem}, 1 ms for 0.5 s: {balances}", end="")
    assert balances.position <= 1e-12
    assert balances.velocity <= 1e-11
    assert balances.drift <= 1e-7 * balances.peak_kinetic


def test_thirty_digits():
    """A five-bar linkage after 1 s agrees to 1e-9 with two coordinates integrated in 30 digits."""
    bar = FiveBar()
    motion = Motion(bar, ANGLES, RATES)
    exact, coarse = motion.after(1.0, 64), motion.after(1.0, 48)
    own = float(max(abs(x - y) for x, y in zip(exact, coarse, strict=True)))
    state = five_bar_state(bar, *motion.links(motion.start))
    balances = balances_of(adaptive(*stepper_of(five_bar_chain(bar), state, scheme("dop853"), 1e-12, MAKE), 1.0))
    assert balances.last is not None
    off = differences(balances.last.state, five_bar_state(bar, *motion.links(exact)))
    print(f"\noff by {off[0]:.1e} rad or m, {off[1]:.1e} rad/s or m/s; the oracle by {own:.0e}; {balances}", end="")
    assert own < 1e-18
    assert off.max() <= 1e-9


def test_sundials():
    """Two Pandas falling for 0.5 s agree to 1e-7 with IDA on the dense equations of motion."""
    chain, state = PROBLEMS["pandas"]()
    theirs = sundials.integrated(as_case(chain, state), state.object_pose, 0.5, 1e-11)
    balances = balances_of(adaptive(*stepper_of(chain, state, scheme("dop853"), 1e-12, MAKE), 0.5))
    assert balances.last is not None
    off = {key: float(np.abs(x - getattr(balances.last.state, key)).max()) for key, x in theirs.items()}
    print("\noff by " + ", ".join(f"{key} {x:.1e}" for key, x in off.items()) + f"; {balances}", end="")
    assert max(off.values()) <= 1e-7
    assert np.abs(numbers(state) - balances.end).max() > 1.0  # they did fall


STEP = 0.01


@pytest.mark.parametrize("scheme", ["midpoint", "rk4"])
def test_a_thousand_dips(scheme):
    """Dips of h/4 to 10 h, at random phase, of five shapes (two of which jump): all found, nothing else."""
    dips = Dips.random(1000, STEP, 0.25, 10.0, seed=11)
    begin = time.perf_counter()
    run = found_dips(dips, STEP, scheme=scheme)
    starts = np.array([one.t for one in run.occurrences[::2]])
    print(
        f"\n{scheme}: {len(dips.begins)} dips of {dips.widths.min() / STEP:.3f} to {dips.widths.max() / STEP:.2f} steps"
        f" in {len(run) - 1} steps, all found; begins off by at most {np.abs(starts - dips.begins).max():.1e} s;"
        f" {time.perf_counter() - begin:.0f} s",
        end="",
    )


def test_a_thousand_narrow_dips_between_knots():
    """Triangles of 1e-5 h to h/4 at random phase, knots at their corners: all found, depths to rounding."""
    chain, state = pressed()
    rng = np.random.default_rng(12)
    widths = STEP * 10 ** rng.uniform(-5, np.log10(0.25), 1000)
    begins = np.cumsum(STEP * rng.uniform(0.3, 2.0, 1000))
    peaks = begins + rng.uniform(0.2, 0.8, 1000) * widths
    depths = rng.uniform(0.01, 3.0, 1000)
    times = np.column_stack([begins, peaks, begins + widths]).ravel()
    torques = np.column_stack([np.ones(1000), -depths, np.ones(1000)]).ravel()
    schedule = TorqueSchedule.linear(np.r_[0.0, times], np.r_[1.0, torques][:, None])
    run = simulate(chain, state, schedule, float(times[-1] + STEP), STEP, on_slip="record", scheme="midpoint")
    assert [one.kind for one in run.occurrences] == 1000 * ["violation", "recovery"]
    lowest = np.array([one.lowest for one in run.occurrences[1::2]])
    enter = np.array([one.t for one in run.occurrences[::2]])
    expected = begins + (peaks - begins) / (1 + depths)
    off = np.abs(lowest + depths * PUSHED).max(), np.abs(enter - expected).max()
    print(f"\n1000 dips of {widths.min() / STEP:.1e} to {widths.max() / STEP:.2f} steps: depth off by {off[0]:.1e} N,"
          f" begin by {off[1]:.1e} s", end="")  # fmt: skip
    assert off[0] <= 1e-12
    assert off[1] <= 1e-12


CATCH, END = 2.0, 20.0
TWO = {"arms": 2, "joints": 7, "grasps": "rigid", "gravity": (0.0, 0.0, 0.0)}


def test_catch():
    """One arm holds the satellite, the other grips at 2 s while they move against each other; nothing else pushes.

    Dampers in the joints bring the arms to rest in the end; the whole tumbles on.
    """
    p = still_base(7, 2, floating=True, arms=TWO, in_world=0.0)
    caught = p.chain.names[1]
    grasp = p.chain.grasps[caught]
    damped = {
        name: replace(arm, joints=[replace(joint, damping=2.0) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    chain = replace(p.chain, arms=damped).without_grasp(caught)
    rate = np.random.default_rng(3).normal(size=chain.joint_count)
    state = hf.dynamics.project_velocity(chain, replace(p.state, qd=0.3 * rate))
    law = hf.ControlLaw(lambda t, s, memory, given: (np.zeros(chain.joint_count), memory))
    grips = hf.Attach(CATCH, caught, grasp, here=True)
    run = hf.simulate(
        chain, state, law, END, 0.1, scheme="dop853", rtol=1e-13, atol=1e-14, events=[grips], on_limit="record"
    )
    assert run.stopped is None and run.t[-1] == END
    sizes = np.abs(run.momentum).max(axis=0).reshape(2, 3).max(axis=1)
    drift = np.abs(run.momentum - run.momentum[0]).max(axis=0).reshape(2, 3).max(axis=1) / sizes
    k = int(np.flatnonzero(~run.holding.all(axis=1))[-1])  # the last sample before
    assert abs(run.t[k] - CATCH) < 1e-12
    across = np.abs(run.momentum[k + 1] - run.momentum[k]).reshape(2, 3).max(axis=1) / sizes
    made = attach(chain, run.state(k), caught, grasp, here=True)
    before, after = kinetic_energy(chain, run.state(k)), kinetic_energy(made.chain, made.state)
    lost = abs((after - before) - made.energy_change) / before
    assert np.abs(momentum(made.chain, made.state) - momentum(chain, run.state(k))).max() <= 1e-13 * sizes.max()
    gap = run.position_gap[:, 1].max()
    print(
        f"momentum over {END:g} s: angular {drift[0]:.1e}, linear {drift[1]:.1e}; across the catch {across.max():.1e};"
        f" energy lost {made.energy_change:.3g} J, as the formula says to {lost:.1e} of {before:.3g} J;"
        f" closure {gap:.1e}; {len(run)} samples"
    )
    assert drift.max() <= 1e-11 and across.max() <= 1e-13
    assert made.energy_change < -1e-3 and lost <= 1e-12
    assert gap <= 1e-12
