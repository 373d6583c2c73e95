"""`python -m tests.fuzz [cases] [seed]`: spoil so many calls, and say how they ended; exit 1 with faults."""

from __future__ import annotations

import sys

from tests.fuzz.fuzzed import every_call, fuzzed


def main(count: int = 3000, seed: int = 0) -> int:
    """Return the exit code."""
    names = every_call()
    ends, faults = fuzzed(range(seed, seed + count), names, say=lambda fault: print(fault, flush=True))
    for how, times in ends.most_common():
        print(f"{times:6d}  {how}")
    print(f"{count:6d}  cases of {len(names)} calls from seed {seed}, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
