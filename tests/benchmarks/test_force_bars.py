"""The numbers of `benchmarks/force_bars.py` are as required; the long ones in the long checks."""

import pytest
from benchmarks import force_bars

from tests.longer import mostly_long


def test_bar():
    """A number is met on the right side of its bound."""
    assert force_bars.Bar("x", 1.0, 2.0).met and not force_bars.Bar("x", 1.0, 2.0, at_most=False).met
    assert str(force_bars.Bar("x", 3.0, 2.0)).endswith("MISSED")


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    mostly_long(
        [force_bars.palm, force_bars.bends, force_bars.tray, force_bars.tape], [force_bars.palm, force_bars.tray]
    ),
)
def test_met(task):
    """Every number of a task is met."""
    for bar in task():
        assert bar.met, bar


@pytest.mark.slow
def test_the_largest_margin_would_not_do():
    """The bar on steps is one that torques of the largest margin miss by far."""
    chain, state = force_bars.three_pandas()
    assert force_bars.turning(chain, state, form="margin")[0] > 5 * 0.02


@pytest.mark.long
def test_paths():
    """Timings of all paths are near those of a joint programme, and keep the limits between nodes."""
    pytest.importorskip("clarabel", reason="needs Clarabel: pip install clarabel")
    for bar in force_bars.paths():
        assert bar.met, bar


@pytest.mark.long
def test_hand():
    """The Allegro hand holds the ball in every tilt of its palm."""
    if force_bars.allegro() is None:
        pytest.skip("no robots fetched: make robots")
    for bar in force_bars.hand():
        assert bar.met, bar
