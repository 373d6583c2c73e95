"""Sound calls of what the library offers, as functions of nested arguments that a fuzz can spoil."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import holdfast as hf
from tests.systems.anchored import pinned_to_trunk
from tests.systems.as_chain import Problem
from tests.systems.bushed import bushed
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import on_trunk


@dataclass(frozen=True)
class Call:
    """A call.

    Attributes:
        make: takes the arguments by name and returns what comes of them.
        given: returns sound arguments: numbers, arrays, parts, lists and dicts of them.
    """

    make: Callable[..., Any]
    given: Callable[[], dict[str, Any]]

    def names(self) -> list[str]:
        """Return the arguments whose names the library reads; a test's own function reads the others itself."""
        if self.make.__module__.startswith("holdfast"):
            return [*self.given()]
        taken = inspect.signature(self.make).parameters.values()
        if not any(one.kind is one.VAR_KEYWORD for one in taken):
            return []
        return [name for name in self.given() if name not in {one.name for one in taken}]


CALLS: dict[str, Call] = {}


def call(name: str, /, **given: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add a function of its sound arguments to the table; a callable that has no parameters makes one."""

    def add(make: Callable[..., Any]) -> Callable[..., Any]:
        assert name not in CALLS
        CALLS[name] = Call(make, lambda: {key: x.made() if isinstance(x, Later) else x for key, x in given.items()})
        return make

    return add


def shown(ask: Callable[..., Any]) -> Callable[..., str]:
    """Return what shows the text of a function's answer."""
    return lambda **given: repr(ask(**given))


@dataclass(frozen=True)
class Later:
    """An argument that is made when it is first needed."""

    made: Callable[[], Any]


def state_of(given: Any) -> Any:
    """Return the state of numbers by name; what is none stays."""
    return hf.State(**given) if named(given, hf.State) else given


def inputs_of(given: Any) -> Any:
    """Return the inputs of numbers by name; what is none stays."""
    return hf.Inputs(**given) if named(given, hf.Inputs) else given


def named(given: Any, kind: Any) -> bool:
    """Return whether something can be keyword arguments of a constructor; another call is Python's to refuse."""
    try:
        inspect.signature(kind).bind(**given)
    except TypeError:
        return False
    return isinstance(given, dict)


def numbers_of(part: Any) -> dict[str, Any]:
    """Return the fields of a state or inputs that are given."""
    return {one.name: x for one in fields(part) if (x := getattr(part, one.name)) is not None}


# The chains.


@cache
def everything() -> Problem:
    """Return two arms and an anchor on a floating trunk of one joint, a bushing, springs; everything moves."""
    options = {"moving_base": False, "extras": False}
    p = bushed(random_problem(3, joints=(3, 6), grasps=("ball", "rigid"), **options), ("arm2",))
    p = pinned_to_trunk(on_trunk(p, 3, 1, floating=True, in_world=0.0), "ball")
    springs = [
        hf.Spring(("world", [0.0, 0.0, 1.0]), ("object", [0.1, 0.0, 0.0]), 20.0, 0.1, 0.5),
        hf.Spring(("trunk", "base", [0.0, 0.2, 0.0]), ("arm1", 1, [0.0, 0.0, 0.1]), 10.0),
    ]
    return replace(p, chain=replace(p.chain, springs=springs))


@cache
def fixed() -> Problem:
    """Return two arms that hold the object by a rigid grasp and a soft finger, on bases that stand."""
    return random_problem(1, joints=(4, 6), grasps=("softfinger", "rigid"), moving_base=False, extras=False)


PROBLEMS: dict[str, Callable[[], Problem]] = {"everything": everything, "fixed": fixed}


@cache
def rigid() -> Problem:
    """Return two arms that hold the object rigidly."""
    return random_problem(2, joints=(6, 7), grasps=("rigid", "rigid"), moving_base=False, extras=False)


def stay(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
    """Return torques that pull joints back, and a memory that counts."""
    return -given["gain"] * state.q - 2.0 * state.qd, memory + 1.0
