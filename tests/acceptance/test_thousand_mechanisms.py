"""A thousand random mechanisms that are over-constrained, nearly singular, or pass singular configurations.

Planar, spherical and parallel ones beside references that know nothing of redundant rows: a run in space must not be
off by more than ten times what the same steps are off by there. Beside a singular
configuration the sibling is one far away.
"""

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.rank import constraint_rank
from tests.oracles.planar_mechanism import random_mechanism
from tests.oracles.spherical_mechanism import random_spherical
from tests.simulation.test_overconstrained import free
from tests.simulation.test_singular_configurations import energy_error
from tests.systems.parallel_cranks import parallel_cranks

pytestmark = pytest.mark.long
CHUNKS, EACH = 25, 10  # of four kinds
FLOOR = 1e-12  # rad: rounding
DURATION, STEPS = 0.05, 20


def require_steady_rank(chain, state, seed):
    """A state displaced by 1e-5 and projected back is judged as before."""
    tau = np.zeros(chain.joint_count)
    random = np.random.default_rng(seed)
    found = hf.forward_dynamics(chain, state, tau)
    beside = hf.State(
        state.q + 1e-5 * random.normal(size=len(state.q)), state.qd, state.object_pose, state.object_twist
    )
    closed, _ = hf.project(chain, beside)
    again = hf.forward_dynamics(chain, closed, tau)
    assert (again.rank, again.status) == (found.rank, found.status)
    assert constraint_rank(chain, closed) == found.rank


def planar(seed):
    """Return a planar mechanism in space, its joint angles after a time, and by steps in the plane."""
    mechanism = random_mechanism(1000 + seed)
    n = len(mechanism.start) - 3
    return *mechanism.chain(), mechanism.after(DURATION)[0][:n], mechanism.stepped(DURATION, STEPS)[:n]


def spherical(seed):
    """Return a spherical mechanism in space, its joint angles after a time, and by steps of turns alone."""
    mechanism = random_spherical(seed)
    return *mechanism.chain(), mechanism.after(DURATION), mechanism.stepped(DURATION, STEPS)


@pytest.mark.parametrize("kind", [planar, spherical])
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_overconstrained(kind, chunk):
    worst, compared = 0.0, 0
    for seed in range(EACH * chunk, EACH * (chunk + 1)):
        chain, state, exact, sibling = kind(seed)
        run = hf.simulate(chain, state, free, DURATION, DURATION / STEPS)
        if run.stopped is not None:
            assert "singular" in run.stopped, (seed, run.stopped)
            continue
        ratio = np.abs(run.q[-1] - exact).max() / (np.abs(sibling - exact).max() + FLOOR)
        assert ratio < 10.0, seed
        require_steady_rank(chain, run.state(-1), seed)
        worst, compared = max(worst, ratio), compared + 1
    assert compared >= EACH - 2
    print(f"{compared} {kind.__name__} mechanisms, at worst {worst:.2f} times as far off as without redundant rows")


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_singular_configurations(chunk):
    """Each is named within a millionth of a second; the run that goes on ends where the pendulum does."""
    configurations, late, worst = 0, 0.0, 0.0
    for seed in range(EACH * chunk, EACH * (chunk + 1)):
        cranks = parallel_cranks(seed)
        angle, times = cranks.motion(0.4)
        run = hf.simulate(cranks.chain, cranks.state, free, 0.4, 8e-3, on_singular="continue")
        assert run.stopped is None and len(run.occurrences) == len(times), seed
        off = np.abs(np.array([one.t for one in run.occurrences]) - times).max(initial=0.0)
        error = float(np.abs(run.q[-1] - angle).max())
        assert off < 1e-6 and error < 1e-6, seed
        stopped = hf.simulate(cranks.chain, cranks.state, free, 0.4, 8e-3)
        assert (stopped.stopped is None) == (len(times) == 0), seed
        require_steady_rank(cranks.chain, run.state(-1), seed)
        configurations, late, worst = configurations + len(times), max(late, off), max(worst, error)
    print(f"{configurations} configurations, at worst {late:.1e} s off; angles within {worst:.1e} rad")


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_nearly_singular(chunk):
    """Energies as of a mechanism with cranks a fifth of a metre apart in length."""
    worst, least = 0.0, 1.0
    for seed in range(EACH * chunk, EACH * (chunk + 1)):
        longer = 10.0 ** -np.random.default_rng(seed).uniform(1.5, 7.0)
        errors, moving = [], 1e-9
        for more in (longer, 0.2):
            cranks = parallel_cranks(seed, more)
            run = hf.simulate(cranks.chain, cranks.state, free, 0.4, 8e-3)
            assert run.stopped is None or "singular" in run.stopped, (seed, run.stopped)
            errors.append(energy_error(run))
            moving = max(moving, float(run.kinetic.max()))
            if run.stopped is None:
                require_steady_rank(cranks.chain, run.state(-1), seed)
                least = min(least, float(1.0 / np.sqrt(run.condition.max())))
        assert errors[0] < 10.0 * errors[1] + 2e-7 * moving, (seed, errors)
        worst = max(worst, errors[0] / (errors[1] + 2e-8 * moving))
    print(f"strength down to {least:.1e}; energies at worst {worst:.2f} times as far off as the sibling's")
