"""The checks of `tests/acceptance/test_simulation_accuracy.py`, over as much time as every run can afford."""

import numpy as np
import pytest

from holdfast.simulation.runge_kutta import dop853
from tests.oracles import sundials
from tests.oracles.planar_linkage import Motion
from tests.simulation.problems import PROBLEMS
from tests.simulation.runs import adaptive, balances_of, differences, fixed, stepper_of
from tests.systems.as_case import as_case
from tests.systems.five_bar import FiveBar, five_bar_chain, five_bar_state


@pytest.mark.parametrize("problem", PROBLEMS)
def test_every_grasp(problem):
    """Closed to 1e-12 and 1e-11 after every step, by `closure`."""
    balances = balances_of(fixed(*stepper_of(*PROBLEMS[problem]()), np.linspace(0.0, 0.008, 5)))
    assert balances.position <= 1e-12
    assert balances.velocity <= 1e-11
    assert balances.drift <= 1e-7 * balances.peak_kinetic


@pytest.mark.parametrize(("rtol", "steps", "drift"), [(1e-6, 10, 1e-5), (1e-12, 40, 1e-11)])
def test_tolerance_buys_energy(rtol, steps, drift):
    """Two Pandas fall for 0.2 s: energy is kept as the tolerance asks, and steps are as long as it allows."""
    balances = balances_of(adaptive(*stepper_of(*PROBLEMS["pandas"](), dop853(), rtol), 0.2))
    assert balances.position <= 1e-12
    assert balances.velocity <= 1e-11
    assert balances.drift <= drift * balances.peak_kinetic
    assert balances.steps <= steps


def test_thirty_digits():
    """A five-bar linkage after 0.05 s agrees to 1e-11 with two coordinates integrated in 30 digits."""
    bar = FiveBar()
    motion = Motion(bar, (0.2, -0.5), (1.0, -2.0))
    state = five_bar_state(bar, *motion.links(motion.start))
    balances = balances_of(adaptive(*stepper_of(five_bar_chain(bar), state, dop853(), 1e-12), 0.05))
    assert balances.last is not None
    exact = five_bar_state(bar, *motion.links(motion.after(0.05, 2)))
    assert differences(balances.last.state, exact).max() <= 1e-11
    assert differences(balances.last.state, state).max() > 0.05


@pytest.mark.slow
def test_sundials():
    """Two Pandas falling for 0.05 s agree to 1e-7 with IDA on the dense equations of motion."""
    chain, state = PROBLEMS["pandas"]()
    theirs = sundials.integrated(as_case(chain, state), state.object_pose, 0.05, 1e-9)
    balances = balances_of(adaptive(*stepper_of(chain, state, dop853(), 1e-10), 0.05))
    assert balances.last is not None
    for key, x in theirs.items():
        np.testing.assert_allclose(getattr(balances.last.state, key), x, rtol=0, atol=1e-7, err_msg=key)
    assert np.abs(balances.last.state.qd).max() > 1.0
