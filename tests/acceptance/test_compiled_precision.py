"""The sweeps of `test_precision` and `test_singular`, answered by compiled code: the same figures, the same oracle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import holdfast
from holdfast import ClosedChain, CompiledResult, Inputs, State
from tests.acceptance import test_precision as precision
from tests.acceptance import test_singular as singular
from tests.compiled.problems import compiled_for
from tests.compiler.conftest import no_cache  # noqa: F401
from tests.systems.as_chain import Problem

SEEDS = 1  # of each sweep: every seed is a chain to compile, by two routes
STRETCHES: tuple[dict, ...] = (
    {"com_offset": 1.0},
    {"world_offset": (20.0, -15.0, 10.0)},
    {"angle_scale": 100.0},
    {"moving_base": True, "base_speed": 5.0},
    {"joint_speed": 10.0},
)


@pytest.fixture(autouse=True)
def compiled(monkeypatch) -> Iterator[None]:
    """Put compiled code in the place of the reference; code stays as long as a test runs."""
    kept = []

    def forward_dynamics(
        chain: ClosedChain,
        state: State,
        tau: np.ndarray,
        *,
        inputs: Inputs,
        route: str = "auto",
        method: str = "sequential",
    ) -> CompiledResult:
        """Return the compiled answer in the words of the reference."""
        assert method == "sequential"
        fast, given = compiled_for(Problem(chain, state, tau, inputs), method=route)
        kept.append(fast)
        return fast.forward_dynamics(**given)

    for module in (precision, singular):
        monkeypatch.setattr(module, "forward_dynamics", forward_dynamics)
    every = precision.over_seeds
    monkeypatch.setattr(precision, "over_seeds", lambda seeds, **options: every(seeds[:SEEDS], **options))
    yield
    assert kept


@pytest.mark.long
@pytest.mark.parametrize("grasps", precision.GRASPS)
def test_object_mass_sweep(grasps):
    """Object masses over every decade from 1e-8 to 1e8: <= 1e-12."""
    precision.test_object_mass_sweep(grasps)


@pytest.mark.long
@pytest.mark.parametrize("arm_count", [1, 2, 5])
def test_light_object_any_arms(arm_count):
    """Objects from 1e-8 to 1e2 of the usual mass, any number of joints and arms: <= 1e-12."""
    precision.test_light_object_any_arms(arm_count)


@pytest.mark.long
@pytest.mark.parametrize("scale", [1e-8, 1e2])
def test_stored_cases_of_any_mass(scale):
    """Every stored rigid or mixed case with the object scaled: <= 1e-12."""
    precision.test_stored_cases_of_any_mass(scale)


@pytest.mark.long
@pytest.mark.parametrize(("which", "joints"), [((1,), (6, 6, 6)), ((0, 2), (7, 7, 7))])
def test_straight_arm_sweep(which, joints):
    """Bends from 0.1 rad to exactly straight: <= 1e-12."""
    precision.test_straight_arm_sweep(which, joints)


@pytest.mark.parametrize("scale", [1e-8, pytest.param(1e8, marks=pytest.mark.long)])
def test_object_mass(scale):
    """The lightest and the heaviest object, for every run."""
    precision.test_object_mass_does_not_cost_digits(scale, "mixed")


@pytest.mark.long
def test_nearly_straight_arm():
    """One arm 1e-6 rad from straight."""
    precision.test_nearly_straight_arms((1,))


@pytest.mark.long
@pytest.mark.parametrize("grasps", [None, "rigid"])
@pytest.mark.parametrize("options", STRETCHES, ids=str)
def test_stretched_systems(options, grasps):
    """C a metre off, contacts 20 m from the origin, angles of 100 rad, fast bases and joints: <= 1e-11."""
    precision.test_stretched_systems(options, grasps)


def test_flat_parallelogram_is_refused():
    """At the flat position the rank drops."""
    with pytest.raises(holdfast.SingularChainError, match="rank 8 of 12 here, but 9 in general"):
        singular.solved(singular.planar_parallelogram(0.0))


@pytest.mark.parametrize("angle", [0.5, 1e-3, *(pytest.param(x, marks=pytest.mark.long) for x in (1e-1, 1e-2))])
def test_parallelogram_near_flat_is_solved(angle):
    """Down to 1e-3 rad from flat it is solved, to 1e-8."""
    singular.test_parallelogram_near_flat_is_solved(angle)


@pytest.mark.long
@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_planar_three_arms_are_never_refused(seed, tilted):
    """Rank 12 of 18 everywhere: accelerations are right."""
    singular.test_planar_three_arms_are_never_refused(seed, tilted)


@pytest.mark.long
@pytest.mark.parametrize("opposed", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_collinear_stretched_arms_are_refused(seed, opposed):
    """Two 6R arms stretched along one line: refused, moving or at rest."""
    singular.test_collinear_stretched_arms_are_refused(seed, opposed)


@pytest.mark.parametrize("which", [(0, 1), *(pytest.param(x, marks=pytest.mark.long) for x in ((0,), (2,)))])
def test_straight_arms_among_three_are_not_singular(which):
    """One or two straight arms of three leave the chain regular."""
    singular.test_straight_arms_among_three_are_not_singular(which)
