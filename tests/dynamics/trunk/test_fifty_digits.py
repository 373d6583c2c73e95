"""A few of the random systems of tests/acceptance/test_trunks.py, everything on, against 50 digits."""

from collections import Counter
from itertools import islice

import pytest

from tests.acceptance.comparison import trunk_errors
from tests.acceptance.test_trunks import ROUTES, TOLERANCE, accepted
from tests.systems.trunk_problems import in_machine_code

SYSTEMS, COMPILED = 10, 1


@pytest.mark.slow
def test_random_systems():
    """`sequential` by both routes, `kkt` where forces are unique, machine code: <= 1e-9, and the rank."""
    drawn = Counter[str]()
    for k, (problem, oracle, truth) in enumerate(islice(accepted(50, drawn), SYSTEMS)):
        found = [problem.solved(route=route) for route in ROUTES]
        found += [problem.solved(method="kkt")] if oracle.unique else []
        found += [in_machine_code(problem)] if k < COMPILED else []
        for result in found:
            assert result.rank == oracle.rank + problem.chain.contact_freedom_count
            assert all(error <= TOLERANCE for error in trunk_errors(result, oracle, truth).values())
    assert drawn["of unique forces"] and drawn["of many forces"]
