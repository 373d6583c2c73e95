"""Derivatives of forward dynamics: stored 126-digit answers, an independent oracle, residuals of all joints at once."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.forward_derivatives import numbers_of
from holdfast.dynamics.closed.second_solve import point
from holdfast.dynamics.closed.self_response import joint_residuals
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.virtual_power import ArmUnknowns
from tests.compiled import problems
from tests.compiled.problems import chain_named, forces, numbers, one
from tests.derivatives.blocks import (
    NAMES,
    ROUNDING,
    WAYS,
    Reference,
    as_direction,
    by_jacobian,
    compiled,
    flat_direction,
    flat_gradient,
    given,
    names_for,
    random_cotangents,
    random_directions,
    shapes,
    size_of,
    state_of,
    worst_gap,
    worst_of_products,
)
from tests.derivatives.chains import TRUNKS, random_chain
from tests.derivatives.stored import OF, Stored, columns, gaps, names, stored
from tests.longer import mostly_long, mostly_slow
from tests.oracles.chain_derivatives import OUTPUTS, chain_derivatives
from tests.systems import random_system
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import relative_gap

TOLERANCE, SHARP, SOUND = 1e-9, 1e-11, 1e4  # of every block; where the condition is below SOUND
RANDOM = 1e-10
UNIQUE = [name for name in names() if stored(name).unique]
NOT_UNIQUE = [name for name in names() if name not in UNIQUE]
SOME = ("rigid_2arm_light_object", "hinge_1arm_moving_base", "mixed_rigid_ball")
SLOW = [("rigid_2arm_light_object", "vjp"), ("mixed_rigid_ball", "jacobian")]
LONG = [of for of in itertools.product(SOME, WAYS) if of not in (("hinge_1arm_moving_base", "jvp"), *SLOW)]
FEW = ("q", "qd", "object_pose", "grasp_pose", "object_mass")
SCALES = (1e-7, 1e-5, 1e-2, 1e2, 1e3)
MANY_TYPES = ("two", "interleaved", "rows first", "factors only", "all kinds", "nobody holds")
ALONG = ("q", "object_pose", "qd", "object_twist")  # the rows of a tangent of the state manifold


def bound_of(p: Problem) -> float:
    """Return how far a block may be off its largest entry."""
    return SHARP if p.solved().condition < SOUND else TOLERANCE


@pytest.mark.parametrize("name", mostly_slow(UNIQUE, [*UNIQUE][::4]))
def test_stored_answers_by_the_reference(name):
    """A gradient and rates of change of everything, against products with the stored matrices."""
    case, random = stored(name), np.random.default_rng(0)
    p, reference, bound = case.problem, Reference(case.problem), bound_of(case.problem)
    lists = {group: columns(p.chain, group) for group in case.groups}
    by = tuple(dict.fromkeys(by for by, _ in lists.values()))
    cotangents = {of: x for of, x in random_cotangents(p, random).items() if of in OF}
    pulled = reference.forward_dynamics_vjp(**given(p), **cotangents, by=by)
    for group, (name_of, which) in lists.items():
        parts = [np.ravel(cotangents[of]) @ case.blocks[of, group] for of in OF]
        size = max(np.abs(x).max(initial=0.0) for x in parts)
        off = flat_gradient(p, name_of, getattr(pulled, name_of))[which] - sum(parts)
        assert np.abs(off).max(initial=0.0) < bound * (size or 1.0), group
    flat = {name: np.zeros(size_of(p, name)) for name in by}
    wanted = dict.fromkeys(OF, 0.0)
    for group, (name_of, which) in lists.items():
        flat[name_of][which] = random.normal(size=len(which))
        wanted = {of: x + case.blocks[of, group] @ flat[name_of][which] for of, x in wanted.items()}
    along = {name: as_direction(p, name, x) for name, x in flat.items()}
    pushed = reference.forward_dynamics_jvp(**given(p), along=along)
    found = {of: np.ravel(getattr(pushed, of))[:, None] for of in OF}
    off = dict(gaps(found, {of: x[:, None] for of, x in wanted.items()}))
    assert max(off.values()) < 10 * bound, off


@pytest.mark.parametrize(
    ("name", "way"), [("hinge_1arm_moving_base", "jvp"), *mostly_slow(SLOW, ()), *mostly_long(LONG, ())]
)
def test_stored_answers(name, way):
    """Blocks of the stored matrices by machine code: by rows, by columns and as a matrix."""
    require_stored(stored(name), way, FEW)


@pytest.mark.long
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", UNIQUE)
def test_every_stored_answer(name, way):
    """Every block of all of them."""
    require_stored(stored(name), way)


def require_stored(case: Stored, way: str, some: tuple[str, ...] | None = None) -> None:
    """Compare machine code with a stored case.

    Args:
        case: the case.
        way: how the matrix is found.
        some: the arguments; None for all.
    """
    p, fast, bound = case.problem, compiled(case.problem), bound_of(case.problem)
    lists = {group: columns(p.chain, group) for group in case.groups}
    lists = {group: (by, which) for group, (by, which) in lists.items() if some is None or by in some}
    found = WAYS[way](fast, p, OF, dict.fromkeys(by for by, _ in lists.values()))
    worst = 0.0
    for group, (by, which) in lists.items():
        off = dict(gaps({of: found[of, by][:, which] for of in OF}, {of: case.blocks[of, group] for of in OF}))
        assert max(off.values()) < bound, (group, off)
        worst = max(worst, *off.values())
    print(f"\n{way}: {worst:.1e}")


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(names(), (SOME[-1], *NOT_UNIQUE)))
def test_reference_along_the_manifold(name):
    """The reference along the state manifold's tangent; of the least forces where these are not unique."""
    case = stored(name)
    p, n = case.problem, case.problem.chain.joint_count
    parts = dict(zip(ALONG, np.split(case.tangent.T, [n, n + 6, 2 * n + 6], axis=1), strict=True))
    pushed = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, inputs=p.inputs, along=parts)
    found = {of: np.reshape(getattr(pushed, of), (len(case.tangent.T), -1)).T for of in OF}
    off = dict(gaps(found, case.along))
    print(f"\n{name}: {max(off.values()):.1e}")
    assert max(off.values()) < SHARP, off
    cotangents = {of: np.random.default_rng(0).normal(size=shapes(p)[of]) for of in OF}
    pulled = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, inputs=p.inputs, **cotangents, by=ALONG)
    gradient = np.concatenate([flat_gradient(p, by, getattr(pulled, by)) for by in ALONG]) @ case.tangent
    wanted = sum(np.ravel(cotangents[of]) @ case.along[of] for of in OF)
    assert relative_gap(gradient, wanted) < SHARP


@pytest.mark.slow
@pytest.mark.parametrize("name", NOT_UNIQUE)
def test_what_is_unique_beside_forces_that_are_not(name):
    """Machine code has accelerations' gradients along the manifold, and refuses a cotangent of the forces."""
    case = stored(name)
    p, fast = case.problem, compiled(case.problem)
    cotangents = {of: np.random.default_rng(0).normal(size=shapes(p)[of]) for of in OF if of != "grasp_wrench"}
    pulled = fast.forward_dynamics_vjp(**given(p), **cotangents, by=ALONG)
    gradient = np.concatenate([flat_gradient(p, by, getattr(pulled, by)) for by in ALONG]) @ case.tangent
    wanted = sum(np.ravel(cotangents[of]) @ case.along[of] for of in cotangents)
    assert relative_gap(gradient, wanted) < SHARP
    with pytest.raises(hf.HoldfastError, match="grasp_wrench"):
        fast.forward_dynamics_vjp(**given(p), grasp_wrench=np.ones(shapes(p)["grasp_wrench"]), by=("q",))


@pytest.mark.parametrize("seed", mostly_slow(range(6), (0, 2, 3, 4, 5)))
def test_random_chains_by_the_reference(seed):
    """Any grasps, driven bases, drives, wrenches on links and object, free arms: products, against the oracle."""
    p = random_chain(100 + seed)
    worst = worst_of_products(Reference(p), p, chain_derivatives(p, NAMES), np.random.default_rng(seed))
    print(f"\n{', '.join(grasp.kind for grasp in p.chain.grasps.values())}: {worst:.1e}")
    assert worst < RANDOM


@pytest.mark.slow
@pytest.mark.parametrize("trunk", [trunk for trunk in TRUNKS if trunk])
@pytest.mark.parametrize("seed", mostly_long(range(200, 208), (201,)))
def test_trunks_by_the_reference(seed, trunk):
    """On a torso or a floating base, some arms beside it in the world: products, those of the base's results too."""
    p, random = random_chain(seed, trunk), np.random.default_rng(seed)
    by = names_for(p)
    expected = chain_derivatives(p, by)
    assert worst_of_products(Reference(p), p, expected, random, by) < RANDOM
    of = "floating_acceleration" if trunk == "floating" else "trunk_base_wrench"
    options = {"inputs": p.inputs, "check": False}
    cotangent, along = random.normal(size=6), random_directions(p, random, by)
    pulled = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, by=by, **options, **{of: cotangent})
    for name in by:
        wanted = cotangent @ expected.block(of, name)
        size = np.abs(wanted).max(initial=0.0)
        assert np.abs(flat_gradient(p, name, pulled[name]) - wanted).max(initial=0.0) <= RANDOM * (size or 1.0), name
    pushed = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, along=along, **options)
    wanted = sum(expected.block(of, name) @ flat_direction(p, name, along[name]) for name in by)
    assert relative_gap(pushed[of], wanted) < RANDOM


def test_the_matrix_of_a_trunk_by_the_reference():
    """Column by column the rates of change."""
    p = random_chain(202, "floating")
    by, of = ("q", "floating_pose", "floating_twist", "base_pose"), ("qdd", "floating_acceleration", "base_wrench")
    expected = chain_derivatives(p, by)
    found = hf.forward_dynamics_jacobian(p.chain, p.state, p.tau, of=of, by=by, inputs=p.inputs, check=False)
    for o in of:
        for b in by:
            matrix = found[o, b].reshape(-1, size_of(p, b))
            assert relative_gap(matrix, expected.block(o, b)) < RANDOM, (o, b)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "any_kind"), mostly_long([(100, True), (103, True), (301, False)], [(100, True), (301, False)])
)
def test_random_chains(seed, any_kind):
    """The same by machine code: a base that moves, a free arm, grasps that roll."""
    p = random_chain(seed, any_kind=any_kind)
    worst = worst_of_products(compiled(p), p, chain_derivatives(p, NAMES), np.random.default_rng(seed))
    print(f"\n{', '.join(grasp.kind for grasp in p.chain.grasps.values())}: {worst:.1e}")
    assert worst < RANDOM


@pytest.mark.long
@pytest.mark.parametrize("seed", range(14))
def test_random_chains_whole(seed):
    """The same, all directions as a matrix."""
    p = random_chain(100 + seed)
    worst = worst_gap(by_jacobian(compiled(p), p), chain_derivatives(p, NAMES), NAMES)
    print(f"\n{', '.join(grasp.kind for grasp in p.chain.grasps.values())}: {worst:.1e}")


@pytest.mark.long
@pytest.mark.parametrize("trunk", [trunk for trunk in TRUNKS if trunk])
@pytest.mark.parametrize("seed", range(8))
def test_random_chains_on_trunks(seed, trunk):
    """The same on a torso or a floating base, some arms beside it in the world."""
    p = random_chain(200 + seed, trunk)
    by = names_for(p)
    worst = worst_gap(by_jacobian(compiled(p), p, by=by), chain_derivatives(p, by), by)
    print(f"\n{trunk}, {', '.join(grasp.kind for grasp in p.chain.grasps.values())}: {worst:.1e}")


@pytest.mark.parametrize("scale", mostly_long(SCALES, (1e-7, 1e3)))
def test_light_and_heavy_objects_by_the_reference(scale):
    """Objects of 1e-7 to 1e3 of the usual mass lose nothing; against the oracle in forty digits."""
    p = random_chain(301, any_kind=False, object_scale=scale)
    worst = worst_of_products(Reference(p), p, chain_derivatives(p, FEW, 40), np.random.default_rng(0), FEW)
    print(f"\n{scale:.0e}: {worst:.1e}")
    assert worst < RANDOM


@pytest.mark.long
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("seed", range(2))
def test_light_and_heavy_objects(seed, scale):
    """Objects of 1e-7 to 1e3 of the usual mass lose nothing; against the oracle in forty digits."""
    p = random_chain(300 + seed, any_kind=False, object_scale=scale)
    expected = chain_derivatives(p, NAMES, 40)
    for way in ("vjp", "jvp"):
        found = WAYS[way](compiled(p), p)
        print(f"\n{scale:.0e}, {way}: {worst_gap(found, expected, NAMES):.1e}")


def many_types(name: str) -> Problem:
    """Return one of the chains of `tests.compiled.problems`, its grasps open."""
    chain = chain_named(name)
    system = one(numbers(chain, 1, 5) | forces(chain, 1, 5), 0)
    acting = (system[key] for key in ("object_wrench", "link_wrench", "base_twist", "base_acceleration"))
    return Problem(chain, state_of(system), system["tau"], hf.Inputs(*acting))


@pytest.mark.parametrize("name", MANY_TYPES)
def test_arms_of_many_types_by_the_reference(name):
    """Arms of two types side by side, an arm without a grasp, states off the constraint: against the oracle."""
    p = many_types(name)
    assert worst_of_products(Reference(p), p, chain_derivatives(p, FEW), np.random.default_rng(0), FEW) < RANDOM


@pytest.mark.long
@pytest.mark.parametrize("name", MANY_TYPES)
def test_arms_of_many_types(name):
    """Arms of two types side by side, an arm without a grasp, states off the constraint: against the oracle."""
    p = many_types(name)
    expected = chain_derivatives(p, NAMES)
    for way in WAYS:
        print(f"\n{name}, {way}: {worst_gap(WAYS[way](problems.compiled(name), p), expected, NAMES):.1e}")


def resting(where: str, trunk: str | None) -> Problem:
    """Return a random chain at rest, without forces."""
    p = random_chain(500, trunk)
    state = p.state.at_rest()
    if where == "at zero":
        state = replace(state, q=0.0 * state.q)
    return Problem(replace(p.chain, gravity=np.zeros(3)), state, 0.0 * p.tau, hf.Inputs())


@pytest.mark.slow
@pytest.mark.parametrize("where", ["at rest", "at zero"])
def test_at_rest_by_the_reference(where):
    """Every rate and force exactly zero; or every joint at exactly zero with them: where square roots vanish."""
    p = resting(where, None)
    assert worst_of_products(Reference(p), p, chain_derivatives(p, NAMES), np.random.default_rng(0)) < RANDOM


@pytest.mark.parametrize("trunk", TRUNKS)
@pytest.mark.parametrize("where", mostly_long(("at rest", "at zero"), ()))
def test_at_rest(where, trunk):
    """Every rate and force exactly zero; or every joint at exactly zero with them."""
    p = resting(where, trunk)
    by = names_for(p)
    found, expected = by_jacobian(compiled(p), p, by=by), chain_derivatives(p, by)
    assert all(np.isfinite(x).all() for x in found.values())
    print(f"\n{where}: {worst_gap(found, expected, by):.1e}")


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_straight_arms(seed):
    """Joints within 1e-6 rad of stretched arms, three arms of seven: the oracle in forty digits, a looser bound."""
    p = straight(seed)
    expected = chain_derivatives(p, NAMES, 40)
    condition = p.solved(check=False).condition
    for way in WAYS:
        found, worst = WAYS[way](compiled(p), p), 0.0
        for by in NAMES:
            wanted = {of: expected.block(of, by) for of in OUTPUTS}
            worst = max(worst, *(x for _, x in gaps({of: found[of, by] for of in OUTPUTS}, wanted, ROUNDING)))
        print(f"\n{way}: {worst:.1e}, condition {condition:.1e}")
        assert worst < TOLERANCE


def straight(seed: int) -> Problem:
    """Return arms whose links all point the same way but for 1e-6 rad, held by what they hold off the constraint."""
    p = as_chain(random_system(seed, arms=3, joints=7, grasps="rigid", moving_base=False))
    x, random, arms = np.array([1.0, 0.0, 0.0]), np.random.default_rng(seed), {}
    for name, arm in p.chain.arms.items():
        joints = [
            replace(joint, kind="revolute", axis=np.eye(3)[k % 3], placement=hf.Pose(np.eye(3), 0.25 * x))
            for k, joint in enumerate(arm.joints)
        ]
        arms[name] = replace(arm, joints=joints, tip=hf.Pose(arm.tip.R, 0.2 * x))
    q = 1e-6 * random.normal(size=p.chain.joint_count)
    return replace(p, chain=replace(p.chain, arms=arms), state=replace(p.state, q=q))


SAME = 1e-12


@pytest.mark.parametrize("seed", mostly_slow(range(6), (0, 1, 2, 4)))
def test_beside_automatic_differentiation(seed):
    """Torques, base wrench and all that the grasp feels, by every joint's position and velocity."""
    p = random_chain(700 + seed)
    motion = chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain))
    at = point(motion, sequential(motion), "auto")
    worst = 0.0
    for name, case in at.motion.cases.items():
        z = at.unknowns[name]
        at_once = joint_residuals(case, z)
        for by in ("q", "qd"):
            residual = case.residual(z, tuple(numbers_of([by])))
            for unit, found in zip(np.eye(len(z.qdd)), at_once[by], strict=True):
                expected = ArmUnknowns(*residual.rates(unit))
                for a, b in zip(found, expected, strict=True):
                    size = max(1.0, np.abs(b).max(initial=0.0))
                    worst = max(worst, np.abs(a - b).max(initial=0.0) / size)
    print(f"\n{worst:.1e}")
    assert worst < SAME
