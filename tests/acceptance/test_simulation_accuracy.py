"""Simulation by machine code keeps its laws and its digits: closure, energy, order, 30 digits, SUNDIALS.

`tests/simulation/test_accuracy.py` asks the same of the traced functions on floats, of `ReferenceStepper`, for shorter.
"""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.simulation.rollout.compiled_steppers import StagewiseStepper
from holdfast.simulation.runge_kutta import scheme
from holdfast.simulation.stepper import SubdividingStepper
from tests.oracles import sundials
from tests.oracles.planar_linkage import Motion
from tests.simulation.problems import PROBLEMS
from tests.simulation.runs import adaptive, balances_of, differences, fixed, numbers, stepper_of
from tests.systems.as_case import as_case
from tests.systems.five_bar import FiveBar, five_bar_chain, five_bar_state

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
