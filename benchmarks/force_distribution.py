"""What the distribution of forces takes, beside forward dynamics and Clarabel, and its operations by number of arms.

F is the time of a bound call of forward dynamics of the same chain, in the same rounds. Run it with HOLDFAST_COMPILE
unset, on a quiet machine: `python -m benchmarks.force_distribution`.
"""

from __future__ import annotations

import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter

import numpy as np

import holdfast as hf
from benchmarks.bench.clock import Effort
from benchmarks.bench.distribution_entries import KINDS, SOFT_FINGERS, STANDS, chain_of, compare
from holdfast.compiled import CompiledChain
from holdfast.compiled.structure import Options

EFFORT = Effort(turn=0.02, rounds=25)


def counts(kind: str) -> list[int]:
    """Return the operations of a call with equal arms, of 2, 3, 4 and 5 of them."""
    base, _ = chain_of(kind)
    arm, grasp = base.arms[base.names[0]], base.grasps[base.names[0]]
    found = []
    for number in (2, 3, 4, 5):
        names = [f"arm{k}" for k in range(number)]
        chain = hf.ClosedChain(dict.fromkeys(names, arm), base.held_object, dict.fromkeys(names, grasp))
        found.append(CompiledChain(chain, Options(), None).distribute.calls.kernel.operation_count)
    return found


def main() -> None:
    """Print microseconds and multiples of F, and operations by number of arms."""
    listed = [*((kind, STANDS[0]) for kind in KINDS), *((SOFT_FINGERS, stand) for stand in STANDS[1:])]
    for kind, stand in listed:
        print(f"{f'{kind}, {stand}':30}{'us':>10}{'F':>8}")
        for row in compare(kind, EFFORT, time.process_time, stand):
            print(f"{row['name']:30}{row['microseconds']:10.2f}{row['ratio']:8.2f}")
        if stand == STANDS[0]:
            found = counts(kind)
            print(f"operations of 2, 3, 4, 5 arms: {found}; second differences {np.diff(found, 2).tolist()}")
        print()


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
