"""A small share of the random forests that `python -m benchmarks.random_forests` solves."""

import pytest
from benchmarks.random_forests import METHODS, Outcome, outcomes


def check(found: list[Outcome]) -> None:
    """Assert that ranks and refusals are right, and no error beyond the bar."""
    assert [one for one in found if not one.rank_right or not one.refusal_right or one.wrong or one.beyond] == []


@pytest.mark.slow
def test_random_forests():
    """Some of every family, over-constrained ones among them."""
    found = list(outcomes(1000, 20))
    assert len(found) == 20 * len(METHODS)
    assert 3 < sum(one.over_constrained for one in found) / len(METHODS) < 17
    check(found)


@pytest.mark.long
def test_many_random_forests():
    """A thousand, with the same bars."""
    check(list(outcomes(0, 1000)))
