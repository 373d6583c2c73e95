"""The benchmark's systems, and one system's record: who is accurate, who was left out and why; fair timing."""

import gc
import time

import numpy as np
import pytest
from benchmarks.bench import measure
from benchmarks.bench.clock import Effort, summary, timed
from benchmarks.bench.entries import Candidate, Timed, relative_error
from benchmarks.bench.systems import make_system

import holdfast
from holdfast import State, forward_dynamics
from holdfast.dynamics import closure
from tests.benchmarks.tiny import EFFORT, exact_rival


@pytest.fixture(scope="module")
def system():
    """A small system."""
    return make_system(2, 6, 3)


@pytest.fixture(scope="module")
def fast(system):
    """Its machine code."""
    return holdfast.compile(system.chain)


def entries(record):
    """Return the record's entries by name."""
    return {entry["name"]: entry for entry in record["entries"]}


def test_accuracy_decides(system, fast):
    """A peer that is off by more than 1e-9 is measured and marked."""
    rivals = [exact_rival(system, exact=True), exact_rival(system, "coarse", 1e-8), exact_rival(system, "fine", 1e-10)]
    found = entries(measure.measure_system(system, fast, rivals, EFFORT))
    assert {name: found[name]["accurate"] for name in ("rival", "coarse", "fine")} == {
        "rival": True, "coarse": False, "fine": True,
    }  # fmt: skip
    assert found["coarse"]["error"] == pytest.approx(1e-8, rel=1e-3)
    assert found["forward_dynamics"]["error"] <= 1e-11
    assert found["bind"]["wrench_error"] <= 1e-11
    assert set(found["fine"]["ratios"]) == {"forward_dynamics", "bind", "bind, copying"}
    assert found["bind"]["ratios"] == {}


def test_without_peers(system, fast):
    """Alone, our machine code is compared with our equations on NumPy."""
    record = measure.measure_system(system, fast, [], EFFORT)
    assert [entry["library"] for entry in record["entries"]] == ["holdfast"] * 3
    assert all(entry["accurate"] for entry in record["entries"])
    assert record["skipped"] == []


def test_short_memory_is_named(system, fast, monkeypatch):
    """A peer that does not fit is left out, with both numbers."""
    monkeypatch.setattr(measure, "memory_available", lambda: 2e9)
    big = exact_rival(system, "big", memory=int(3.1e9), exact=True)
    record = measure.measure_system(system, fast, [big, exact_rival(system)], EFFORT)
    assert record["skipped"] == [
        {"name": "big", "library": "made up", "reason": "needs 3.1 GB, 2.0 GB are free"}
    ]  # fmt: skip
    assert "big" not in entries(record)
    assert entries(record)["rival"]["accurate"]


def test_failing_peer_is_named(system, fast):
    """A peer that raises while it is built is left out, with its message."""

    def build(truth):
        raise RuntimeError("no such constraint")

    record = measure.measure_system(system, fast, [Candidate("broken", "made up", build)], EFFORT)
    assert record["skipped"][0]["reason"] == "RuntimeError: no such constraint"


def test_large_ones_take_turns_alone(system):
    """Each large candidate is a group of its own, so that only one is in memory."""
    small, large, huge = (exact_rival(system, name, memory=m) for name, m in (("s", 0), ("l", 10**9), ("h", 10**10)))
    groups = measure._groups([large, small, huge])
    assert [[candidate.name for candidate in group] for group in groups] == [["l"], ["h"], ["s"]]
    assert measure._groups([]) == [[]]


def test_relative_error():
    """The largest of any state, each relative to its own largest entry; what is not given does not count."""
    truth = np.array([[1.0, -10.0], [100.0, 0.0]])
    assert relative_error(truth + np.array([[0.0, 0.1], [0.1, 0.0]]), truth) == pytest.approx(0.01)
    assert relative_error(np.array([[np.nan, -10.0], [np.nan, 1.0]]), truth) == pytest.approx(0.01)
    assert np.isnan(relative_error(np.full((2, 2), np.nan), truth))


def sleeper(name, seconds, evaluations=1, log=None):
    """Return an entry that sleeps, and the list of its turns."""

    def sweep():
        if log is not None:
            log.append((name, gc.isenabled()))
        time.sleep(seconds)

    return Timed(name, "made up", sweep, evaluations)


def test_seconds_per_evaluation():
    """A sweep's time is shared among its evaluations."""
    seconds = timed([sleeper("a", 1e-3), sleeper("b", 4e-3, evaluations=4)], Effort(2e-3, 5))
    assert seconds.shape == (5, 2)
    assert (seconds >= 1e-3).all()
    found = summary(seconds[:, 1])
    assert found["lower_quartile"] <= found["microseconds"] <= found["upper_quartile"]
    assert found["microseconds"] == pytest.approx(1e3, rel=0.5)


def test_turns_rotate_and_nothing_is_collected():
    """No entry always follows the same other; the collector rests while the clock runs, and only then."""
    log = []
    timed([sleeper(n, 2e-3, log=log) for n in "abc"], Effort(1e-3, 3))
    turns = [name for name, _ in log[-9:]]
    assert turns == list("abcbcacab")
    assert not any(collecting for _, collecting in log)
    assert gc.isenabled()


CLOSED = 1e-9
SIZES = ((3, 7), (64, 7), (2, 6), (2, 96))


@pytest.mark.parametrize(("arms", "joints"), SIZES)
def test_closed_with_consistent_velocities(arms, joints):
    """Every grasp of every state holds, in position and in velocity."""
    system = make_system(arms, joints, 3)
    assert system.name == f"{arms} x {joints}"
    assert system.q.shape == system.qd.shape == system.tau.shape == (3, arms * joints)
    for q, qd, pose, twist in zip(system.q, system.qd, system.object_pose, system.object_twist, strict=True):
        for gap in closure(system.chain, State(q, qd, pose, twist)).values():
            assert np.abs(gap.position).max() <= CLOSED
            assert np.abs(gap.velocity).max() <= CLOSED


def test_states_differ():
    """Nothing is the same in two states; the count is what was asked for, or the default."""
    system = make_system(2, 7)
    assert system.states == 32
    for array in system.arrays:
        assert len(np.unique(array, axis=0)) == 32
    assert make_system(64, 6, seed=1).states == 8


def test_well_conditioned():
    """The longest arms are no trap for anyone: full rank, and pivots of one size."""
    system = make_system(2, 96, 2)
    result = forward_dynamics(
        system.chain, State(system.q[1], system.qd[1], system.object_pose[1], system.object_twist[1]), system.tau[1]
    )
    assert result.rank == 12
    assert result.condition < 1e3


def test_repeated():
    """A batch takes the states in turn."""
    system = make_system(2, 6, 3)
    batch = system.repeated(7)
    assert batch.states == 7
    for few, many in zip(system.arrays, batch.arrays, strict=True):
        assert np.array_equal(many, few[[0, 1, 2, 0, 1, 2, 0]])


def test_reproducible():
    """The same seed gives the same numbers, another seed others."""
    one, same, other = make_system(2, 7, 2), make_system(2, 7, 2), make_system(2, 7, 2, seed=1)
    assert np.array_equal(one.q, same.q)
    assert not np.array_equal(one.q, other.q)
