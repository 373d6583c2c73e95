"""Whatever a public call is given: an answer, or an error of ours on one line; no warning, no NaN, no file begun."""

from __future__ import annotations

import pytest

from tests.fuzz.calls import CALLS
from tests.fuzz.ended import ended
from tests.fuzz.fuzzed import fuzzed
from tests.fuzz.table import QUICK, every_call

CASES, PARTS = 3000, 6


@pytest.mark.parametrize("part", range(4))
def test_some_wrong_calls(part):
    """A few hundred of what needs no machine code."""
    ends, faults = fuzzed(range(part, 240, 4), QUICK)
    assert not faults, "\n".join(faults)
    assert ends["answered"] and ends["StateError"] and ends["ModelError"]


@pytest.mark.slow
def test_sound_calls_are_answered():
    """As they are in the table, so that what is spoilt is what is refused."""
    for name in every_call():
        assert ended(lambda one=CALLS[name]: one.make(**one.given())) == "answered", name


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_3000_wrong_calls(part):
    """Of all there are, in parts that can go side by side."""
    ends, faults = fuzzed(range(part, CASES, PARTS), every_call())
    print(dict(ends))
    assert not faults, "\n".join(faults)
