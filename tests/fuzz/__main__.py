"""`python -m tests.fuzz [cases] [seed]`: spoil so many calls, and say how they ended; exit 1 with faults."""

from __future__ import annotations

import sys

from tests.fuzz import compiled_calls  # noqa: F401 (adds its calls)
from tests.fuzz.calls import CALLS
from tests.fuzz.fuzzed import fuzzed


def main(count: int = 3000, seed: int = 0) -> int:
    """Return the exit code."""
    ends, faults = fuzzed(range(seed, seed + count), list(CALLS), say=lambda fault: print(fault, flush=True))
    for how, times in ends.most_common():
        print(f"{times:6d}  {how}")
    print(f"{count:6d}  cases of {len(CALLS)} calls from seed {seed}, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
