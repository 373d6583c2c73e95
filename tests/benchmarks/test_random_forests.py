"""A small share of the random forests that `python -m benchmarks.random_forests` solves."""

import pytest
from benchmarks.random_forests import METHODS, Outcome, outcomes


def check(found: list[Outcome]) -> None:
    """Assert that ranks and refusals are right, and no error beyond the bar."""
    assert [one for one in found if not one.rank_right or not one.refusal_right or one.wrong or one.beyond] == []


def test_random_forests():
    """Every family in every variant, over-constrained ones among them."""
    found = list(outcomes(0, 60))
    assert len(found) == 60 * len(METHODS)
    assert 10 < sum(one.over_constrained for one in found) / len(METHODS) < 50
    check(found)


@pytest.mark.long
def test_many_random_forests():
    """A thousand, with the same bars."""
    check(list(outcomes(0, 1000)))
