"""Derivatives of forward dynamics with bushings, whose wrenches follow from the state: against differences of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.spatial import rotation
from tests.compiled.problems import given_by
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


@pytest.mark.parametrize("trunk", [False, True])
def test_against_differences(trunk):
    """Of five points; and <w, J d> = <J^T w, d> for cotangents w."""
    p, rng, h = held_by_rubber(trunk), np.random.default_rng(0), 1e-3
    options = {"inputs": p.inputs, "check": False}
    for by in BY:
        d = rng.normal(size=np.shape(getattr(p.state, by)) if by != "object_pose" else 6)
        at = {k: hf.forward_dynamics(p.chain, moved(p.state, by, k * h * d), p.tau, **options) for k in (-2, -1, 1, 2)}
        pushed = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, along={by: d}, **options)
        cotangents = {of: rng.normal(size=np.shape(pushed[of])) for of in OUTPUTS}
        for of in OUTPUTS:
            inner, outer = (getattr(at[k], of) - getattr(at[-k], of) for k in (1, 2))
            assert relative_gap(pushed[of], (8.0 * inner - outer) / (12.0 * h)) < 1e-8, (by, of)
        pulled = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, by=(by,), **cotangents, **options)
        one_way, other_way = pulled[by] @ d, sum(np.sum(cotangents[of] * pushed[of]) for of in OUTPUTS)
        assert one_way == pytest.approx(other_way, rel=1e-11)


@pytest.mark.slow
def test_machine_code():
    """Products and the matrix are the reference's."""
    p, rng, of = held_by_rubber(False), np.random.default_rng(1), ("qdd", "grasp_wrench")
    s, given = p.state, given_by(p)
    fast, options = hf.compile(p.chain, parameters=("link_wrench",)), {"inputs": p.inputs, "check": False}
    cotangents = {"qdd": rng.normal(size=13), "grasp_wrench": rng.normal(size=(2, 6))}
    along = {"q": rng.normal(size=13), "object_pose": rng.normal(size=6)}
    pulled = fast.forward_dynamics_vjp(**given, **cotangents, by=BY)
    expected = hf.forward_dynamics_vjp(p.chain, s, p.tau, by=BY, **cotangents, **options)
    assert max(relative_gap(pulled[name], expected[name]) for name in BY) < 1e-11
    pushed = fast.forward_dynamics_jvp(**given, along=along, of=of)
    expected = hf.forward_dynamics_jvp(p.chain, s, p.tau, along=along, **options)
    assert max(relative_gap(pushed[name], expected[name]) for name in of) < 1e-11
    matrix = fast.forward_dynamics_jacobian(**given, of=of, by=("q", "object_pose"))
    summed = {o: matrix[o, "q"] @ along["q"] + matrix[o, "object_pose"] @ along["object_pose"] for o in of}
    assert max(relative_gap(summed[name], pushed[name]) for name in of) < 1e-11
