"""Arms on a trunk against 50 digits: 1,000 random systems with everything on, any mass, nearly straight arms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import count, islice

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import ForwardResult
from tests.acceptance.comparison import trunk_errors
from tests.oracles.every_body import EveryBody, Truth
from tests.systems import one_straight_arm_of_three
from tests.systems.as_chain import Problem, as_chain
from tests.systems.random_trunks import random_trunk_system, scaled_object
from tests.systems.trunk_problems import in_machine_code, on_trunk

pytestmark = pytest.mark.long

DIGITS = 50
CHUNKS, EACH, COMPILED = 20, 50, 5  # COMPILED: how many of each chunk by machine code
CONDITION = 1e6
TOLERANCE = 1e-9
EXACT = 1e-11
FIRM = 1e3  # condition of systems for objects of any mass
MISSED = 1e-9  # by rows that follow from others: more, and no motion keeps the grasps
ROUTES = ("recursive", "mass_matrix")


def accepted(seed: int, drawn: Counter[str]) -> Iterator[tuple[Problem, EveryBody, Truth]]:
    """Return random systems with their solutions, for ever; what is left out is counted."""
    for k in count(seed):
        problem = random_trunk_system(k)
        oracle = EveryBody(problem, DIGITS)
        if not oracle.condition < CONDITION:
            drawn["nearly singular"] += 1
            continue
        truth, missed = oracle.solved()
        if missed > MISSED:
            drawn["without motion"] += 1
            continue
        drawn["of unique forces" if oracle.unique else "of many forces"] += 1
        yield problem, oracle, truth


def note(worst: dict[str, dict[str, float]], way: str, found: ForwardResult, oracle: EveryBody, truth: Truth) -> None:
    """Keep the worst errors of a way to solve; the rank must be right."""
    chain = oracle.problem.chain
    assert found.rank == oracle.rank + chain.contact_freedom_count
    of_way = worst.setdefault(way, {})
    for part, error in trunk_errors(found, oracle, truth).items():
        of_way[part] = float(np.maximum(error, of_way.get(part, 0.0)))  # not-a-number stays


def largest(worst: dict[str, dict[str, float]]) -> float:
    """Return the largest error of all."""
    return float(np.max([error for of_way in worst.values() for error in of_way.values()]))


def show(what: str, worst: dict[str, dict[str, float]]) -> None:
    """Print the worst errors."""
    for way, errors in worst.items():
        print(f"{what}: {way}: " + ", ".join(f"{part} {error:.1e}" for part, error in errors.items()))


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_a_thousand_random_systems(chunk):
    """`sequential` by both routes and `kkt`, which takes unique forces only: <= 1e-9 of 50 digits, and the rank."""
    worst, drawn = {}, Counter[str]()
    for problem, oracle, truth in islice(accepted(10_000 * chunk, drawn), EACH):
        for route in ROUTES:
            note(worst, route, problem.solved(route=route), oracle, truth)
        if oracle.unique:
            note(worst, "kkt", problem.solved(method="kkt"), oracle, truth)
        else:
            with pytest.raises(hf.errors.MethodNotApplicable, match="nullity"):
                problem.solved(method="kkt")
    show(f"{dict(drawn)}", worst)
    assert largest(worst) <= TOLERANCE


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_machine_code_of_a_hundred(chunk):
    """The same of machine code, each compiled for its system."""
    worst, drawn = {}, Counter[str]()
    for problem, oracle, truth in islice(accepted(10_000 * chunk, drawn), COMPILED):
        note(worst, "machine code", in_machine_code(problem), oracle, truth)
    show(f"{dict(drawn)}", worst)
    assert largest(worst) <= TOLERANCE


@pytest.mark.parametrize("scale", [1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2])
def test_any_mass_of_the_object(scale):
    """Objects from 1e-8 to 1e2 of the usual mass: <= 1e-11 of 50 digits by both routes and by machine code."""
    worst, drawn = {}, Counter[str]()
    for k, problem in enumerate(islice(firmly_held(drawn), EACH)):
        problem = scaled_object(problem, scale)
        oracle = EveryBody(problem, DIGITS)
        truth, _ = oracle.solved()
        for route in ROUTES:
            note(worst, route, problem.solved(route=route), oracle, truth)
        if k < 2:
            note(worst, "machine code", in_machine_code(problem), oracle, truth)
    show(f"object x {scale:.0e}", worst)
    assert largest(worst) <= EXACT


def firmly_held(drawn: Counter[str]) -> Iterator[Problem]:
    """Return random systems, for ever, that hold the object: a light one that could slip away would be anywhere."""
    for problem, oracle, _ in accepted(500_000, drawn):
        if oracle.unique and oracle.condition < FIRM and oracle.grip > 1 / FIRM:
            yield problem


@pytest.mark.parametrize("floating", [False, True], ids=["standing", "floating"])
@pytest.mark.parametrize("which", [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2)])
def test_nearly_straight_arms(which, floating):
    """One arm of three or two, down to 1e-6 rad from straight and exactly so: <= 1e-11 of 50 digits."""
    for bend in (1e-2, 1e-4, 1e-6, 0.0):
        worst = {}
        for seed, joints in enumerate((1, 3, 6)):
            straight = as_chain(one_straight_arm_of_three(bend, which, seed))
            problem = on_trunk(straight, seed, joints, floating=floating)
            oracle = EveryBody(problem, DIGITS)
            truth, _ = oracle.solved()
            for route in ROUTES:
                note(worst, route, problem.solved(route=route), oracle, truth)
        note(worst, "machine code", in_machine_code(problem), oracle, truth)
        show(f"arms {which}, bend {bend:.0e}", worst)
        assert largest(worst) <= EXACT
