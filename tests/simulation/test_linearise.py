"""A time step made linear: the tangent is carried to the tangent, and runs nearby go where it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import holdfast as hf
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.varied_step import state_arrays
from holdfast.spatial import rotation
from tests.longer import mostly_long
from tests.simulation.rollout.test_tape import five_points
from tests.systems import random_system
from tests.systems.as_chain import as_chain
from tests.systems.sprung import with_springs
from tests.systems.trunk_runs import swaying

STEP = 1e-2
GRASPS = ("rigid hinge", "softfinger rigid", "ball rigid")


def held(kinds, *, springs=False):
    """Return a chain that moves, on bases that stand."""
    p = as_chain(random_system(5, arms=2, joints=[5, 5], grasps=kinds.split(), moving_base=False))
    return replace(p, chain=with_springs(p.chain)) if springs else p


def changed(state: hf.State, x: np.ndarray) -> hf.State:
    """Return the state moved by a row of a basis."""
    n = len(state.q)
    pose = hf.Pose(rotation.exp(x[n : n + 3]) @ state.object_frame.R, state.object_frame.p + x[n + 3 : n + 6])
    return hf.State(state.q + x[:n], state.qd + x[n + 6 : 2 * n + 6], pose, state.object_twist + x[2 * n + 6 :])


def difference(a: hf.State, b: hf.State) -> np.ndarray:
    """Return the small change that leads from b to a."""
    turn = rotation.log(a.object_frame.R @ b.object_frame.R.T)
    shift = a.object_frame.p - b.object_frame.p
    return np.concatenate([a.q - b.q, turn, shift, a.qd - b.qd, a.object_twist - b.object_twist])


@pytest.mark.slow
@pytest.mark.parametrize("springs", [False, True])
@pytest.mark.parametrize("kinds", mostly_long(GRASPS, (GRASPS[0],)))
def test_runs_nearby(kinds, springs):
    """z' = A z but for the square of z; each step goes on with the basis that the one before ended with."""
    p = held(kinds, springs=springs)
    first = hf.linearise(p.chain, p.state, p.tau, inputs=p.inputs, step=STEP)
    second = hf.linearise(p.chain, first.end, p.tau, inputs=p.inputs, basis=first.end_basis, step=STEP)
    assert np.abs(second.basis - first.end_basis).max() < 1e-12
    here, basis, A = second.end, second.end_basis, second.A @ first.A
    z, off = np.random.default_rng(0).normal(size=A.shape[1]), []
    for size in (1e-3, 5e-4):
        begin = hf.project(p.chain, changed(p.state, size * first.basis @ z))[0]
        run = hf.simulate(p.chain, begin, lambda t, state, memory: (p.tau, memory), 2 * STEP, STEP, inputs=p.inputs)
        before = np.linalg.lstsq(first.basis, difference(begin, p.state), rcond=None)[0]
        off.append(np.linalg.norm(np.linalg.pinv(basis) @ difference(run.state(-1), here) - A @ before))
    print(f"\n{off[0]:.1e} {off[1]:.1e}")
    assert off[1] < 0.27 * off[0]


@pytest.mark.long
def test_limit():
    """A short step is the exponential of the dynamics; B its integral. Bases are close, not the same."""
    p = held(GRASPS[0])
    n, h = p.chain.joint_count, 1e-5
    still = replace(p.state, qd=np.zeros(n), object_twist=np.zeros(6))
    tau = hf.holding_torques(p.chain, still)
    whole = hf.linearise(p.chain, still, tau)
    model = hf.linearise(p.chain, still, tau, step=h)
    assert np.abs(model.A - expm(h * whole.A)).max() < 1e-6
    assert np.abs(model.B / h - whole.B).max() < 1e-3 * np.abs(whole.B).max()
    assert np.abs(difference(model.end, still)).max() < 1e-12
    assert set(state_arrays(p.chain, model.end)) == {"q", "qd", "object_pose", "object_twist"}


@pytest.mark.slow
@pytest.mark.parametrize("springs", [False, True])
def test_torques(springs):
    """B by five-point differences of the step that `simulate` takes."""
    p, random = held(GRASPS[0], springs=springs), np.random.default_rng(1)
    d = random.normal(size=p.chain.joint_count)
    model = hf.linearise(p.chain, p.state, p.tau, inputs=p.inputs, step=STEP)

    def end(far):
        run = hf.simulate(p.chain, p.state, lambda *_: (p.tau + far * d, None), STEP, STEP, inputs=p.inputs)
        return difference(run.state(-1), model.end)

    slope = five_points(end, 0.1)
    assert np.abs(model.end_basis @ model.B @ d - slope).max() < 1e-9 * np.abs(slope).max()


@pytest.mark.slow
@pytest.mark.parametrize("sprung", [False, True])
def test_moving_bases(sprung):
    """A and B of a step on a base that moves, by five-point differences of what `simulate` does; time enters."""
    p, t, random = held(GRASPS[0], springs=sprung), 0.2, np.random.default_rng(3)
    name = p.chain.names[0]
    base, start = p.chain.arms[name].base, swaying(hf.Pose.identity())(t)[0]
    R = start.R.T @ base.R
    moves = {name: swaying(hf.Pose(R, base.p - start.p))}
    here, inputs = Environment(p.chain, moves, p.inputs).at(t, p.state)
    state = hf.project(here, p.state, inputs.shaped(p.chain))[0]
    model = hf.linearise(p.chain, state, p.tau, inputs=p.inputs, step=STEP, base_motion=moves, t=t)
    later = {name: lambda s: moves[name](t + s)}

    def end(far, z, d):
        begin = hf.project(here, changed(state, far * model.basis @ z), inputs.shaped(p.chain))[0]
        tau = p.tau + 1e3 * far * d
        run = hf.simulate(here, begin, lambda *_: (tau, None), STEP, STEP, inputs=p.inputs, base_motion=later)
        return difference(run.state(-1), model.end)

    z, d = random.normal(size=model.A.shape[1]), random.normal(size=p.chain.joint_count)
    assert np.abs(end(0.0, z, d)).max() < 1e-12
    for x, du in ((z, 0.0 * d), (0.0 * z, d)):
        slope = five_points(lambda far, x=x, du=du: end(far, x, du), 1e-3)
        expected = model.end_basis @ (model.A @ x + model.B @ (1e3 * du))
        assert np.abs(expected - slope).max() < 1e-8 * np.abs(slope).max()


def test_refusals():
    """Steps that cannot be made linear say why."""
    p, step = held(GRASPS[0]), {"step": STEP}
    for options, error, message in (
        (step | {"scheme": "euler"}, hf.errors.ModelError, "scheme"),
        ({"step": -1.0}, hf.HoldfastError, "step"),
        ({"base_motion": {"arm0": lambda t: None}}, hf.errors.StateError, "base_motion: expected a step"),
        (step | {"inputs": hf.Inputs(base_twists=np.ones((2, 6))), "check": False}, hf.errors.StateError,
         r"base_twists: expected none.*try base_motion"),
        (step | {"inputs": p.inputs, "basis": np.eye(3)}, hf.errors.StateError, "basis"),
    ):  # fmt: skip
        with pytest.raises(error, match=message):
            hf.linearise(p.chain, p.state, p.tau, **options)


@pytest.mark.slow
def test_coordinates_of_a_step():
    """They are those of the dynamics at the same state: components along the basis, to the square of their size."""
    p = held(GRASPS[0])
    model = hf.linearise(p.chain, p.state, p.tau, inputs=p.inputs, step=STEP)
    z = np.random.default_rng(2).normal(size=model.A.shape[1])
    for size in (1e-4, 1e-5):
        near = changed(model.state, size * model.basis @ z)
        assert np.abs(model.coordinates(near) - size * z).max() < 10.0 * size**2
    continuous = hf.linearise(p.chain, p.state, p.tau, inputs=p.inputs, basis=model.basis)
    assert np.abs(model.coordinates(near) - continuous.coordinates(near)).max() < 1e-12
    assert np.abs(model.coordinates(model.state)).max() < 1e-14


@pytest.mark.slow
def test_coordinates_of_another_state():
    """A state of other joints, or none, is refused."""
    p, other = held(GRASPS[0]), as_chain(random_system(2, arms=1, joints=[4], grasps=["rigid"], moving_base=False))
    for step in (None, STEP):
        model = hf.linearise(p.chain, p.state, p.tau, inputs=p.inputs, step=step)
        with pytest.raises(
            hf.errors.StateError, match="coordinates: state: expected 10 joints and no floating base, got 4"
        ):
            model.coordinates(other.state)
        with pytest.raises(hf.errors.StateError, match="coordinates: state: expected State, got ndarray"):
            model.coordinates(p.state.q)  # pyright: ignore[reportArgumentType]
