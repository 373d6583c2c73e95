"""Machine code of forward dynamics with a trunk: the reference's answers, batches, bound calls, refusals."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled import CompiledChain, arrays
from holdfast.compiled.structure import Options
from holdfast.dynamics import Status
from holdfast.questions.arrays import FLOATING
from holdfast.questions.question import QUESTIONS
from tests.compiled.test_functions import gap
from tests.longer import mostly_long
from tests.questions.every import direct, flat, reference
from tests.systems.problems import relative_gap
from tests.systems.trunk_problems import cases, random_on_trunk
from tests.systems.trunk_runs import still_base

EXACT = 1e-11
ANSWERS = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench", "trunk_base_wrench")
CASES = ["torso3_three_arms_one_free_head", "space_hinge_ball", "links_and_world_arm", "floating_torso3_gravity_mixed"]
MOVING = ("trunk_base_twist", "trunk_base_acceleration")


def given(p):
    """Return the arguments of a compiled call."""
    wanted = {"object_wrench": p.inputs.object_wrench} | {name: getattr(p.inputs, name) for name in MOVING}
    if p.chain.floats:
        wanted |= {"floating_pose": p.state.base_pose, "floating_twist": p.state.base_twist}
    arguments = (p.state.q, p.state.qd, p.tau, p.state.object_pose, p.state.object_twist)
    return arguments, {name: x for name, x in wanted.items() if x is not None}


@cache
def compiled(name):
    """Return a case, its chain as machine code, and the arguments of its call."""
    case = cases()[name]
    return case, hf.compile(case.chain), *given(case)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_reference(name):
    """One system and a batch have the reference's answers, and one another's bits."""
    case, fast, arguments, parameters = compiled(name)
    found = fast.forward_dynamics(*arguments, **parameters)
    wanted = hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs)
    assert (found.rank, found.mobility, found.status) == (wanted.rank, wanted.mobility, wanted.status)
    for part in ANSWERS:
        assert relative_gap(getattr(found, part), getattr(wanted, part), 1.0) < EXACT
    if case.chain.floats:
        assert relative_gap(found.base_acceleration, wanted.base_acceleration) < EXACT
    else:
        assert found.base_acceleration is None
    several = fast.forward_dynamics(*(np.tile(x, (5, 1)) for x in arguments), **parameters, threads=2)
    for part in ANSWERS:
        for row in getattr(several, part):
            np.testing.assert_array_equal(row, getattr(found, part))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "joints", "floating"),
    mostly_long([(0, 1, False), (3, 3, True), (4, 4, False)], [(0, 1, False), (3, 3, True)]),
)
def test_external_wrenches_inertias_and_driven_bases(seed, joints, floating):
    """Wrenches on every body, every body's inertia and a trunk's driven base are run-time parameters."""
    other = random_on_trunk(seed, joints, floating=floating)
    fast = hf.compile(other.chain, parameters=["link_wrench", "link_inertia"])
    trunk = other.chain.trunk
    assert trunk is not None
    bodies = [replace(b, mass=1.5 * b.mass, com=b.com + 0.1, inertia=1.3 * b.inertia) for b in trunk.bodies]
    trunk = replace(trunk, links=bodies[floating:], floating=bodies[0] if floating else None)
    p = replace(other, chain=replace(other.chain, trunk=trunk))
    arguments, parameters = given(p)
    parameters |= {"link_wrench": p.inputs.link_wrenches, "trunk_link_wrench": p.inputs.trunk_link_wrenches}
    for name in ("mass", "com", "inertia"):
        parameters[f"trunk_link_{name}"] = np.array([getattr(body, name) for body in bodies])
    found, wanted = fast.forward_dynamics(*arguments, **parameters), p.solved()
    for part in ANSWERS:
        assert relative_gap(getattr(found, part), getattr(wanted, part), 1.0) < EXACT


@pytest.mark.slow
def test_bound():
    """A bound call reads pose and twist of the floating base where they are."""
    case, fast, arguments, parameters = compiled("space_hinge_ball")
    names = ("q", "qd", "tau", "object_pose", "object_twist")
    bound = fast.bind(**{name: np.array(x) for name, x in zip(names, arguments, strict=True)})
    bound.floating_pose[...], bound.floating_twist[...] = case.state.base_pose, case.state.base_twist
    assert bound() is Status.OK
    alone = fast.forward_dynamics(*arguments, **parameters)
    np.testing.assert_array_equal(bound.result.qdd, alone.qdd)
    np.testing.assert_array_equal(bound.result.base_acceleration, alone.base_acceleration)
    bound.floating_pose[0] += 0.1
    assert bound() is Status.INVALID


def test_by_the_builtin(monkeypatch):
    """A repeated call with a floating base leaves the Python code out, its names in any order, for the same bits."""
    _, fast, arguments, parameters = compiled("space_hinge_ball")
    arguments = [np.array(x, dtype=float) for x in arguments]
    base = {name: np.array(parameters[name]) for name in FLOATING}
    expected = fast.forward_dynamics(*arguments, **base)
    out = fast.forward_dynamics(*arguments, **{name: x + 0.0 for name, x in base.items()})
    fast.forward_dynamics(*arguments, **base, out=out)
    monkeypatch.setattr(arrays, "floats", None)
    for names in (base, dict(reversed(base.items()))):
        out.memory[...] = 0.0
        assert fast.forward_dynamics(*arguments, out=out, **names) is out
        np.testing.assert_array_equal(out.qdd, expected.qdd)
        np.testing.assert_array_equal(out.base_acceleration, expected.base_acceleration)
    with pytest.raises(hf.errors.StateError, match="floating_twist: expected that of the trunk's floating base"):
        fast.forward_dynamics(*arguments, floating_pose=base["floating_pose"], out=out)


@pytest.mark.slow
def test_not_unique_forces():
    """The generic rank is found, and accelerations are the reference's."""
    case, fast, arguments, parameters = compiled("many_forces_links_3joint_rigid")
    found = fast.forward_dynamics(*arguments, **parameters)
    assert found.status is Status.INDETERMINATE_FORCES
    assert relative_gap(found.qdd, np.concatenate([case.expected.trunk.qdd, *case.expected.qdd])) < EXACT


def test_refused():
    """A floating base whose state is missing, base motion of an arm that the trunk carries."""
    _, fast, arguments, parameters = compiled("space_hinge_ball")
    for options, message in (
        ({}, "floating_pose: expected"),
        (parameters | {"floating_pose": np.ones(7)}, "floating_pose: expected a unit quaternion"),
        (parameters | {"base_twist": np.ones((2, 6))}, "moves with the trunk"),
    ):
        with pytest.raises(hf.errors.StateError, match=message):
            fast.forward_dynamics(*arguments, **options)


@pytest.mark.slow
@pytest.mark.parametrize("floating", mostly_long([False, True], [True]))
def test_other_functions(floating):
    """Every other question has the reference's answer, and refuses a call without the state of a floating base."""
    p = still_base(3, 2, floating=floating, arms={"arms": 2, "joints": 7, "grasps": ("rigid", "ball")}, in_world=0.4)
    chain, s, fast, found = p.chain, p.state, CompiledChain(p.chain, Options(), None), p.solved()
    given = {"q": s.q, "qd": s.qd, "object_pose": s.object_pose, "object_twist": s.object_twist}
    given |= {"qdd": found.qdd, "grasp_wrench": found.grasp_wrench, "tau": p.tau}
    if floating:
        given |= {"floating_pose": s.base_pose, "floating_twist": s.base_twist}
        given |= {"floating_acceleration": found.base_acceleration}
    for name in direct():
        question, now = QUESTIONS[name], given
        if name == "project":
            now = given | {"q": s.q + 1e-5}
        own, ask = {x: now[x] for x in question.by_name(chain)}, getattr(fast, name)
        answer = ask(*(now[x] for x in question.inputs), **own)
        assert gap(flat(answer), reference(name, chain, now, hf.Inputs())) < EXACT, name
        for x in own:
            with pytest.raises(hf.errors.StateError, match=f"{x}: expected that of the trunk's floating base"):
                ask(*(now[y] for y in question.inputs), **{y: value for y, value in own.items() if y != x})
    if not floating:
        many = fast.momentum(*(np.array([x, x]) for x in (s.q, s.qd, s.object_pose, s.object_twist)))
        assert np.allclose(many, [hf.dynamics.momentum(chain, s)] * 2, rtol=1e-11, atol=1e-11)


@pytest.mark.slow
def test_a_joint_without_inertia():
    """Two trunk joints about one axis, nothing between them: the reference refuses, machine code says INVALID."""
    p = random_on_trunk(3, 2, floating=False)
    trunk = hf.Trunk([hf.Joint(), hf.Joint()], [hf.Link(0.0), hf.Link(3.0, inertia=np.diag([0.1, 0.2, 0.15]))])
    chain = replace(p.chain, trunk=trunk, mounts=dict.fromkeys(p.chain.mounts, 1))
    s = p.state
    with pytest.raises(hf.errors.ModelError, match="trunk, joint"):
        hf.forward_dynamics(chain, s, p.tau, check=False)
    states = [np.stack([x, x]) for x in (s.q, s.qd, p.tau, s.object_pose, s.object_twist)]
    assert (hf.compile(chain).forward_dynamics(*states).status == Status.INVALID).all()
