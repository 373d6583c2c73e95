"""Calls spoilt by seeds: the same seed is the same wrong call, of the same table."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import pytest

from tests.fuzz import branch_calls, chain_calls, part_calls  # noqa: F401 (adds its calls)
from tests.fuzz.calls import CALLS
from tests.fuzz.ended import Fault, ended
from tests.fuzz.odd import spoilt


def fuzzed(
    seeds: Iterable[int], names: Sequence[str], say: Callable[[str], object] = lambda fault: None
) -> tuple[Counter[str], list[str]]:
    """Return how often calls ended how, and what no user should have seen.

    Args:
        seeds: one for each wrong call.
        names: of the calls to choose among.
        say: called with every fault.
    """
    ends: Counter[str] = Counter()
    faults: list[str] = []
    for seed in seeds:
        dice = random.Random(seed)
        name = dice.choice(names)
        given, changes = spoilt(dice, CALLS[name].given(), CALLS[name].names())
        try:
            ends[ended(lambda name=name, given=given: CALLS[name].make(**given))] += 1
        except Fault as fault:
            ends["FAULT"] += 1
            placed = "; ".join(
                f"{'.'.join(map(str, where))} = {' '.join(repr(x)[:100].split())}" for where, x in changes
            )
            faults.append(f"seed {seed}, {name}, {placed}: {fault}")
            say(faults[-1])
    return ends, faults


SLOW = ("linearise", "forward_dynamics_jacobian", "assemble")
LIBRARIES = ("jax", "gymnasium", "pyarrow", "mujoco", "pandas", "xarray")
QUICK = [name for name in CALLS if not name.startswith(SLOW)]


def every_call() -> list[str]:
    """Return the names of all calls, those of machine code, runs and files too."""
    for library in LIBRARIES:
        pytest.importorskip(library, reason=f"needs {library}: pip install 'holdfast[dev]'")
    from tests.fuzz import compiled_calls, file_calls, run_calls  # noqa: F401 (adds its calls)

    return list(CALLS)
