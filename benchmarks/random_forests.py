"""Random forests of ten families in six variants: accelerations, forces and ranks against fifty digits.

    python -m benchmarks.random_forests --count 1000 [--first 0] [--compiled 0]

Every forest is solved by the elimination and by dense equations, and the first `--compiled` of them also by machine
code, which takes seconds to make for each. Those in singular postures, in which no accelerations satisfy the closures,
must be refused; whether they are such is found in fifty digits.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from tests.oracles.forest_equations import ForestEquations, Truth
from tests.systems.random_forests import ForestProblem, random_forest

from holdfast.cli.forest_answers import COMPILED, by_machine_code
from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_dynamics import ForestResult, forest_dynamics
from holdfast.errors import SingularChainError

METHODS = ("sequential", "kkt")
BAR, LIGHT_BAR = 1e-9, 1e-8
MISSED = 1e-9  # accelerations that miss a row by more, relative to the largest, do not satisfy the closures


class Outcome(NamedTuple):
    """How one forest was solved by one method.

    Attributes:
        name: of the forest.
        method: "sequential", "kkt" or "compiled".
        error: largest relative error of accelerations and forces; NaN if it was refused.
        beyond: whether it exceeds the bar.
        rank_right: whether the rank is that of fifty digits.
        refusal_right: whether it was refused exactly if no accelerations satisfy the closures.
        wrong: whether the error exceeds the bar and the status is OK.
        over_constrained: whether some rows depend on others.
    """

    name: str
    method: str
    error: float
    beyond: bool
    rank_right: bool
    refusal_right: bool
    wrong: bool
    over_constrained: bool


def largest_error(found: ForestResult, truth: Truth) -> float:
    """Return the largest of max|x - e| / max(1, max|e|) over accelerations and forces."""
    pairs = [(getattr(found, name), getattr(truth, name)) for name in truth._fields[:4]]
    return max(np.abs(x - e).max(initial=0.0) / max(1.0, np.abs(e).max(initial=0.0)) for x, e in pairs)


def outcome(p: ForestProblem, truth: Truth, method: str) -> Outcome:
    """Return how a forest is solved."""
    over = truth.rank < p.forest.constraint_row_count
    impossible = truth.missed > MISSED * max(1.0, float(np.abs(truth.acceleration).max(initial=0.0)))
    try:
        found = by_machine_code(*p[1:]) if method == COMPILED else forest_dynamics(*p[1:], method=method)
    except SingularChainError:
        return Outcome(p.name, method, np.nan, False, True, impossible, False, over)
    error = largest_error(found, truth)
    beyond = error > (LIGHT_BAR if "_light_" in p.name else BAR)
    wrong = beyond and found.status is Status.OK
    return Outcome(p.name, method, error, beyond, found.rank == truth.rank, not impossible, wrong, over)


def outcomes(first: int, count: int, compiled: int = 0) -> Iterator[Outcome]:
    """Yield how forests are solved, by every method; by machine code only the first `compiled`."""
    for seed in range(first, first + count):
        p = random_forest(seed)
        truth = ForestEquations(*p[1:], digits=50).solved()
        for method in (*METHODS, *([COMPILED] if seed < first + compiled else [])):
            yield outcome(p, truth, method)


def main() -> None:
    """Solve random forests and print a line per variant and method, and all that is not as it should be."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--compiled", type=int, default=0)
    given = parser.parse_args()
    found: dict[tuple[str, str], list[Outcome]] = defaultdict(list)
    for one in outcomes(given.first, given.count, given.compiled):
        variant = next((name for name in ("light", "heavy") if f"_{name}_" in one.name), "others")
        found[one.method, variant].append(one)
        if one.beyond or not one.rank_right or not one.refusal_right:
            print(f"{one.method}: {one.name}: error {one.error:.1e}, rank right: {one.rank_right},", end=" ")
            print(f"refused or not as it should be: {one.refusal_right}", flush=True)
    for (method, variant), some in sorted(found.items()):
        errors = [one.error for one in some if not np.isnan(one.error)]
        print(
            f"{method}, {variant}: {len(some)} forests, {sum(one.over_constrained for one in some)} over-constrained,"
            f" {len(some) - len(errors)} refused, rank right in {sum(one.rank_right for one in some)},"
            f" error median {np.median(errors):.0e}, largest {max(errors):.0e},"
            f" wrong with status OK: {sum(one.wrong for one in some)}"
        )


if __name__ == "__main__":
    main()
