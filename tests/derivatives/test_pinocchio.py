"""Pinocchio, an independent library, has the same derivatives along the state manifold, where grasps are rigid."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.robots import HOME, panda
from tests.derivatives.blocks import by_jacobian, compiled
from tests.derivatives.moved import closed_rows, tangent
from tests.derivatives.stored import names, stored
from tests.longer import mostly_long
from tests.oracles.chain_derivatives import chain_derivatives
from tests.systems.as_chain import Problem
from tests.systems.problems import relative_gap

pin = pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")

from holdfast import Inputs  # noqa: E402  (after what is needed)
from tests.oracles.pinocchio_model import RigidChain  # noqa: E402
from tests.oracles.test_pinocchio import GRAVITIES, carried  # noqa: E402

TOLERANCE = 1e-10
OF = ("qdd", "object_acceleration", "grasp_wrench")
STATES = 10


def two_pandas(seed: int) -> Problem:
    """Return two Pandas that hold a box, in motion."""
    random = np.random.default_rng(3000 + seed)
    arms = {name: panda(armature=random.uniform(0, 0.6, size=7)) for name in ("left", "right")}
    q = np.concatenate([HOME["panda"] + random.uniform(-0.7, 0.7, size=7) for _ in arms])
    chain, state = carried(random, arms, q, GRAVITIES[seed % 3])
    return Problem(chain, state, 20.0 * random.normal(size=14), Inputs())


def directions(p: Problem) -> np.ndarray:
    """Return the tangent of the state manifold, and torques, (3n + 12, m)."""
    T, n = tangent(p), p.chain.joint_count
    return np.block([[T, np.zeros((len(T), n))], [np.zeros((n, T.shape[1])), np.eye(n)]])


def peer(p: Problem, along: np.ndarray) -> dict[str, np.ndarray]:
    """Return Pinocchio's derivatives along directions."""
    return dict(zip(OF, RigidChain(p.chain).derivatives(p.state, p.tau, along), strict=True))


@pytest.mark.parametrize("name", [name for name in names() if name.startswith("rigid") and "moving" not in name])
def test_tangent(name):
    """The stored tangents keep what is closed, and are all that does."""
    case = stored(name)
    rows = closed_rows(case.problem)
    assert np.abs(rows @ case.tangent).max() < 1e-13 * np.abs(rows).max() * np.abs(case.tangent).max()
    assert tangent(case.problem).shape == case.tangent.shape


@pytest.mark.parametrize("seed", mostly_long(range(STATES), (0,)))
def test_the_oracle(seed):
    """Dual numbers over the dense equations: the oracle, from another side."""
    p = two_pandas(seed)
    along = directions(p)
    by = ("q", "object_pose", "qd", "object_twist", "tau")
    found, expected = chain_derivatives(p, by), peer(p, along)
    off = {of: relative_gap(found.matrices[of] @ along, expected[of]) for of in OF}
    print("\n" + ", ".join(f"{of} {x:.1e}" for of, x in off.items()))
    assert max(off.values()) < TOLERANCE, off


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long(range(STATES), (3,)))
def test_machine_code(seed):
    """The compiled Jacobian times the tangent."""
    p = two_pandas(seed)
    along = directions(p)
    by = ("q", "object_pose", "qd", "object_twist", "tau")
    blocks, expected = by_jacobian(compiled(p), p, OF, by), peer(p, along)
    found = {of: np.concatenate([blocks[of, name] for name in by], axis=1) @ along for of in OF}
    off = {of: relative_gap(found[of], expected[of]) for of in OF}
    print("\n" + ", ".join(f"{of} {x:.1e}" for of, x in off.items()))
    assert max(off.values()) < TOLERANCE, off
