"""Timing: every entry gets its turn in every round."""

import gc
import time

import pytest

from holdfast.bench.clock import Effort, summary, timed
from holdfast.bench.entry import Entry


def sleeper(name, seconds, evaluations=1, log=None):
    """Return an entry that sleeps, and the list of its turns."""

    def sweep():
        if log is not None:
            log.append((name, gc.isenabled()))
        time.sleep(seconds)

    return Entry(name, "made up", sweep, evaluations, lambda: None)


def test_seconds_per_evaluation():
    """A sweep's time is shared among its evaluations."""
    seconds = timed([sleeper("a", 1e-3), sleeper("b", 4e-3, evaluations=4)], Effort(2e-3, 5))
    assert seconds.shape == (5, 2)
    assert (seconds >= 1e-3).all()
    found = summary(seconds[:, 1])
    assert found["lower_quartile"] <= found["microseconds"] <= found["upper_quartile"]
    assert found["microseconds"] == pytest.approx(1e3, rel=0.5)


def test_turns_rotate_and_nothing_is_collected():
    """No entry always follows the same other; the collector rests while the clock runs, and only then."""
    log, rounds = [], []
    timed([sleeper(n, 2e-3, log=log) for n in "abc"], Effort(1e-3, 3), lambda: rounds.append(len(log)))
    turns = [name for name, _ in log[-9:]]
    assert turns == list("abcbcacab")
    assert len(rounds) == 3
    assert not any(collecting for _, collecting in log)
    assert gc.isenabled()
