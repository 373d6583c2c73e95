"""Times that steps end at: grid, jumps from both sides, nothing twice."""

import numpy as np
import pytest

from holdfast import ModelError
from holdfast.simulation.stops import step_times, stops


def test_times_end_exactly():
    """The last time is the duration, whether or not the step divides it."""
    assert step_times(2.0, 0.001)[-1] == 2.0
    assert len(step_times(2.0, 0.001)) == 2001
    assert step_times(0.1, 0.03) == pytest.approx([0, 0.03, 0.06, 0.09, 0.1])
    assert len(step_times(0.3, 0.1)) == 4


def test_jumps_have_two_sides():
    """A breakpoint is reached from below and jumped onto; grid times too near to it give way."""
    found = stops(step_times(1.0, 0.25), [0.3, 0.5 + 1e-12, 0.75], [1.0], 1e-9)
    sides = [[np.nextafter(t, -1), t] for t in (0.3, 0.5 + 1e-12, 0.75, 1.0)]
    assert found.times.tolist() == [0.25, *np.ravel(sides)]
    assert found.jumps.tolist() == [False, *4 * [False, True]]


def test_breakpoints_outside_do_not_matter():
    """Those before, at the start, at the end and after leave the grid as it is."""
    grid = step_times(1.0, 0.3)
    found = stops(grid, [-1.0, 0.0, 1.0, 7.0], [], 1e-9)
    assert np.array_equal(found.times, grid[1:])
    assert not found.jumps.any()


@pytest.mark.parametrize("seed", range(5))
def test_times_increase(seed):
    """Whatever the breakpoints, times never fall, jumps follow their other side, and the end is the end."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(0, 1, 20)
    at = np.r_[at, np.nextafter(at[:5], 2), rng.choice(step_times(1.0, 0.01), 5)]
    found = stops(step_times(1.0, 0.01), at.tolist(), [], 1e-11)
    assert (np.diff(found.times) >= 0).all()
    assert found.times[-1] == 1.0
    for k in np.flatnonzero(found.jumps):
        assert np.nextafter(found.times[k], -1) in found.times[:k]
    assert set(at[(at > 0) & (at < 1)]) <= set(found.times)


@pytest.mark.parametrize("bad", [[np.inf], [np.nan], ["0.5"], [None]])
def test_bad_breakpoints(bad):
    """Only finite times are times."""
    with pytest.raises(ModelError, match="simulation: breakpoints: expected"):
        stops(step_times(1.0, 0.1), bad, [], 0.0)
