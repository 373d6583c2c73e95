"""Derivatives of forward dynamics: the stored 126-digit answers, an independent oracle, and laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled import CompiledChain
from holdfast.dynamics import Status, object_mobility
from tests.compiled import problems
from tests.compiled.problems import chain_named, forces, numbers, one
from tests.compiler.programs import same_bits
from tests.derivatives.asked import (
    NAMES,
    WAYS,
    as_direction,
    by_jacobian,
    by_jvp,
    by_vjp,
    compiled,
    flat_gradient,
    given,
    names_for,
    shapes,
    size_of,
)
from tests.derivatives.chains import TRUNKS, random_chain
from tests.derivatives.stored import OF, columns, gaps, names, stored
from tests.oracles.chain_derivatives import OUTPUTS, chain_derivatives
from tests.systems import random_system, two_collinear_stretched_6r
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import relative_gap

pytestmark = pytest.mark.skipif(
    not hasattr(CompiledChain, "forward_dynamics_vjp"), reason="compiled derivatives are not there yet"
)
reference = pytest.mark.skipif(
    not hasattr(hf, "forward_dynamics_vjp"), reason="the reference forms of derivatives are not there yet"
)

BAR, SHARP, SOUND = 1e-9, 1e-11, 1e4  # of every block; where the condition is below SOUND
DUAL = 1e-13
RANDOM = 1e-10
LAW = 1e-11
ROUNDING = 1e-13  # of a group's largest entry: blocks that are zero
UNIQUE = [name for name in names() if stored(name).unique]
NOT_UNIQUE = [name for name in names() if name not in UNIQUE]
SCALES = (1e-7, 1e-5, 1e-2, 1e2, 1e3)
ALONG = ("q", "object_pose", "qd", "object_twist")  # the rows of a tangent of the state manifold


def worst_gap(found, expected, names, nothing: float = ROUNDING) -> float:
    """Return the worst gap of all blocks from the oracle's."""
    worst = 0.0
    for by in names:
        wanted = {of: expected.block(of, by) for of in OUTPUTS}
        off = dict(gaps({of: found[of, by] for of in OUTPUTS}, wanted, nothing))
        assert max(off.values()) < RANDOM, (by, off)
        worst = max(worst, *off.values())
    return worst


def random_cotangents(p: Problem, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a cotangent of every output."""
    return {name: random.normal(size=shape) for name, shape in shapes(p).items()}


def random_directions(p: Problem, random: np.random.Generator, by=NAMES) -> dict[str, np.ndarray]:
    """Return a direction of every argument and parameter."""
    return {name: as_direction(p, name, random.normal(size=size_of(p, name))) for name in by}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", UNIQUE)
def test_stored_answers(name, way):
    """Every block of the stored matrices, by rows, by columns and as a matrix."""
    case = stored(name)
    p, fast = case.problem, compiled(case.problem)
    bar = SHARP if p.solved().condition < SOUND else BAR
    lists = {group: columns(p.chain, group) for group in case.groups}
    found = WAYS[way](fast, p, OF, dict.fromkeys(by for by, _ in lists.values()))
    worst = 0.0
    for group, (by, which) in lists.items():
        off = dict(gaps({of: found[of, by][:, which] for of in OF}, {of: case.blocks[of, group] for of in OF}))
        assert max(off.values()) < bar, (group, off)
        worst = max(worst, *off.values())
    print(f"\n{name}, {way}: {worst:.1e}")


@reference
@pytest.mark.parametrize("name", names())
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
    bars = {of: np.random.default_rng(0).normal(size=shapes(p)[of]) for of in OF}
    pulled = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, inputs=p.inputs, **bars, by=ALONG)
    gradient = np.concatenate([flat_gradient(p, by, getattr(pulled, by)) for by in ALONG]) @ case.tangent
    wanted = sum(np.ravel(bars[of]) @ case.along[of] for of in OF)
    assert relative_gap(gradient, wanted) < SHARP


@pytest.mark.parametrize("name", NOT_UNIQUE)
def test_what_is_unique_beside_forces_that_are_not(name):
    """Machine code has accelerations' gradients along the manifold, and refuses a cotangent of the forces."""
    case = stored(name)
    p, fast = case.problem, compiled(case.problem)
    bars = {of: np.random.default_rng(0).normal(size=shapes(p)[of]) for of in OF if of != "grasp_wrench"}
    pulled = fast.forward_dynamics_vjp(**given(p), **bars, by=ALONG)
    gradient = np.concatenate([flat_gradient(p, by, getattr(pulled, by)) for by in ALONG]) @ case.tangent
    wanted = sum(np.ravel(bars[of]) @ case.along[of] for of in bars)
    assert relative_gap(gradient, wanted) < SHARP
    with pytest.raises(hf.HoldfastError, match="grasp_wrench"):
        fast.forward_dynamics_vjp(**given(p), grasp_wrench=np.ones(shapes(p)["grasp_wrench"]), by=("q",))


@pytest.mark.parametrize("seed", range(14))
def test_random_chains(seed):
    """Any grasps, driven bases, drives, wrenches on links and object, free arms: against the oracle, all directions."""
    p = random_chain(100 + seed)
    worst = worst_gap(by_jacobian(compiled(p), p), chain_derivatives(p, NAMES), NAMES)
    print(f"\n{', '.join(grasp.kind for grasp in p.chain.grasps.values())}: {worst:.1e}")


@pytest.mark.parametrize("trunk", [trunk for trunk in TRUNKS if trunk])
@pytest.mark.parametrize("seed", range(8))
def test_random_chains_on_trunks(seed, trunk):
    """The same on a torso or a floating base, some arms beside it in the world."""
    p = random_chain(200 + seed, trunk)
    by = names_for(p)
    worst = worst_gap(by_jacobian(compiled(p), p, by=by), chain_derivatives(p, by), by)
    print(f"\n{trunk}, {', '.join(grasp.kind for grasp in p.chain.grasps.values())}: {worst:.1e}")


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("seed", range(2))
def test_light_and_heavy_objects(seed, scale):
    """Objects of 1e-7 to 1e3 of the usual mass lose nothing; against the oracle in forty digits."""
    p = random_chain(300 + seed, any_kind=False, object_scale=scale)
    expected = chain_derivatives(p, NAMES, 40)
    for way in ("vjp", "jvp"):
        found = WAYS[way](compiled(p), p)
        print(f"\n{scale:.0e}, {way}: {worst_gap(found, expected, NAMES):.1e}")


@pytest.mark.parametrize("trunk", TRUNKS)
@pytest.mark.parametrize("seed", range(4))
def test_duality(seed, trunk):
    """<bar, J d> = <J^T bar, d>."""
    p, random = random_chain(100 + seed, trunk), np.random.default_rng(seed)
    fast, by = compiled(p), names_for(p)
    bars, directions = random_cotangents(p, random), random_directions(p, random, by)
    pulled = fast.forward_dynamics_vjp(**given(p), **bars, by=by)
    pushed = fast.forward_dynamics_jvp(**given(p), along=directions)
    one_way = [bar * getattr(pushed, of) for of, bar in bars.items()]
    other_way = [directions[name] * getattr(pulled, name) for name in by]
    size = max(np.abs(x).max(initial=0.0) for x in [*one_way, *other_way])
    off = abs(sum(x.sum() for x in one_way) - sum(x.sum() for x in other_way)) / size
    print(f"\n{off:.1e}")
    assert off < DUAL


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


@pytest.mark.parametrize("trunk", TRUNKS)
@pytest.mark.parametrize("seed", range(3))
def test_symmetries(seed, trunk):
    """d qdd / d tau is symmetric, no eigenvalue below 0; d alpha / d w is the object's mobility; the rest mirrored."""
    p = random_chain(100 + seed, trunk)
    found = by_jacobian(compiled(p), p, by=("tau", "object_wrench"))
    mobility = found["qdd", "tau"]
    assert relative_gap(mobility, mobility.T) < LAW
    assert np.linalg.eigvalsh((mobility + mobility.T) / 2)[0] > -LAW * np.abs(mobility).max()
    assert relative_gap(found["object_acceleration", "object_wrench"], object_mobility(p.chain, p.state)) < LAW
    assert relative_gap(found["object_acceleration", "tau"], found["qdd", "object_wrench"].T) < LAW


@pytest.mark.parametrize("seed", range(3))
def test_gravity_is_an_acceleration_of_all_bases(seed):
    """Gravity changes all as if the bases accelerated the other way; the object's acceleration by itself more."""
    p = random_chain(100 + seed)
    found = by_jacobian(compiled(p), p, by=("gravity", "base_acceleration"))
    for of in OUTPUTS:
        bases = found[of, "base_acceleration"].reshape(-1, len(p.chain.arms), 6)[:, :, 3:].sum(1)
        own = np.eye(6)[:, 3:] if of == "object_acceleration" else 0.0
        assert relative_gap(found[of, "gravity"], own - bases, 1.0) < LAW, of


@pytest.mark.parametrize("seed", range(4))
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


@reference
@pytest.mark.parametrize("trunk", TRUNKS)
@pytest.mark.parametrize("seed", range(2))
def test_reference_and_machine_code(seed, trunk):
    """The reference forms trace the same texts: gradients, directions, the matrix, and the result beside."""
    p, random = random_chain(400 + seed, trunk), np.random.default_rng(seed)
    fast, by = compiled(p), ("q", "qd", "tau", "object_pose", "object_twist")
    bars, directions = random_cotangents(p, random), random_directions(p, random, by)
    arguments = (p.chain, p.state, p.tau)
    pulled = fast.forward_dynamics_vjp(**given(p), **bars, by=by)
    expected = hf.forward_dynamics_vjp(*arguments, inputs=p.inputs, **bars, by=by)
    for name in by:
        assert relative_gap(getattr(pulled, name), getattr(expected, name)) < LAW
    pushed = fast.forward_dynamics_jvp(**given(p), along=directions)
    expected = hf.forward_dynamics_jvp(*arguments, inputs=p.inputs, along=directions)
    for of in OUTPUTS:
        assert relative_gap(getattr(pushed, of), getattr(expected, of)) < LAW
    matrix = fast.forward_dynamics_jacobian(**given(p), of=("qdd", "grasp_wrench"), by=by)
    expected = hf.forward_dynamics_jacobian(*arguments, inputs=p.inputs, of=("qdd", "grasp_wrench"), by=by)
    for key in [(result, name) for result in ("qdd", "grasp_wrench") for name in by]:
        assert relative_gap(matrix[key], expected[key]) < LAW
    plain = fast.forward_dynamics(**given(p))
    for of in OUTPUTS:
        assert relative_gap(getattr(pulled.result, of), getattr(plain, of)) < LAW


# Batches, chains of many types, statuses


def state_of(system: dict[str, np.ndarray]) -> hf.State:
    """Return the state of a system."""
    return hf.State(*(system[name] for name in ("q", "qd", "object_pose", "object_twist")))


@pytest.mark.parametrize("name", ["two", "interleaved", "rows first", "all kinds", "nobody holds"])
def test_bits(name):
    """A system alone, in a batch of any size and on two threads: the same bits, of all three."""
    chain, count, random = chain_named(name), 21, np.random.default_rng(1)
    many, fast = numbers(chain, count) | forces(chain, count), problems.compiled(name)
    p = Problem(chain, state_of(one(many, 0)), many["tau"][0], hf.Inputs())
    bars = {of: random.normal(size=(count, *shape)) for of, shape in shapes(p).items()}
    directions = {by: as_direction(p, by, random.normal(size=(count, size_of(p, by)))) for by in NAMES}
    of, few = ("qdd", "object_acceleration"), ("q", "qd", "tau", "object_pose")

    def pulled(which, **more):
        found = fast.forward_dynamics_vjp(**one(many | bars, which), by=NAMES, **more)
        return [np.asarray(getattr(found, name)) for name in NAMES]

    def pushed(which, **more):
        along = {by: x[which] for by, x in directions.items()}
        found = fast.forward_dynamics_jvp(**one(many, which), along=along, **more)
        return [np.asarray(getattr(found, name)) for name in OUTPUTS]

    def matrix(which, **more):
        found = fast.forward_dynamics_jacobian(**one(many, which), of=of, by=few, **more)
        return [np.asarray(found[result, name]) for result in of for name in few]

    for way in (pulled, pushed, matrix):
        whole, tail, threads = way(slice(None)), way(slice(0, 13)), way(slice(None), threads=2)
        for k, x in enumerate(whole):
            assert same_bits(x, threads[k]) and same_bits(x[:13], tail[k])
        for i in (0, 7, 20):
            alone = way(i)
            assert all(same_bits(x[i], y) for x, y in zip(whole, alone, strict=True)), (way.__name__, i)


@pytest.mark.parametrize("name", ["two", "interleaved", "rows first", "factors only", "all kinds", "nobody holds"])
def test_arms_of_many_types(name):
    """Arms of two types side by side, an arm without a grasp, states off the constraint: against the oracle."""
    chain = chain_named(name)
    system = one(numbers(chain, 1, 5) | forces(chain, 1, 5), 0)
    acting = (system[key] for key in ("object_wrench", "link_wrench", "base_twist", "base_acceleration"))
    p = Problem(chain, state_of(system), system["tau"], hf.Inputs(*acting))
    expected = chain_derivatives(p, NAMES)
    for way in WAYS:
        print(f"\n{name}, {way}: {worst_gap(WAYS[way](problems.compiled(name), p), expected, NAMES):.1e}")


def test_some_of_it():
    """Fewer gradients and directions are the same numbers; names that are none are refused by name."""
    p, random = random_chain(100), np.random.default_rng(0)
    fast, bars = compiled(p), random_cotangents(random_chain(100), random)
    whole = fast.forward_dynamics_vjp(**given(p), **bars, by=NAMES)
    for by in ("q", "object_mass", "grasp_pose", "link_inertia", "damping"):
        few = fast.forward_dynamics_vjp(**given(p), **bars, by=(by,))
        assert relative_gap(getattr(few, by), getattr(whole, by)) < LAW
    apart = [fast.forward_dynamics_vjp(**given(p), **{of: bar}, by=("q",)).q for of, bar in bars.items()]
    assert relative_gap(sum(apart), whole.q) < LAW
    for of in ("rank", "status", "condition", "force"):
        with pytest.raises(hf.HoldfastError, match=of):
            fast.forward_dynamics_jacobian(**given(p), of=("qdd", of), by=("q",))
    with pytest.raises(hf.HoldfastError, match="object_weight"):
        fast.forward_dynamics_vjp(**given(p), **bars, by=("q", "object_weight"))
    with pytest.raises(hf.HoldfastError, match="object_weight"):
        fast.forward_dynamics_jvp(**given(p), along={"object_weight": np.ones(3)})


def test_singular_and_invalid_systems():
    """Each of them has not-a-number for itself alone; the others have the bits of a clean batch."""
    p = as_chain(two_collinear_stretched_6r(1))
    fast, count, random = hf.compile(p.chain, generic_rank=12), 9, np.random.default_rng(0)
    own = {name: problems.given_by(p)[name] for name in problems.STATE}
    many = {name: np.repeat(x[None], count, axis=0) for name, x in own.items()}
    singular, invalid = np.arange(count) % 3 == 0, np.arange(count) == 4
    many["q"][~singular] += random.uniform(-0.5, 0.5, ((~singular).sum(), 12))
    clean = {name: x.copy() for name, x in many.items()}
    clean["q"][singular] += random.uniform(-0.5, 0.5, (singular.sum(), 12))
    many["tau"][invalid, 0] = np.nan
    by, bars = ("q", "tau", "object_pose", "object_mass"), {"qdd": random.normal(size=(count, 12))}
    found, good = (fast.forward_dynamics_vjp(**x, **bars, by=by) for x in (many, clean))
    bad, statuses = (
        singular | invalid,
        np.where(singular, Status.SINGULAR, np.where(invalid, Status.INVALID, Status.OK)),
    )
    assert found.result.status.tolist() == statuses.tolist()
    for name in by:
        x, y = getattr(found, name), getattr(good, name)
        assert np.isnan(x[bad]).all() and same_bits(x[~bad], y[~bad]), name
    along = {"q": random.normal(size=(count, 12)), "object_mass": random.normal(size=count)}
    pushed, good = (fast.forward_dynamics_jvp(**x, along=along) for x in (many, clean))
    for of in OUTPUTS:
        x = getattr(pushed, of)
        assert np.isnan(x[bad]).all() and same_bits(x[~bad], getattr(good, of)[~bad]), of
    matrix, good = (fast.forward_dynamics_jacobian(**x, of=("qdd",), by=by) for x in (many, clean))
    for name in by:
        x, y = matrix["qdd", name], good["qdd", name]
        assert np.isnan(x[bad]).all() and same_bits(x[~bad], y[~bad]), name
    with pytest.raises(hf.SingularChainError):
        fast.forward_dynamics_vjp(**one(many, 0), qdd=bars["qdd"][0], by=by)
    with pytest.raises(hf.StateError, match="tau: expected finite numbers"):
        fast.forward_dynamics_vjp(**one(many, 4), qdd=bars["qdd"][4], by=by)


# Postures where square roots and lever arms vanish


@pytest.mark.parametrize("trunk", TRUNKS)
@pytest.mark.parametrize("where", ["at rest", "at zero"])
def test_at_rest(where, trunk):
    """Every rate and force exactly zero; or every joint at exactly zero with them."""
    p = random_chain(500, trunk)
    state = p.state.at_rest()
    if where == "at zero":
        state = replace(state, q=0.0 * state.q)
    p = Problem(replace(p.chain, gravity=np.zeros(3)), state, 0.0 * p.tau, hf.Inputs())
    by = names_for(p)
    found, expected = by_jacobian(compiled(p), p, by=by), chain_derivatives(p, by)
    assert all(np.isfinite(x).all() for x in found.values())
    print(f"\n{where}: {worst_gap(found, expected, by):.1e}")


@pytest.mark.parametrize("seed", range(3))
def test_straight_arms(seed):
    """Joints within 1e-6 rad of stretched arms, three arms of seven: the oracle in forty digits, a looser bar."""
    p = straight(seed)
    expected = chain_derivatives(p, NAMES, 40)
    condition = p.solved(check=False).condition
    for way in WAYS:
        found, worst = WAYS[way](compiled(p), p), 0.0
        for by in NAMES:
            wanted = {of: expected.block(of, by) for of in OUTPUTS}
            worst = max(worst, *(x for _, x in gaps({of: found[of, by] for of in OUTPUTS}, wanted, ROUNDING)))
        print(f"\n{way}: {worst:.1e}, condition {condition:.1e}")
        assert worst < BAR


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
