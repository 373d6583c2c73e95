"""Two records of a run are compared field by field: nothing beyond its bar passes, nothing within it fails."""

import copy

import numpy as np
import pytest
from benchmarks.against import recorded
from benchmarks.random_families import FAMILIES
from benchmarks.run_differences import differences

SCENES = len(FAMILIES)
PLATFORM = list(FAMILIES).index("platforms")


@pytest.fixture(scope="module")
def run():
    """A run of fixed steps as it is recorded, with an occurrence in the middle."""
    made = recorded(PLATFORM)
    assert made["error"] is None and made["tolerance"] == 0.0 and len(made["arrays"]["t"]) > 10
    t = float(made["arrays"]["t"][5])
    text = "'arm1' slips at 12.3 N, 0.04567 s"
    return made | {"occurrences": [{"t": t, "kind": "violation", "name": "arm1", "text": text, "lowest": None}]}


def changed(run, change):
    """Return a copy of a record to which something was done."""
    other = copy.deepcopy(run)
    change(other)
    return other


@pytest.mark.slow
def test_a_run_is_a_function_of_its_seed(run):
    """Recorded again it has the same bits."""
    again = recorded(PLATFORM)
    for name, x in run["arrays"].items():
        assert x.tobytes() == again["arrays"][name].tobytes(), name


@pytest.mark.slow
def test_all_that_is_recorded_is_compared(run):
    """Whatever array is changed by 1e-8 of its size, early or late, or is missing, that is said."""
    assert differences(run, copy.deepcopy(run)).failures == {}
    numbers = {name: x for name, x in run["arrays"].items() if x.size and np.isfinite(x).all()}
    assert len(numbers) > 20
    for name, x in numbers.items():
        for sample in (0, -1):
            x = x.astype(float)
            other = x.copy()
            other[sample] += 1e-8 * max(1.0, np.abs(x).max())
            old, new = (run | {"arrays": run["arrays"] | {name: values}} for values in (x, other))
            assert differences(old, new).failures, (name, sample)
    for name in run["arrays"].keys() - {"t"}:
        assert differences(run, changed(run, lambda r, name=name: r["arrays"].pop(name))).failures, name


@pytest.mark.parametrize(
    ("sample", "by", "part", "fails"),
    [(1, 5e-12, "before", False), (1, 2e-11, "before", True), (8, 5e-10, "after", False), (8, 2e-9, "after", True)],
)
def test_bars(run, sample, by, part, fails):
    """1e-11 up to the first event, 1e-9 after it; what is finite is not infinite."""
    other = changed(run, lambda r: r["arrays"]["q"].__setitem__((sample, 0), r["arrays"]["q"][sample, 0] + by))
    found = differences(run, other)
    assert found.worst(part, set()) == pytest.approx(by, rel=1e-3) and bool(found.failures) is fails
    other["arrays"]["q"][sample, 0] = np.inf
    assert differences(run, other).failures
    adaptive = changed(run, lambda r: r["arrays"]["q"].__setitem__((sample, 0), r["arrays"]["q"][sample, 0] + 9e-8))
    assert not differences(run | {"tolerance": 1e-8}, adaptive).failures
    assert differences(run | {"tolerance": 1e-9}, adaptive).failures


def test_samples_of_adaptive_steps(run):
    """Those in common count if there are others in between; fixed steps have the same ones."""

    def without_one(r):
        r["arrays"] = {name: np.delete(x, 3, axis=0) for name, x in r["arrays"].items()}

    fewer = changed(run, without_one)
    assert [*differences(run, fewer).failures] == [("words", "samples")]
    assert not differences(run | {"tolerance": 1e-8}, fewer).failures


@pytest.mark.parametrize(
    ("change", "fails"),
    [
        ({"text": "'arm1' slips at 12.4 N, 0.04567 s"}, False),  # its last digit
        ({"text": "'arm1' slips at 12.3 N, 0.04577 s"}, True),
        ({"text": "'arm1' slides at 12.3 N, 0.04567 s"}, True),
        ({"text": "'arm2' slips at 12.3 N, 0.04567 s"}, True),
        ({"kind": "recovery"}, True),
        ({"name": "arm2"}, True),
        ({"lowest": 0.5}, True),
    ],
)
def test_words_of_occurrences(run, change, fails):
    other = changed(run, lambda r: r["occurrences"][0].update(change))
    assert bool(differences(run, other).failures) is fails


def test_instants_ends_and_errors(run):
    """A nanosecond, an end, an error, an occurrence less."""
    late = changed(run, lambda r: r["occurrences"][0].update(t=r["occurrences"][0]["t"] + 2e-9))
    found = differences(run, late)
    assert found.worst("instants", set()) == pytest.approx(2e-9, rel=1e-3) and found.failures
    for change in ({"stopped": "too long"}, {"error": "StateError: no"}, {"occurrences": []}):
        assert differences(run, run | change).failures


def test_what_rounding_explains(run):
    """Up to 100 times of what it does to the same thing; words, if it changes the same ones."""

    def off(by):
        other = copy.deepcopy(run)
        other["arrays"]["q"][2, 0] += by
        return differences(run, other)

    found = off(1e-7)
    assert found.explained([]) == set() == found.explained([off(0.0), off(5e-10)])
    assert found.explained([off(0.0), off(2e-9)]) == {("before", "q")}
    assert found.worst("before", {("before", "q")}) == 0.0
    said, other = (
        differences(run, changed(run, lambda r, text=text: r["occurrences"][0].update(text=text))) for text in "ab"
    )
    assert said.explained([other]) == set(said.failures) and not said.explained([found])


@pytest.mark.slow
def test_a_nudge_is_a_rounding_error(run):
    """It changes the run, far below every bar where the run is well-conditioned."""
    found = differences(run | {"occurrences": []}, recorded(PLATFORM, nudge=1))
    assert 0.0 < found.worst("before", set()) < 1e-12 and not found.failures


@pytest.mark.long
@pytest.mark.parametrize("seed", range(SCENES))
def test_every_family_makes_runs(seed):
    """Made of public names alone; what a family refuses, the library says itself."""
    made = recorded(seed)
    assert made["family"] == list(FAMILIES)[seed]
    assert len(made["arrays"].get("t", ())) or made["error"] or made["stopped"], made["options"]
