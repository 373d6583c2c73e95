"""The allowed error of a step, and the estimated one beside it."""

import numpy as np
import pytest

from holdfast import ModelError, State
from holdfast.simulation.tolerance import Tolerance

BEFORE = State(np.array([0.0, 2.0]), np.array([0.0, -40.0]), np.array([1.0, 0, 0, 0, 0, 3.0, 0]), np.arange(6.0))
AFTER = State(np.array([0.0, -4.0]), np.array([0.5, 30.0]), np.array([1.0, 0, 0, 0, 5.0, 0, 0]), np.zeros(6))


def estimates(seed=0):
    """Return two estimates of the size of 1e-9."""
    return list(1e-9 * np.random.default_rng(seed).normal(size=(2, 20)))


def test_sizes_are_those_of_groups():
    """A joint at rest is allowed what the fastest is; an attitude counts as 1 rad; the larger end counts."""
    allowed = Tolerance(1e-6, 1e-8).allowed(BEFORE, AFTER)
    sizes = [4, 4, 40, 40, 1, 1, 1, 5, 5, 5, 2, 2, 2, 5, 5, 5]
    np.testing.assert_allclose(allowed, 1e-8 + 1e-6 * np.array(sizes), rtol=1e-15)
    np.testing.assert_allclose(Tolerance(1e-6).allowed(BEFORE, AFTER), 1e-6 * (1 + np.array(sizes)), rtol=1e-15)


def test_ratio_scales():
    """Twice the error or half the tolerance is twice the ratio; a ratio of one is an error as allowed."""
    given = estimates()
    ratio = Tolerance(1e-8).ratio(given, BEFORE, AFTER)
    assert ratio > 0
    assert Tolerance(1e-8).ratio([2 * e for e in given], BEFORE, AFTER) == pytest.approx(2 * ratio)
    assert Tolerance(0.5e-8).ratio(given, BEFORE, AFTER) == pytest.approx(2 * ratio)
    allowed = np.concatenate([Tolerance(1e-8).allowed(BEFORE, AFTER), np.zeros(4)])
    assert Tolerance(1e-8).ratio([allowed, 0 * allowed], BEFORE, AFTER) == pytest.approx(1.0)
    # the fifth-order estimate is squared and divided by the third's tenth part: order 7
    assert Tolerance(1e-8).ratio([1e-3 * allowed, allowed], BEFORE, AFTER) == pytest.approx(1e-5, rel=1e-3)


def test_work_is_not_controlled():
    """The last four, the work done, do not count; and a scheme without estimates has no error."""
    given = estimates()
    other = [np.concatenate([e[:16], np.full(4, 1e9)]) for e in given]
    tolerance = Tolerance()
    assert tolerance.ratio(given, BEFORE, AFTER) == tolerance.ratio(other, BEFORE, AFTER)
    assert tolerance.ratio([], BEFORE, AFTER) == 0.0
    assert tolerance.ratio([np.zeros(20), np.ones(20)], BEFORE, AFTER) == 0.0


@pytest.mark.parametrize(
    ("what", "given"), [("rtol", (0.0,)), ("rtol", (1e-16,)), ("rtol", (np.nan,)), ("atol", (1e-8, -1.0))]
)
def test_refused(what, given):
    """A tolerance that is not positive, or finer than floats, is refused by name."""
    with pytest.raises(ModelError, match=f"tolerance: {what}: expected"):
        Tolerance(*given)
