"""Runs of the benchmark that take seconds."""

import functools
from unittest import mock

from benchmarks.bench import pinocchio_peer
from benchmarks.bench.clock import Effort
from benchmarks.bench.entries import Answers, Candidate, Entry
from benchmarks.bench.measure import reference
from benchmarks.bench.run import Plan, run
from benchmarks.bench.trunks import TRUNKS

EFFORT = Effort(turn=1e-4, rounds=3)
TINY = Plan(
    "tiny",
    ((2, 7), (3, 6)),
    (1, 5),
    (((3, 6), (2, 7)),),
    ((2, 7),),
    1,
    EFFORT,
    rollout_sizes=(4,),
    trunks=tuple(TRUNKS),
    derivatives=((2, 7),),
    distribution=("soft fingers",),
)


@functools.cache
def tiny_document() -> dict:
    """Return the document of the tiny run."""
    with mock.patch.multiple(pinocchio_peer, TRIAL=0.002, PROBATION=0.02):
        return run(TINY)


def exact_rival(system, name: str = "rival", error: float = 0.0, **options) -> Candidate:
    """Return a made-up peer whose answers are off by a relative error."""
    answers = reference(system)
    wrong = Answers(answers.qdd * (1.0 + error), answers.wrenches)
    entry = Entry(name, "made up", lambda: None, system.states, answers=lambda: wrong)
    return Candidate(name, "made up", lambda truth: entry, **options)
