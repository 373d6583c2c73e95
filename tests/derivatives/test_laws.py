"""Laws of forward dynamics' derivatives: duality, symmetries, scales; machine code and the reference are one."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.dynamics import object_mobility
from tests.derivatives.blocks import (
    NAMES,
    ROUNDING,
    as_direction,
    assert_compiled_is_reference,
    by_jacobian,
    by_jvp,
    by_vjp,
    compiled,
    given,
    names_for,
    random_cotangents,
    random_directions,
    size_of,
)
from tests.derivatives.chains import TRUNKS, random_chain
from tests.derivatives.stored import gaps
from tests.longer import mostly_long, mostly_slow
from tests.oracles.chain_derivatives import OUTPUTS
from tests.systems.problems import relative_gap

DUAL = 1e-13
LAW = 1e-11


@pytest.mark.parametrize("trunk", [*mostly_long((None, "floating"), (None,)), *mostly_slow(("fixed",), ())])
@pytest.mark.parametrize("seed", mostly_long(range(4), (0,)))
def test_duality(seed, trunk):
    """<w, J d> = <J^T w, d> for cotangents w."""
    p, random = random_chain(100 + seed, trunk), np.random.default_rng(seed)
    fast, by = compiled(p), names_for(p)
    cotangents, directions = random_cotangents(p, random), random_directions(p, random, by)
    pulled = fast.forward_dynamics_vjp(**given(p), **cotangents, by=by)
    pushed = fast.forward_dynamics_jvp(**given(p), along=directions)
    one_way = [cotangent * getattr(pushed, of) for of, cotangent in cotangents.items()]
    other_way = [directions[name] * getattr(pulled, name) for name in by]
    size = max(np.abs(x).max(initial=0.0) for x in [*one_way, *other_way])
    off = abs(sum(x.sum() for x in one_way) - sum(x.sum() for x in other_way)) / size
    print(f"\n{off:.1e}")
    assert off < DUAL


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_three_ways_are_one(seed):
    """Rows by cotangents, columns by directions, the matrix: the same entries, and each a sum of the others."""
    p, random = random_chain(100 + seed), np.random.default_rng(seed)
    fast = compiled(p)
    rows, cols, matrix = by_vjp(fast, p), by_jvp(fast, p), by_jacobian(fast, p)
    for by in NAMES:
        wanted = {of: matrix[of, by] for of in OUTPUTS}
        for found in (rows, cols):
            assert max(x for _, x in gaps({of: found[of, by] for of in OUTPUTS}, wanted, ROUNDING)) < LAW, by
    flat = {name: random.normal(size=size_of(p, name)) for name in NAMES}
    along = {name: as_direction(p, name, x) for name, x in flat.items()}
    pushed = fast.forward_dynamics_jvp(**given(p), along=along)
    for of in OUTPUTS:
        total = sum(matrix[of, by] @ flat[by] for by in NAMES)
        assert relative_gap(getattr(pushed, of).ravel(), total) < LAW, of


@pytest.mark.slow
@pytest.mark.parametrize("trunk", mostly_long(TRUNKS, (None,)))
@pytest.mark.parametrize("seed", mostly_long(range(3), (1,)))
def test_symmetries(seed, trunk):
    """d qdd / d tau is symmetric, no eigenvalue below 0; d alpha / d w is the object's mobility; the rest mirrored."""
    p = random_chain(100 + seed, trunk)
    found = by_jacobian(compiled(p), p, by=("tau", "object_wrench"))
    mobility = found["qdd", "tau"]
    assert relative_gap(mobility, mobility.T) < LAW
    assert np.linalg.eigvalsh((mobility + mobility.T) / 2)[0] > -LAW * np.abs(mobility).max()
    assert relative_gap(found["object_acceleration", "object_wrench"], object_mobility(p.chain, p.state)) < LAW
    assert relative_gap(found["object_acceleration", "tau"], found["qdd", "object_wrench"].T) < LAW


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long(range(3), (1,)))
def test_gravity_is_an_acceleration_of_all_bases(seed):
    """Gravity changes all as if the bases accelerated the other way; the object's acceleration by itself more."""
    p = random_chain(100 + seed)
    found = by_jacobian(compiled(p), p, by=("gravity", "base_acceleration"))
    for of in OUTPUTS:
        bases = found[of, "base_acceleration"].reshape(-1, len(p.chain.arms), 6)[:, :, 3:].sum(1)
        own = np.eye(6)[:, 3:] if of == "object_acceleration" else 0.0
        assert relative_gap(found[of, "gravity"], own - bases, 1.0) < LAW, of


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long(range(4), (1,)))
def test_scaling(seed):
    """All inertias, torques, losses and wrenches by one factor leave every acceleration and scale every force."""
    p = random_chain(100 + seed)
    chain = p.chain
    inputs, joints = p.inputs.shaped(chain), [joint for part in chain.joints_of.values() for joint in part]
    links = [link for arm in chain.arms.values() for link in arm.links]
    pushes = np.zeros((len(links), 6)) if inputs.link_wrenches is None else inputs.link_wrenches
    along = {
        "tau": p.tau,
        "object_wrench": inputs.object_wrench,
        "link_wrench": pushes,
        "object_mass": np.array(chain.held_object.mass),
        "object_inertia": chain.held_object.inertia,
        "link_mass": np.array([link.mass for link in links]),
        "link_inertia": np.array([link.inertia for link in links]),
        "armature": np.array([joint.armature for joint in joints]),
        "damping": np.array([joint.damping for joint in joints]),
    }
    pushed = compiled(p).forward_dynamics_jvp(**given(p), along=along)
    found = p.solved(check=False)
    for of in OUTPUTS:
        wanted = getattr(found, of) if of in ("grasp_wrench", "base_wrench") else 0.0 * getattr(found, of)
        size = np.abs(getattr(found, of)).max(initial=1.0)
        assert np.abs(getattr(pushed, of) - wanted).max(initial=0.0) < LAW * size, of


@pytest.mark.slow
@pytest.mark.parametrize("trunk", mostly_long(TRUNKS, (None,)))
@pytest.mark.parametrize("seed", mostly_long(range(2), (1,)))
def test_reference_and_machine_code(seed, trunk):
    """The reference forms trace the same functions: gradients, directions, the matrix, and the result beside."""
    p, by = random_chain(400 + seed, trunk), ("q", "qd", "tau", "object_pose", "object_twist")
    pulled, plain = assert_compiled_is_reference(p, by, by, seed), compiled(p).forward_dynamics(**given(p))
    for of in OUTPUTS:
        assert relative_gap(getattr(pulled.result, of), getattr(plain, of)) < LAW
