"""Wrong shapes of the world and wrong features: an answer, or an error of ours on one line."""

import pytest

from tests.fuzz.calls import CALLS
from tests.fuzz.ended import ended
from tests.fuzz.fuzzed import fuzzed

pytest.importorskip("coal", reason="needs coal: pip install 'holdfast[dev]'")

from tests.fuzz import world_calls  # noqa: F401 (adds its calls)

NAMES = sorted(name for name in CALLS if name.startswith("world."))


def test_sound_calls_are_answered():
    """As they are in the table, so that what is spoilt is what is refused."""
    for name in NAMES:
        assert ended(lambda one=CALLS[name]: one.make(**one.given())) == "answered", name


@pytest.mark.parametrize("count", [150, pytest.param(2000, marks=pytest.mark.long)])
def test_wrong_shapes(count):
    """Of all kinds, the given number."""
    ends, faults = fuzzed(range(count), NAMES)
    print(dict(ends))
    assert not faults, "\n".join(faults)
    assert ends["ModelError"]
