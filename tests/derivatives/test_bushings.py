"""Derivatives of forward dynamics with bushings, whose wrenches follow from the state: against differences of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.spatial import rotation
from tests.oracles.chain_derivatives import OUTPUTS
from tests.systems.as_chain import Problem
from tests.systems.bushed import bushed
from tests.systems.problems import random_problem, relative_gap
from tests.systems.trunk_runs import still_base

BY = ("q", "qd", "object_pose", "object_twist")
ARMS = {"joints": (7, 6), "grasps": ("rigid", "rigid")}


def held_by_rubber(trunk: bool) -> Problem:
    """Return two arms, the second of which holds by a bushing, on their own bases or on a trunk."""
    p = still_base(2, 2, floating=False, arms=ARMS) if trunk else random_problem(4, **ARMS)
    return bushed(p, ("arm2",))


def moved(state: hf.State, by: str, change: np.ndarray) -> hf.State:
    """Return a state with one of its parts changed; a pose by [turn; shift]."""
    if by != "object_pose":
        return replace(state, **{by: getattr(state, by) + change})
    frame = state.object_frame
    return replace(state, object_pose=hf.Pose(rotation.exp(change[:3]) @ frame.R, frame.p + change[3:]))


def assert_derivatives_are_differences(p: Problem, tolerance: float = 1e-8) -> None:
    """Compare rates with differences of five points; and <w, J d> = <J^T w, d> for cotangents w."""
    rng, h, options = np.random.default_rng(0), 1e-3, {"inputs": p.inputs, "check": False}
    for by in BY:
        d = rng.normal(size=np.shape(getattr(p.state, by)) if by != "object_pose" else 6)
        at = {k: hf.forward_dynamics(p.chain, moved(p.state, by, k * h * d), p.tau, **options) for k in (-2, -1, 1, 2)}
        pushed = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, along={by: d}, **options)
        cotangents = {of: rng.normal(size=np.shape(pushed[of])) for of in OUTPUTS}
        for of in OUTPUTS:
            inner, outer = (getattr(at[k], of) - getattr(at[-k], of) for k in (1, 2))
            assert relative_gap(pushed[of], (8.0 * inner - outer) / (12.0 * h)) < tolerance, (by, of)
        pulled = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, by=(by,), **cotangents, **options)
        one_way, other_way = pulled[by] @ d, sum(np.sum(cotangents[of] * pushed[of]) for of in OUTPUTS)
        assert one_way == pytest.approx(other_way, rel=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("trunk", [False, True])
def test_against_differences(trunk):
    """The wrench of a bushing varies with everything that moves its ends."""
    assert_derivatives_are_differences(held_by_rubber(trunk))
