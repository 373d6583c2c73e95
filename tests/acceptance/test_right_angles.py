"""10,000 chains at right angles, random in everything else: every method and every question, against 50 digits."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import holdfast
from holdfast import Inputs, State
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.methods import METHODS
from tests.acceptance.comparison import relative
from tests.compiled.problems import answer
from tests.compiler.conftest import no_cache  # noqa: F401
from tests.dynamics.test_half_turn import excess
from tests.systems.as_chain import Problem
from tests.systems.right_angle_systems import right_angle_system

CHUNKS, EACH = 20, 500
COMPILED_EVERY = 20  # every compiled chain is another code: half a second


@pytest.mark.long
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_right_angles(chunk, no_cache):  # noqa: F811
    """All answers within 1e-9 or the rounding of Lambda (other methods: 1e-7), or refused by name; counts printed."""
    seen: Counter[str] = Counter()
    worst: dict[str, float] = {}

    def note(what: str, error: float) -> None:
        seen[what] += 1
        worst[what] = max(worst.get(what, 0.0), error)

    for seed in range(chunk * EACH, (chunk + 1) * EACH):
        p = right_angle_system(seed)
        try:
            found = holdfast.forward_dynamics(p.chain, p.state, p.tau)
        except holdfast.SingularChainError:
            seen["singular"] += 1
            continue
        seen[found.status.name] += 1
        error = excess(p, give=0.0) * 1e-9
        note("sequential" if error <= 1e-9 else "sequential, rounding of Lambda", error)
        assert error <= 1e-9 or excess(p) <= 1.0, seed
        for name, error in _other_methods(p, found):
            assert error <= 1e-7, (seed, name)
            note(name, error)
        if seed % COMPILED_EVERY == 0:
            note("machine code", _compiled(p, found))
        for name, error in (("split", _split(p, found)), ("held", _held(p)), ("projected", _projected(p))):
            assert error <= 1e-8, (seed, name)
            note(name, error)
    print(f"\nchunk {chunk}: {dict(seen)}\n  worst: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()), end="")
    assert worst["machine code"] <= 1e-9


def _other_methods(p: Problem, found: holdfast.dynamics.ForwardResult) -> list[tuple[str, float]]:
    """Return the differences of the other methods that answer; forces only where they are unique."""
    errors = []
    for name in METHODS:
        if name == "sequential":
            continue
        try:
            other = holdfast.forward_dynamics(p.chain, p.state, p.tau, method=name)
        except holdfast.MethodNotApplicable:
            continue
        errors.append((name, relative(other.qdd, found.qdd, floor=1.0)))
    return errors


def _compiled(p: Problem, found: holdfast.dynamics.ForwardResult) -> float:
    """Return what machine code differs by; status and rank must agree."""
    fast = answer(p)
    assert (fast.rank, fast.status) == (found.rank, found.status)
    return relative(fast.qdd, found.qdd, floor=1.0)


def _split(p: Problem, found: holdfast.dynamics.ForwardResult) -> float:
    """Return how much of the internal part could be taken from the motion part, which is the smallest."""
    parts = holdfast.forces.split(p.chain, p.state, found.grasp_wrench)
    metric = np.r_[np.full(3, 1 / parts.length), np.ones(3)]
    motion, internal = parts.motion * metric, parts.internal * metric
    size = max(1.0, float(np.abs([motion, internal]).max()))  # contacts 3 mm apart: both are thousands of newtons
    return abs(float((motion * internal).sum())) / size**2  # the smallest is orthogonal to all that move nothing


def _held(p: Problem) -> float:
    """Return the accelerations left under holding torques, 0 where no torques hold."""
    still = State(p.state.q, np.zeros(p.chain.joint_count), p.state.object_pose)
    try:
        tau = holdfast.holding_torques(p.chain, still)
        found = holdfast.forward_dynamics(p.chain, still, tau)
    except (holdfast.StateError, holdfast.SingularChainError):
        return 0.0
    return float(np.abs(found.qdd).max()) / max(1.0, float(np.abs(tau).max()))


def _projected(p: Problem) -> float:
    """Return what projected velocities still mismatch, and by how much they are not the nearest."""
    random = np.random.default_rng(3)
    wild = State(p.state.q, random.normal(size=p.chain.joint_count), p.state.object_pose, random.normal(size=6))
    near = holdfast.dynamics.project_velocity(p.chain, wild)
    motion = chain_motion(p.chain, near, np.zeros(p.chain.joint_count), Inputs().shaped(p.chain))
    rows = constraint_rows(motion)
    gap = rows.joints @ near.qd + rows.object @ near.object_twist
    again = holdfast.dynamics.project_velocity(p.chain, near)
    return float(max(np.abs(gap).max(), np.abs(again.qd - near.qd).max()))
