"""Old names: they work, and say at the caller's line what they are called now."""

import sys
import types

import pytest

from holdfast.errors import DeprecatedNameWarning, warn_renamed


def step(dt=None, *, length=None):
    """A function whose keyword was renamed."""
    if length is not None:
        warn_renamed("step(length=)", "step(dt=)", "0.3")
        dt = length
    return dt


def test_an_old_keyword():
    """The warning says what to write, and points at the line that is to be changed."""
    with pytest.warns(
        DeprecatedNameWarning, match=r"^step\(length=\) is now step\(dt=\); .* goes with version 0.3$"
    ) as said:
        assert step(length=2.0) == 2.0
    assert said[0].filename == __file__
    assert step(dt=1.0) == 1.0  # no warning, which would be an error


def test_an_old_name_of_a_module(monkeypatch):
    """A module's `__getattr__` answers an old name."""
    module = types.ModuleType("module_with_an_old_name")

    def lookup(name):
        if name == "old":
            warn_renamed("module.old", "module.new", "0.3")
            return module.new
        raise AttributeError(name)

    module.new, module.__getattr__ = object(), lookup
    monkeypatch.setitem(sys.modules, module.__name__, module)
    with pytest.warns(DeprecatedNameWarning, match=r"module\.new") as said:
        assert module.old is module.new
    assert said[0].filename == __file__


def test_shown_without_a_filter():
    """Users see it, not only those who develop: Python hides warnings of the category DeprecationWarning."""
    assert issubclass(DeprecatedNameWarning, FutureWarning)
