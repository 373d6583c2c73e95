"""Derivatives of forward dynamics on trunks, with springs between bodies and with forces that are not unique."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import dynamics
from holdfast.dynamics import Status
from holdfast.dynamics.linearise import basis_at
from holdfast.spatial import rotation
from tests.derivatives.blocks import as_direction, flat_direction, names_for, random_directions, size_of
from tests.derivatives.functions import FIVE_POINTS, STEP, displaced, problem
from tests.longer import mostly_slow
from tests.systems import planar_three_arms
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import random_problem, relative_gap
from tests.systems.sprung import with_springs
from tests.systems.trunk_problems import random_body
from tests.systems.trunk_runs import with_first_joints_as_trunk

TRUNCATED, SAME, DUAL = 1e-8, 1e-10, 1e-13
OF = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")
# What changes no grasp and no motion that grasps allow.
OF_MODEL = (
    *("tau", "gravity", "object_mass", "object_com", "object_inertia", "object_wrench", "armature", "damping"),
    *("link_mass", "link_com", "link_inertia", "link_wrench"),
    *("trunk_link_mass", "trunk_link_com", "trunk_link_inertia", "trunk_link_wrench"),
)


def results(p: Problem) -> tuple[str, ...]:
    """Return the names of all results."""
    if p.chain.trunk is None:
        return OF
    return (*OF, "floating_acceleration" if p.chain.floats else "trunk_base_wrench")


def solved(p: Problem) -> dict[str, np.ndarray]:
    """Return forward dynamics by the names of derivatives."""
    found = p.solved(check=False)
    fields = {name: "base_acceleration" if name == "floating_acceleration" else name for name in results(p)}
    return {name: getattr(found, field) for name, field in fields.items()}


def differences(at: Callable[[float], Problem]) -> dict[str, np.ndarray]:
    """Return how fast results change along a curve of problems, by five points."""
    far = [solved(at(k * STEP)) for k in FIVE_POINTS]
    return {name: sum(w * x[name] for w, x in zip(FIVE_POINTS.values(), far, strict=True)) / STEP for name in far[0]}


def require_duality(p: Problem, random: np.random.Generator) -> None:
    """Compare a gradient along a direction with a cotangent along the rates."""
    by = names_for(p)
    along, value = random_directions(p, random, by), solved(p)
    cotangents = {name: random.normal(size=x.shape) for name, x in value.items()}
    pushed = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, inputs=p.inputs, along=along, check=False)
    pulled = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, inputs=p.inputs, by=by, check=False, **cotangents)
    parts = [float(np.sum(pulled[name] * x)) for name, x in along.items()]
    parts += [-float(np.sum(cotangent * pushed[name])) for name, cotangent in cotangents.items()]
    assert abs(sum(parts)) < DUAL * np.abs(parts).sum()


def rates(p: Problem, along: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return rates of change of all results."""
    found = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, inputs=p.inputs, along=along, check=False)
    return {name: found[name] for name in results(p)}


def sprung(kind: str) -> Problem:
    """Return arms on a trunk and in the world, with springs between all kinds of bodies."""
    p = problem(kind)
    name = p.chain.names[0]
    more = [
        hf.Spring(("trunk", 1, [0.1, 0.0, 0.2]), (name, 1, [0.0, 0.1, 0.0]), 30.0, 0.2, 2.0),
        hf.Spring(("trunk", 0, [0.0, 0.2, 0.0]), ("object", [0.0, 0.05, 0.0]), 20.0, 0.1, 1.0),
        hf.Spring(("world", [0.5, 0.5, 0.5]), ("trunk", "base" if p.chain.floats else 0, [0.0, 0.0, 0.1]), 10.0),
    ]
    return replace(p, chain=replace(p.chain, springs=[*p.chain.springs, *more]))


@pytest.mark.parametrize("kind", ["trunk", "floating"])
def test_rates_of_springs_on_a_trunk_are_differences(kind):
    p, random = sprung(kind), np.random.default_rng(1)
    assert p.chain.mounts
    along = random_directions(p, random, names_for(p))
    flat = {name: 0.2 * flat_direction(p, name, x) for name, x in along.items()}
    expected = differences(lambda h: displaced(p, {name: h * x for name, x in flat.items()}))
    found = rates(p, {name: 0.2 * x for name, x in along.items()})
    for name, x in expected.items():
        assert relative_gap(found[name], x) < TRUNCATED, name


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["trunk", "floating"])
def test_rates_by_each_argument_are_differences(kind):
    p, random = sprung(kind), np.random.default_rng(2)
    for by in names_for(p):
        x = random_directions(p, random, [by])[by]
        flat, value = flat_direction(p, by, x), solved(p)
        size = max(1.0, float(np.abs(flat).max()))
        expected = differences(lambda h, by=by, x=flat / size: displaced(p, {by: h * x}))
        found = rates(p, {by: x / size})
        for name, wanted in expected.items():
            assert relative_gap(found[name], wanted, floor=1e-2 * np.abs(value[name]).max()) < TRUNCATED, (by, name)


@pytest.mark.parametrize("kind", mostly_slow(["trunk", "floating"], ["floating"]))
def test_duality_with_springs_on_a_trunk(kind):
    require_duality(sprung(kind), np.random.default_rng(3))


@pytest.mark.slow
def test_the_matrix_holds_the_rates():
    p, random, by = sprung("floating"), np.random.default_rng(4), ("qd", "floating_pose", "floating_twist")
    along = random_directions(p, random, by)
    D = hf.forward_dynamics_jacobian(p.chain, p.state, p.tau, inputs=p.inputs, of=results(p), by=by, check=False)
    for name, wanted in rates(p, along).items():
        found = sum(np.tensordot(D[name, x], along[x], along[x].ndim) for x in by)
        assert relative_gap(found, wanted) < 1e-12, name


def sprung_arms() -> Problem:
    """Return two arms with springs between all kinds of bodies."""
    p = random_problem(5, joints=(6, 7), grasps=("rigid", "hinge"), moving_base=False)
    return replace(p, chain=with_springs(p.chain), inputs=replace(p.inputs, link_wrenches=None))


def planar_arms() -> Problem:
    """Return planar arms, whose forces across the plane are not unique."""
    return replace(as_chain(planar_three_arms(1, joints=(5, 6, 4))), inputs=hf.Inputs())


@pytest.mark.slow
@pytest.mark.parametrize("made", [sprung_arms, planar_arms])
def test_the_first_joints_of_an_arm_as_a_trunk(made):
    """One chain written in two ways: derivatives are the same."""
    p, random, below = made(), np.random.default_rng(6), 2
    on, order = with_first_joints_as_trunk(p, below)
    assert (on.solved().status is Status.INDETERMINATE_FORCES) == (made is planar_arms)
    name, n = p.chain.names[1], p.chain.joint_count
    start = p.chain.joints[name].start
    links = [k for k in range(n) if not start <= k < start + below]
    same = ("object_pose", "object_twist", "object_mass", "object_com", "object_inertia", "object_wrench", "gravity")
    joints, of_links = ("q", "qd", "tau", "armature", "damping"), ("link_mass", "link_com", "link_inertia")
    along = random_directions(p, random, (*same, *joints, *of_links, "grasp_pose"))
    there = {x: along[x] for x in (*same, "grasp_pose")} | {x: along[x][order] for x in joints}
    there |= {x: along[x][links] for x in of_links}
    there |= {f"trunk_{x}": along[x][start : start + below] for x in of_links}
    one, other = rates(p, along), rates(on, there)
    under = [k for k in range(len(p.chain.arms)) if k != 1]
    assert relative_gap(other["qdd"], one["qdd"][order]) < SAME
    for x in ("grasp_wrench", "object_acceleration", "contact_acceleration"):
        assert relative_gap(other[x], one[x]) < SAME, x
    assert relative_gap(other["trunk_base_wrench"], one["base_wrench"][1]) < SAME
    assert relative_gap(other["base_wrench"][under], one["base_wrench"][under]) < SAME
    cotangents = {x: random.normal(size=v.shape) for x, v in one.items()}
    cotangents_there = cotangents | {"qdd": cotangents["qdd"][order], "trunk_base_wrench": cotangents["base_wrench"][1]}
    cotangents_there["base_wrench"] = np.where(
        np.arange(len(p.chain.arms))[:, None] == 1, 0.0, cotangents["base_wrench"]
    )
    pulled = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, inputs=p.inputs, by=tuple(along), **cotangents)
    found = hf.forward_dynamics_vjp(on.chain, on.state, on.tau, inputs=on.inputs, by=tuple(there), **cotangents_there)
    for x in along:
        wanted = pulled[x][order] if x in joints else pulled[x][links] if x in of_links else pulled[x]
        assert relative_gap(found[x], wanted) < SAME, x
    for x in of_links:
        assert relative_gap(found[f"trunk_{x}"], pulled[x][start : start + below]) < SAME, x


def planar(floating: bool) -> Problem:
    """Return planar arms that stand on a floating body, or two on a turning link and one in the world."""
    p, random = as_chain(planar_three_arms(3, joints=(4, 3, 4))), np.random.default_rng(3)
    inputs = hf.Inputs(object_wrench=random.normal(size=6))
    if not floating:
        on, _ = with_first_joints_as_trunk(replace(p, inputs=inputs), 1)
        pushed = replace(inputs, link_wrenches=random.normal(size=(on.chain.joint_count - 1, 6)))
        return driven(replace(on, inputs=pushed))
    base = hf.Pose(rotation.exp(random.normal(size=3)), 0.3 * random.normal(size=3))
    arms = {name: replace(arm, base=base.inverse() @ arm.base) for name, arm in p.chain.arms.items()}
    trunk = hf.Trunk(floating=random_body(random))
    chain = hf.ClosedChain(
        arms, p.chain.held_object, p.chain.grasps, p.chain.gravity, trunk, dict.fromkeys(arms, "base")
    )
    state = replace(p.state, base_pose=base, base_twist=random.normal(size=6))
    pushed = replace(inputs, link_wrenches=random.normal(size=(chain.joint_count, 6)))
    return driven(Problem(chain, dynamics.project_velocity(chain, state), p.tau, pushed))


def driven(p: Problem) -> Problem:
    """Return the problem with armature and damping, so that they may be varied to both sides."""
    return displaced(p, {"armature": 0.1, "damping": 0.1})


@pytest.mark.slow
@pytest.mark.parametrize("floating", [False, True])
def test_minimum_norm_forces_by_what_moves_no_grasp(floating):
    p, random = planar(floating), np.random.default_rng(7)
    assert p.solved().status is Status.INDETERMINATE_FORCES
    by = [name for name in OF_MODEL if name in names_for(p)]
    along = {name: 0.1 * as_direction(p, name, random.normal(size=size_of(p, name))) for name in by}
    expected = differences(lambda h: displaced(p, {name: h * flat_direction(p, name, x) for name, x in along.items()}))
    for name, found in rates(p, along).items():
        assert relative_gap(found, expected[name]) < TRUNCATED, name


@pytest.mark.slow
@pytest.mark.parametrize("floating", [False, True])
def test_minimum_norm_forces_along_motions(floating):
    """Along a curve of closed states that begins with a motion of the chain."""
    p, random = planar(floating), np.random.default_rng(8)
    T = basis_at(p.chain, p.state, p.inputs.shaped(p.chain))
    x = T @ random.normal(size=T.shape[1])
    x = 0.3 * x / np.abs(x).max()
    names = [name for name in ("q", "object_pose", "floating_pose") if name in names_for(p)]
    names += [name for name in ("qd", "object_twist", "floating_twist") if name in names_for(p)]
    along = dict(zip(names, np.split(x, np.cumsum([size_of(p, name) for name in names])[:-1]), strict=True))

    def at(h: float) -> Problem:
        moved = displaced(p, {name: h * x for name, x in along.items()})
        return replace(moved, state=hf.close(moved.chain, moved.state, inputs=moved.inputs))

    expected = differences(at)
    for name, found in rates(p, along).items():
        assert relative_gap(found, expected[name]) < TRUNCATED, name


@pytest.mark.parametrize("floating", mostly_slow([False, True], []))
def test_duality_of_minimum_norm_forces(floating):
    require_duality(planar(floating), np.random.default_rng(9))
