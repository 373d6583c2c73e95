"""The balances of a run: integrals over samples, energy and momentum of a chain that is pushed about."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from holdfast import Inputs, forward_dynamics
from holdfast.dynamics import kinetic_energy, momentum, potential_energy
from holdfast.forces.force_split import constant_split, parts_by, split
from holdfast.forces.wrist import wrist_wrenches
from holdfast.simulation.accounts import account_shapes, accounts_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.balance import interval_integrals, momentum_imbalance
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.simulation.rollout.compiled_steppers import StagewiseStepper
from holdfast.simulation.runge_kutta import RK4
from holdfast.simulation.sample import arrays_of
from holdfast.simulation.simulate import simulate
from holdfast.simulation.summary import summarise
from holdfast.spatial import rotation
from holdfast.view.summary_table import rows
from tests.longer import mostly_slow
from tests.simulation.problems import PROBLEMS
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.bushed import random_bushed
from tests.systems.lower_pairs import pair

MIXED = ("pandas", "rigid, hinge, ball", "Stewart platform", "parallelogram")
ROUNDING = 1e-12


def test_cubics_are_integrated_exactly():
    """On any grid of four samples or more."""
    rng = np.random.default_rng(0)
    for count in (4, 5, 30):
        t = np.sort(rng.uniform(-1, 2, count))
        c = np.polynomial.Polynomial(rng.normal(size=4))
        exact = np.diff(c.integ()(t))
        assert interval_integrals(t, c(t)) == pytest.approx(exact, abs=1e-12)
        assert interval_integrals(t, np.array([c(t), -c(t)]).T) == pytest.approx(np.array([exact, -exact]).T, abs=1e-12)


def test_corners_are_not_smoothed():
    """Cubics that meet at samples with other slopes are integrated exactly too, each component with its own corner."""
    t = np.linspace(0.0, 2.0, 41)
    corner = np.array([0.5, 1.2])
    after = np.maximum(t[:, None] - t[np.searchsorted(t, corner - 1e-9)], 0.0)
    f = t[:, None] ** 3 + [-1.0, 4.0] * after
    exact = np.diff(t[:, None] ** 4 / 4 + [-0.5, 2.0] * after**2, axis=0)
    assert interval_integrals(t, f) == pytest.approx(exact, abs=1e-14)


@pytest.mark.parametrize("count", [2, 3])
def test_few_samples(count):
    """Two samples give a trapezium, three a parabola."""
    t = np.array([0.0, 0.3, 1.0])[:count]
    c = np.polynomial.Polynomial([1.0, 2.0, 3.0][:count])
    assert interval_integrals(t, c(t)) == pytest.approx(np.diff(c.integ()(t)))


def test_jumps_split_the_integral():
    """A force that jumps between two samples a unit in the last place apart is integrated on each side."""
    t = np.r_[np.linspace(0, 0.5, 6)[:-1], np.nextafter(0.5, 0), np.linspace(0.5, 1.0, 6)]
    force = np.where(t < 0.5, 2.0, -1.0 + t)
    momentum = np.where(t < 0.5, 2 * t, 1.0 + (t**2 - 0.25) / 2 - (t - 0.5))
    both = [np.repeat(x[:, None], 6, axis=1) for x in (momentum, force)]
    assert np.abs(momentum_imbalance(t, *both, np.zeros((len(t), 6)))).max() < 1e-15


@pytest.fixture(scope="module")
def shaken():
    """A soft finger and a rigid grasp on a moving base, damped, shaken and pushed; at two steps."""
    options = {"moving_base": False, "extras": True, "joint_speed": 0.5, "gravity": (0, 0, -9.81)}
    p = as_chain(well_conditioned_system(4, arms=2, joints=7, grasps=["softfinger", "rigid"], **options))
    name = p.chain.names[1]
    home, w, amplitude = p.chain.arms[name].base, np.array([0.0, 0.4, 1.1]), np.array([0.02, 0.0, 0.03])

    def sway(t):
        pose = replace(home, R=rotation.exp(t**3 * w) @ home.R, p=home.p + t**3 * amplitude)
        return pose, 3 * t**2 * np.r_[w, amplitude], 6 * t * np.r_[w, amplitude]

    def wrenches(t):
        return Inputs(np.cos(20 * t) * p.inputs.object_wrench, p.inputs.link_wrenches)

    def torques(t, state, memory):
        return np.cos(30 * t) * p.tau, memory

    def run(step):
        return simulate(p.chain, p.state, torques, 0.024, step, base_motion={name: sway}, inputs=wrenches)

    return p.chain, run(0.001), run(0.002)


@pytest.mark.slow
def test_momentum_balances(shaken):
    """Momentum changes by bases, weights and wrenches alone; what is left falls with the step's fourth power."""
    _, fine, coarse = shaken
    assert np.abs(fine.momentum - fine.momentum[0]).max() > 0.1
    left = [np.abs(run.momentum_imbalance).max() for run in (fine, coarse)]
    assert left[0] < 1e-5 * np.abs(fine.momentum).max()
    assert left[1] > 8 * left[0]


@pytest.mark.slow
def test_samples_hold_what_they_say(shaken):
    """Each derived array is what its function gives for the sample's state and forces."""
    chain, run, _ = shaken
    k = 17
    parts = split(chain, run.state(k), run.grasp_wrench[k])
    size = np.abs(parts.internal).max()
    np.testing.assert_allclose(run.internal_wrench[k], parts.internal, rtol=0.0, atol=1e-13 * size)
    assert run.load_share[k].sum() == pytest.approx(1.0)
    assert np.isfinite(run.spin[k, 0]) and run.spin[k, 1] == 0.0
    assert run.holding.all()
    assert run.potential[0] == pytest.approx(potential_energy(chain, run.state(0)))
    assert run.kinetic[0] == pytest.approx(kinetic_energy(chain, run.state(0)))
    assert run.momentum[0] == pytest.approx(momentum(chain, run.state(0)))
    found = replace(forward_dynamics(chain, run.state(k), run.tau[k], check=False), grasp_wrench=run.grasp_wrench[k])
    wrist = wrist_wrenches(chain, run.state(k), found)
    assert run.wrist_wrench[k, 0] == pytest.approx(wrist[0])  # the other arm's base has moved


@pytest.mark.slow
def test_summary_and_table(shaken):
    """Every figure of the summary has a line with a unit, and nothing is infinite."""
    chain, run, _ = shaken
    summary = summarise(chain, run)
    assert set(summary.peak_internal_force) == set(chain.names)
    assert summary.momentum_imbalance[1] < 1e-3 * summary.momentum_moved[1]
    lines = dict(rows(summary))
    assert "N m s" in lines["momentum balance"]
    assert f"spin about the normal, {chain.names[0]}" in lines
    assert not any(word in text for text in lines.values() for word in ("inf", "nan", "None"))


UNIVERSAL = "rigid, universal"


def universal():
    """Return a chain with a universal joint, whose axes follow the tip; and a state."""
    p = pair(("rigid", "universal"), 2)
    return p.chain, p.state


SURROUNDINGS = {
    "a wrench on the object": Inputs(object_wrench=np.arange(6.0) - 2.0),
    "moving bases": Inputs(base_twists=np.ones((2, 6)), base_accelerations=np.eye(2, 6)),
    "wrenches on links": lambda t, state: Inputs(link_wrenches=np.outer(np.arange(14.0), np.ones(6))),
}


BY_MACHINE_CODE = [
    *((name, "a wrench on the object") for name in (*MIXED, UNIVERSAL)),
    *(("pandas", other) for other in [*SURROUNDINGS][1:]),
]
SOON = [*BY_MACHINE_CODE[:1], *BY_MACHINE_CODE[-2:]]


@pytest.mark.parametrize(("name", "inputs"), mostly_slow(BY_MACHINE_CODE, SOON))
def test_by_machine_code(name, inputs):
    """Energies, momentum, its rate, spins, the split, and what the wrists carry."""
    chain, state = universal() if name == UNIVERSAL else PROBLEMS[name]()
    tau = np.linspace(-3.0, 5.0, chain.joint_count)
    environment = Environment(chain, {}, SURROUNDINGS[inputs])
    fast = StagewiseStepper(environment, lambda t, x, m: (tau, m), chain.constraint_row_count, RK4, Tolerance())
    at = evaluate(environment, lambda t, x, m: (tau, m), 0.3, state, None)
    by_reference = partial(accounts_of, environment)
    mine, theirs = (accounting(np.array([0.3]), arrays_of(at)) for accounting in (fast.accounts, by_reference))
    assert mine.keys() == theirs.keys() == account_shapes(chain, constant_split(chain) is not None).keys()
    for what, x in theirs.items():
        assert mine[what].shape == x.shape
        assert np.abs(mine[what] - x).max() <= ROUNDING * max(1.0, np.abs(x).max()), what


@pytest.mark.parametrize("name", [*MIXED, UNIVERSAL, "soft finger, ball, hinge", "hinges", "bushing"])
def test_splitter(name):
    """The map found once, in object axes, splits wrenches anywhere as the smallest ones found there."""
    if name in PROBLEMS:
        chain, state = PROBLEMS[name]()
    elif name == UNIVERSAL:
        chain, state = universal()
    else:
        chain, state = (p := random_bushed(1)).chain, p.state
    f = np.zeros((len(chain.arms), 6))
    for k, arm in enumerate(chain.grasps):
        f[chain.names.index(arm)] = np.sin(np.arange(6.0) + 7 * k)
    common, kinds = constant_split(chain), [grasp.of_kind for grasp in chain.grasps.values()]
    assert (common is None) == any(kind.slides for kind in kinds)
    if common is None:
        return
    assert (common.ndim == 0) == any(kind.follows_tip for kind in kinds)
    parts, (internal, share) = split(chain, state, f), parts_by(common, chain, state, f)
    np.testing.assert_allclose(internal, parts.internal, atol=ROUNDING)
    np.testing.assert_allclose(share, parts.load_share, atol=ROUNDING)
