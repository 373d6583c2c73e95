"""Linearisation of chains with branches: differences of motions, and numbers of serial chains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.tree.mechanism_terms import chain_state, flat_rates, flat_state
from holdfast.dynamics.tree.varied_forest import displaced
from holdfast.errors import MethodNotApplicable, StateError
from tests.dynamics.tree.as_branched import gap, serial_problems, with_stray
from tests.longer import mostly_slow
from tests.systems.branched import branched_problems

SMALL = ("palletiser", "on a shoulder")


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), SMALL))
def test_differences_of_motions(name):
    """Along independent coordinates, against differences of accelerations of states that are closed."""
    chain, state, tau = branched_problems()[name]
    found, forest, h = hf.linearise(chain, state, tau), chain.as_forest.forest, 1e-5
    (q, qd), n, m = flat_state(chain, state), forest.velocity_count, len(found.A)
    inverse = np.linalg.pinv(found.basis)

    def rates(z):
        x = found.basis @ z
        there = hf.close(chain, chain_state(chain, displaced(forest, q, x[:n]), qd + x[n:]))
        result = hf.forward_dynamics(chain, there, tau)
        accelerations = flat_rates(result.qdd, result.object_acceleration, result.base_acceleration)
        return there, np.append(flat_state(chain, there)[1], accelerations)

    _, here = rates(np.zeros(m))
    assert gap(found.basis @ found.rate, here) < 1e-9
    for k in range(0, m, 4):
        unit = h * np.eye(m)[k]
        (after, plus), (before, minus) = rates(unit), rates(-unit)
        wanted = (plus - minus) / (2 * h)
        for body, at in zip(forest.bodies, forest.velocities, strict=True):
            if body.joint.of_kind.pose:  # a small turn is carried along by the angular velocity
                turn = slice(at.start, at.start + 3)
                wanted[turn] += np.cross(qd[turn], found.basis[turn, k])
        assert gap(found.A[:, k], inverse @ wanted) < 1e-6, k
        assert gap((found.coordinates(after) - found.coordinates(before)) / 2, unit) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_slow(["an arm that holds nothing", "anchors"], ["anchors"]))
def test_as_serial_chains(name):
    """What torques do to the joints, and later through A, is as in the serial chain, whatever the coordinates."""
    p = serial_problems()[name]
    chain, state, tau, inputs = with_stray(p)
    found = hf.linearise(chain, state, tau, inputs=inputs, check=False)
    wanted = hf.linearise(p.chain, p.state, tau, inputs=p.inputs, check=False)
    n, half = len(tau), len(found.basis) // 2
    there = len(wanted.basis) // 2
    x, y = found.B, wanted.B
    for _ in range(3):
        for row in (0, 1):
            joints, own = found.basis[row * half :][:n], wanted.basis[row * there :][:n]
            assert gap(joints @ x, own @ y) < 1e-8
        x, y = found.A @ x, wanted.A @ y
    assert gap(found.basis[half:][:n] @ found.rate, wanted.basis[there:][:n] @ wanted.rate) < 1e-8


@pytest.mark.slow
def test_passive_joints_and_bases():
    """Torques of passive joints do nothing; a basis is turned towards that of a neighbour; a step is refused."""
    chain, state, tau = branched_problems()["palletiser"]
    found = hf.linearise(chain, state, tau)
    assert not found.B[:, 2:].any() and found.B[:, :2].any(axis=0).all()
    assert found.A.shape == (4, 4)
    there = hf.close(chain, replace(state, q=state.q + 1e-3 * np.array([1.0, 1.0, -1.0, 1.0])))
    near = hf.linearise(chain, there, tau, basis=found.basis)
    assert gap(near.basis, found.basis) < 1e-2
    free = hf.linearise(chain, there, tau)
    assert gap(np.sort_complex(np.linalg.eigvals(near.A)), np.sort_complex(np.linalg.eigvals(free.A))) < 1e-9
    with pytest.raises(MethodNotApplicable, match="step: expected its default"):
        hf.linearise(chain, state, tau, step=1e-3)
    with pytest.raises(StateError, match="basis: expected shape"):
        hf.linearise(chain, state, tau, basis=np.eye(3))
