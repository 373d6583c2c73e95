"""Fastest timings beside one convex programme over all nodes, by Clarabel, for several chains and paths.

python -m benchmarks.timed_paths
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tests.control.joint_timing import least_time, limits_between
from tests.control.test_timed_path import GRIP, Arc, pinned, two_ur5e
from tests.control.three_pandas import three_pandas
from tests.control.two_pandas import rubber_pandas, two_pandas
from tests.control.wave import Wave
from tests.planning.examples import mobile

import holdfast as hf
from holdfast.forces import ForceLimits, distribute

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "timed_path.png"
NODES, FINE = 41, 320
PLACES = (0.12, 0.4, 0.63, 0.9)  # of every interval, at which limits are measured anew
PLAIN = ForceLimits(effort=0.8)


class Case(NamedTuple):
    """A path to be timed."""

    name: str
    chain: hf.ClosedChain
    state: hf.State
    path: Any
    limits: ForceLimits


class Timed(NamedTuple):
    """A timing beside the joint programme.

    Attributes:
        over: time beyond that of the joint programme, relative to it.
        passed: force by which limits are passed between nodes, with forces found anew there [N].
        nodes: number of nodes.
        seconds: processor time.
    """

    over: float
    passed: float
    nodes: int
    seconds: float


def wheeled() -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms on a platform whose drives have limits."""
    chain, state = mobile()
    trunk, most = chain.trunk, ((500.0, 0.5), (500.0, 0.5), (300.0, 1.0))
    assert trunk is not None
    drives = zip(trunk.joints, most, strict=True)
    wheels = [replace(joint, effort_limit=effort, rate_limit=rate) for joint, (effort, rate) in drives]
    return replace(chain, trunk=replace(trunk, joints=wheels)), state


def cases() -> Iterator[Case]:
    """Yield all paths."""
    up, across = [0.0, 0.15, 0.05], [0.0, 0.0, 0.05]
    chain, state = two_ur5e()
    yield Case("soft fingers, arc", chain, state, Arc(state.object_frame), GRIP)
    yield Case("soft fingers, wave", chain, state, Wave(state.object_frame, up, [0.0, 0.02, 0.03], 0.3, 3.0), GRIP)
    chain, state = two_ur5e(rates=False)
    yield Case("no rate limits, arc", chain, state, Arc(state.object_frame), GRIP)
    yield Case("no rate limits, wave", chain, state, Wave(state.object_frame, [0.0, 0.2, 0.05], across), GRIP)
    chain, state = two_pandas()
    yield Case("rigid, wave", chain, state, Wave(state.object_frame, up, across), PLAIN)
    chain, state = rubber_pandas(0.8)
    yield Case("redundant soft fingers, wave", chain, state, Wave(state.object_frame, up, across), GRIP)
    chain, state = three_pandas()
    three = Wave(state.object_frame, [0.0, 0.1, 0.05], [0.03, 0.0, 0.03])
    yield Case("three arms, wave", chain, state, three, replace(PLAIN, most_normal=60.0))
    chain, state = wheeled()
    yield Case("trunk, wave", chain, state, Wave(state.object_frame, [0.2, 0.0, 0.05], [0.0, 0.0, 0.03], 0.1), PLAIN)


def measured(case: Case) -> Timed:
    """Return the timing of a path beside the joint programme."""
    _, chain, state, path, limits = case
    begin = time.process_time()
    timed = hf.time_path(chain, state, path, limits, nodes=NODES)
    seconds = time.process_time() - begin
    least, passed = least_time(limits_between(timed, limits, FINE), 1.0 / FINE), 0.0
    for t, span in zip(timed.t[:-1], np.diff(timed.t), strict=True):
        for at in t + span * np.array(PLACES):
            alpha, near = timed.at(at).acceleration, pinned(timed, at, limits)
            found = distribute(chain, timed.state_at(at), alpha, limits=near, form="effort")
            passed = max(passed, found.violation)
    return Timed(timed.duration / least - 1.0, passed, len(timed.u), seconds)


def main() -> None:
    """Print all of them, or draw one."""
    if "--picture" in sys.argv[1:]:
        drawn = next(case for case in cases() if case.name == "redundant soft fingers, wave")
        timed = hf.time_path(drawn.chain, drawn.state, drawn.path, drawn.limits, nodes=NODES)
        timed.plot(PICTURE)
        print(timed)
        return
    for case in cases():
        one = measured(case)
        print(
            f"{case.name:30} {one.over:8.2%} beyond the joint programme, passed by {one.passed:7.1e} N,"
            f" {one.nodes} nodes, {one.seconds:.1f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
