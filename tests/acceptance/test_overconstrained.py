"""Long runs and many mechanisms whose constraint has rows that follow from others everywhere."""

import numpy as np
import pytest

import holdfast as hf
from tests.oracles.planar_mechanism import random_mechanism
from tests.simulation.test_overconstrained import MODELS, energy_error, free
from tests.systems.bricard import bricard, line_symmetric

pytestmark = pytest.mark.long
AWAY = 200.0  # condition, up to which no step of 1.5 ms is taken in parts


@pytest.mark.parametrize(("rtol", "bound"), [(1e-12, 1e-11), (1e-13, 1e-12)])
@pytest.mark.parametrize("turns", MODELS)
def test_bricard(turns, rtol, bound):
    """Ten seconds, contact frames turned about the hinges in five ways."""
    chain, state = bricard(turns)
    run = hf.simulate(chain, state, free, 10.0, 1e-2, scheme="dop853", rtol=rtol)
    assert run.stopped is None and energy_error(run) <= bound
    print(f"turns {turns}, rtol {rtol:g}: largest energy error {energy_error(run):.1e} of the kinetic energy")


@pytest.mark.parametrize("chunk", range(10))
def test_line_symmetric_loops(chunk):
    """Fourth order and closure, 40 random loops a chunk; where the constraint is nearly singular it is said.

    Steps that are too long for the motion are taken in parts (`adaptive_parts`), and are then better than the fourth
    order of shorter ones makes them; so the order is that of loops that stay away from singular configurations.
    """
    compared, orders, steps = 0, [], (6e-3, 1.5e-3, 0.75e-3)
    for seed in range(40 * chunk, 40 * chunk + 40):
        chain, state = line_symmetric(seed)
        runs = [hf.simulate(chain, state, free, 0.3, step) for step in steps]
        if any(run.stopped is not None or run.condition.max() > 1e4 for run in runs):
            continue
        long, short, shorter = (energy_error(run) for run in runs)
        # so small an error of the energy changes its sign on the way: its largest value has no order yet
        if shorter > 1e-11 and runs[-1].condition.max() < AWAY:
            orders.append(np.log2(short / shorter))
            assert orders[-1] > 3.5, seed
        assert long <= max(2.0 * short * (steps[0] / steps[1]) ** 4, 1e-9), seed
        compared += 1
    assert compared >= 35
    least, most = min(orders, default=np.nan), max(orders, default=np.nan)
    print(f"{compared} of 40 loops, {len(orders)} orders {least:.2f} .. {most:.2f}")


@pytest.mark.parametrize("chunk", range(10))
def test_planar_mechanisms(chunk):
    """As in the complex plane, 20 random mechanisms a chunk."""
    compared, worst = 0, 0.0
    for seed in range(20 * chunk, 20 * chunk + 20):
        mechanism = random_mechanism(seed, ("rigid", "hinge", "ball", "softfinger"))
        chain, state = mechanism.chain()
        run = hf.simulate(chain, state, free, 0.2, 5e-3, scheme="dop853", rtol=1e-10)
        if run.stopped is not None or run.condition.max() > 1e4:
            continue
        x, _ = mechanism.after(0.2)
        error = float(np.abs(run.q[-1] - x[:-3]).max())
        assert error < 1e-7, seed
        compared, worst = compared + 1, max(worst, error)
    assert compared >= 15
    print(f"{compared} of 20 mechanisms, largest error {worst:.1e} rad")
