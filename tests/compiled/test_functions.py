"""The other compiled functions: inverse dynamics, mass matrices, poses, closure, projection, energies, momentum."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import FunctionType

import numpy as np
import pytest

import holdfast
from holdfast import ClosedChain, Pose
from holdfast.compiled import CompiledChain
from holdfast.compiled.chain import REASONS
from holdfast.compiled.computation import structure_of
from holdfast.compiled.structure import Options
from holdfast.compiler.interpret import interpret_schedule
from holdfast.compiler.targets import cpu
from holdfast.dynamics.projection import after_step
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model.grasp import WrenchLimits
from holdfast.questions.arrays import ARRAYS
from holdfast.questions.case import OF_INPUTS
from holdfast.questions.question import QUESTIONS
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from tests.compiled import problems
from tests.compiled.problems import Given, chain_named, chain_of, compiled, numbers, one
from tests.dynamics.problems import CASES, random_problem, stored
from tests.longer import mostly_long, mostly_slow
from tests.questions.every import FUNCTIONS, built_with, direct, flat, inputs_of, parameters_of, reference, taken_by
from tests.surface import PUBLIC
from tests.systems.as_chain import Problem

BOUND = 1e-11
EVERY = direct()
# these compile the filter: elsewhere than against the reference it is the same machinery, and takes longest
functions = pytest.mark.parametrize("function", mostly_long(EVERY, {*EVERY} - {"project", "object_mobility"}))


def called(fast: CompiledChain, function: str, given: Given, **options) -> Given:
    """Return a function's results as arrays by name."""
    return flat(getattr(fast, function)(*(given[name] for name in QUESTIONS[function].inputs), **options))


def gap(found: dict[str, Array], expected: dict[str, Array]) -> float:
    """Return the largest difference, relative to max(1, size)."""
    assert list(found) == list(expected)
    worst = 0.0
    for name, x in expected.items():
        assert found[name].shape == x.shape, name
        assert np.array_equal(np.isinf(found[name]), np.isinf(x)), name
        off = np.abs(np.where(np.isinf(x), 0.0, found[name]) - np.where(np.isinf(x), 0.0, x))
        x = np.where(np.isinf(x), 0.0, x)
        worst = max(worst, off.max(initial=0.0) / max(1.0, np.abs(x).max(initial=0.0)))
    return worst


def same_bits(found: dict[str, Array], expected: dict[str, Array]) -> bool:
    """Return whether all numbers are equal, not-a-number to itself."""
    assert list(found) == list(expected)
    return all(np.array_equal(found[name], x, equal_nan=True) for name, x in expected.items())


def stacked(found: list[dict[str, Array]]) -> dict[str, Array]:
    """Return the results of many systems as those of a batch."""
    return {name: np.stack([each[name] for each in found]) for name in found[0]}


@cache
def alone(chain: ClosedChain, link_inertia: bool = False) -> CompiledChain:
    """Return the chain without forward dynamics, which takes longest to compile."""
    return CompiledChain(chain, Options("auto", link_inertia, link_wrenches=True), None)


def named(name: str) -> CompiledChain:
    """Return the functions of one of `CHAINS`, with every optional parameter; its grasps have friction or limits."""
    chain = chain_named(name)
    sized = {"softfinger": {"torsion_radius": 0.02}, "hinge": {"half_length": 0.05}, "ball": {}}
    grasps = {
        arm: replace(grasp, contact=holdfast.Friction(0.5, **sized[grasp.kind]))
        if grasp.kind in sized
        else replace(grasp, wrench_limits=WrenchLimits(force=20.0))
        for arm, grasp in chain.grasps.items()
    }
    return alone(replace(chain, grasps=grasps), link_inertia=True)


def disagreement(problem: Problem, function: str, seed: int = 0) -> float:
    """Return how far the compiled function is from the reference on a problem."""
    s, acting, fast = problem.state, problem.inputs.shaped(problem.chain), alone(problem.chain)
    given = one(inputs_of(problem.chain, 1, seed), 0)
    given |= {"q": s.q, "qd": s.qd, "object_pose": s.object_pose, "object_twist": s.object_twist}
    taken = {x: getattr(acting, OF_INPUTS[x]) for x in taken_by(getattr(fast, function)) if x in OF_INPUTS}
    options = {name: x for name, x in taken.items() if x is not None}
    found = called(fast, function, given, **options)
    return gap(found, reference(function, problem.chain, given, problem.inputs))


@pytest.mark.parametrize("name", mostly_long(CASES, ("legs_3_RRP_ball_moving_base",)))  # others: test_random_systems
def test_stored_cases(name):
    """All functions agree with the reference on every stored case."""
    for function in EVERY:
        assert disagreement(stored(name), function) < BOUND, function


@pytest.mark.parametrize("function", EVERY)
@pytest.mark.parametrize("seed", mostly_long(range(3), (0,)))
def test_random_systems(function, seed):
    """Every grasp kind, an arm without one, prismatic joints, moving bases, wrenches on the links."""
    grasps = ("rigid", "hinge", None, "softfinger", "ball")
    problem = random_problem(seed, grasps=grasps, joints=(6, 5, 3, 4, 3), moving_base=True)
    kinds = {joint.kind for arm in problem.chain.arms.values() for joint in arm.joints}
    assert kinds == {"revolute", "prismatic"}
    assert disagreement(problem, function, seed) < BOUND


@pytest.mark.parametrize("seed", [0, 1])
def test_functions_of_the_reference(seed):
    """They return what their questions compute; those with derivatives are in `tests/derivatives/test_functions.py`."""
    p = random_problem(seed, grasps=("rigid", "hinge", "ball", None), joints=(6, 5, 3, 4), moving_base=True)
    chain, s, about = p.chain, p.state, np.array([0.1, 0.2, 0.3])
    given = {"q": s.q, "qd": s.qd, "object_pose": s.object_pose, "object_twist": s.object_twist, "about": about}
    of_arms = {
        "mass_matrix": holdfast.dynamics.joint_mass_matrix,
        "jacobian": holdfast.dynamics.tip_jacobian,
        "tip_poses": lambda arm, q: {x: getattr(holdfast.dynamics.tip_pose(arm, q), x) for x in "Rp"},
        "link_poses": lambda arm, q: {
            x: np.array([getattr(link, x) for link in holdfast.dynamics.link_poses(arm, q)]) for x in "Rp"
        },
    }
    closed = after_step(chain, s, p.inputs.shaped(chain)).state
    expected = {
        "momentum": holdfast.dynamics.momentum(chain, s, about, p.inputs),
        "centre_of_mass": holdfast.dynamics.centre_of_mass(chain, s),
        "object_mobility": holdfast.dynamics.object_mobility(chain, s),
        "project": {name: getattr(closed, name) for name in QUESTIONS["project"].inputs},
        **{
            name: {arm: of(chain.arms[arm], s.q[part]) for arm, part in chain.joints.items()}
            for name, of in of_arms.items()
        },
    }
    assert {*expected} | {*FUNCTIONS} == {*EVERY}
    for name, of in expected.items():
        assert gap(reference(name, chain, given, p.inputs), flat(of)) < 1e-13, name


@pytest.mark.parametrize("function", [name for name in EVERY if name not in ("object_mobility", "project")])
@pytest.mark.parametrize("name", mostly_slow(["interleaved", "all kinds", "nobody holds", "nine"], ("interleaved",)))
def test_open_states(function, name):
    """States far from closed, arms of one type apart from each other in order, no grasps at all.

    The grasps' own equations may be singular there: for what solves them these are no states.
    """
    fast = named(name)
    chain, given = fast.chain, inputs_of(fast.chain, 5)
    found = called(fast, function, given)
    for i in range(5):
        here = one(found, i) if chain.grasps or function != "closure" else found
        assert gap(here, reference(function, chain, one(given, i))) < BOUND


@functions
def test_batch_is_single(function):
    """Batches of every size, on any number of threads, have the bits of single calls."""
    fast = named("all kinds")
    lanes = cpu.lanes()
    given, extra = inputs_of(fast.chain, 2 * lanes + 3), parameters_of(getattr(fast, function), 2 * lanes + 3)
    for options in ({}, extra):
        singles = [called(fast, function, one(given, i), **one(options, i)) for i in range(2 * lanes + 3)]
        for batch in (1, lanes, 2 * lanes + 3):
            first = {name: x[:batch] for name, x in given.items()}
            of = {name: x[:batch] for name, x in options.items()}
            for threads in (1, 3):
                found = called(fast, function, first, threads=threads, **of)
                assert same_bits(found, stacked(singles[:batch]))


@functions
def test_shared_arguments(function):
    """An argument without a batch axis is every system's; it may be as long as the batch is."""
    fast = named("all kinds")
    batch = fast.chain.joint_count
    given, extra = inputs_of(fast.chain, batch), parameters_of(getattr(fast, function), batch)
    for varied in (*QUESTIONS[function].inputs, *extra):
        found = called(fast, function, varying(given, varied), **varying(extra, varied))
        for i in (0, 1, batch - 1):
            single = called(fast, function, varying(given, varied, i), **varying(extra, varied, i))
            assert same_bits(one(found, i), single)


def varying(given: Given, varied: str, i: int | slice = slice(None)) -> Given:
    """Return one array of all systems, or of the i-th; the others are those of the first."""
    return {name: x[i] if name == varied else x[0] for name, x in given.items()}


@functions
@pytest.mark.parametrize("name", mostly_long(["all kinds", "interleaved"], ["interleaved"]))
def test_run_time_parameters(function, name):
    """Parameters of a call give what a chain built with them gives, and the next call has the chain's own again."""
    fast = named(name)
    given = one(inputs_of(fast.chain, 1), 0)
    extra = one(parameters_of(getattr(fast, function), 1), 0)
    own = called(fast, function, given)
    found = called(fast, function, given, **extra)
    chain = built_with(fast.chain, extra)
    assert gap(found, reference(function, chain, given | extra)) < BOUND
    again = alone(chain)
    acting = {name: x for name, x in extra.items() if ARRAYS[name].role == "input"}
    assert gap(found, called(again, function, given, **acting)) < 1e-12
    assert same_bits(called(fast, function, given), own)
    assert same_bits(found, own) == (not extra)


@functions
def test_interpreter(function):
    """The schedule read number by number gives the bits of the machine code."""
    fast = named("all kinds")
    made, given = getattr(fast, function), one(inputs_of(fast.chain, 1), 0)
    expected = interpret_schedule(made.computation.schedule(), made.calls.own | given)
    results = {name: expected[name] for name in QUESTIONS[function].names_at(fast.chain)}
    assert same_bits(called(fast, function, given), flat(QUESTIONS[function].shown(fast.chain)(results)))


@pytest.mark.parametrize("name", mostly_slow(["two", "all kinds", "rows first"], ("two",)))
def test_forward_of_inverse(name):
    """Forward dynamics of the torques that accelerations and grasp forces need returns them, all compiled."""
    fast = compiled(name)
    chain = fast.chain
    given = numbers(chain, 9) | problems.forces(chain, 9)
    del given["object_wrench"]
    result = fast.forward_dynamics(**given)
    assert set(result.status) <= {holdfast.dynamics.Status.OK, holdfast.dynamics.Status.INDETERMINATE_FORCES}
    acting = {k: x for k, x in given.items() if k in ("link_wrench", "base_twist", "base_acceleration")}
    tau = fast.inverse_dynamics(given["q"], given["qd"], result.qdd, result.grasp_wrench, **acting)
    np.testing.assert_allclose(tau, given["tau"], atol=1e-9 * np.abs(result.grasp_wrench).max())
    again = fast.forward_dynamics(**given | {"tau": tau})
    np.testing.assert_allclose(again.qdd, result.qdd, atol=1e-8 * np.abs(result.qdd).max())


def test_jacobian_and_velocity():
    """The velocity rows of a rigid grasp are those of the twist J qd."""
    fast = named("two")
    given = one(inputs_of(fast.chain, 1), 0)
    J = fast.jacobian(given["q"])
    still = fast.closure(given["q"], 0 * given["qd"], given["object_pose"], given["object_twist"])
    moving = fast.closure(given["q"], given["qd"], given["object_pose"], given["object_twist"])
    R_object = rotation.from_quaternion(given["object_pose"][:4])
    for name, part in fast.chain.joints.items():
        R = R_object @ fast.chain.grasps[name].frame.R
        V = J[name] @ given["qd"][part]
        expected = -np.concatenate([V[:3] @ R, V[3:] @ R])
        np.testing.assert_allclose(moving[name].velocity - still[name].velocity, expected, atol=1e-12)


def test_kinetic_energy_is_the_mass_matrix():
    """With object and bases at rest, T = 1/2 qd^T M qd over the arms."""
    fast = named("all kinds")
    given = inputs_of(fast.chain, 4)
    M = fast.mass_matrix(given["q"])
    T = fast.kinetic_energy(given["q"], given["qd"], given["object_pose"], np.zeros(6))
    expected = sum(
        0.5 * np.einsum("bi,bij,bj->b", given["qd"][:, part], M[name], given["qd"][:, part])
        for name, part in fast.chain.joints.items()
    )
    np.testing.assert_allclose(T, expected, rtol=1e-12)


@pytest.mark.parametrize("angle", mostly_slow([0.0, 1e-9, 0.3, 3.0, np.pi - 1e-6, np.pi], (0.0, np.pi)))
def test_turned_tips(angle):
    """Rigid tips turned by any angle, and hinges to the wrong way round, have the reference's residuals."""
    base = stored("mixed_4arm_all_types")
    axes = {"rigid": np.array([0.6, 0.0, 0.8]), "hinge": np.array([0.0, 0.0, 1.0])}
    arms = {}
    for name, arm in base.chain.arms.items():
        axis = axes.get(base.chain.grasps[name].kind, np.eye(3)[0])
        arms[name] = arm.with_tip(Pose(arm.tip.R @ rotation.exp(angle * axis), arm.tip.p))
    chain = replace(base.chain, arms=arms)
    s = base.state
    found = alone(chain).closure(s.q, s.qd, s.object_pose, s.object_twist)
    for name, expected in holdfast.dynamics.closure(chain, s).items():
        position = found[name].position
        if angle == np.pi:  # any perpendicular axis serves, either way round
            assert np.linalg.norm(position) == pytest.approx(np.linalg.norm(expected.position), abs=1e-7)
        else:  # at d from half a turn an axis is known to 1e-16 / d
            np.testing.assert_allclose(position, expected.position, atol=1e-9 if angle > 3.1 else 1e-13)


def test_types():
    """Arms of one type run side by side however they hold; only `closure` tells them apart, and links do not matter."""
    chain = chain_of(((6, "rigid"), (6, "ball"), (6, None)))
    chain = replace(chain, arms={name: chain.arms["arm0"].at(arm.base) for name, arm in chain.arms.items()})
    counts = {name: len(structure_of(QUESTIONS[name], chain, Options()).types) for name in EVERY}
    assert counts == {name: 3 if "grasps" in QUESTIONS[name].depends_on else 1 for name in EVERY}
    arms = dict(chain.arms)
    heavy = [holdfast.Link(2 * link.mass, link.com, 2 * link.inertia) for link in arms["arm0"].links]
    arms["arm0"] = replace(arms["arm0"], links=heavy)
    other = replace(chain, arms=arms)
    for name in EVERY:
        first, second = (structure_of(QUESTIONS[name], of, Options()).key for of in (chain, other))
        assert (first == second) == ("links" not in QUESTIONS[name].depends_on), name


def test_every_function_of_the_dynamics():
    """All that is public is compiled, or says by name why it is not, and what there is."""
    rooms = ("holdfast.dynamics.", "holdfast.forces.")
    public = {path: verb for path, verb in PUBLIC.items() if isinstance(verb, FunctionType)}
    verbs = {path for path, verb in public.items() if verb.__module__.startswith(rooms)}
    verbs |= {"holding_torques", "linearise"}
    last = {path: path.rpartition(".")[2] for path in verbs}
    compiled_too = {path for path in verbs if last[path] in dir(CompiledChain) or last[path] in QUESTIONS}
    assert verbs - compiled_too == set(REASONS)
    assert set(QUESTIONS) <= {last[path] for path in compiled_too} | {"mass_matrix", "jacobian", "tip_poses"}
    fast = named("all kinds")
    for path in REASONS:
        name = last[path]
        with pytest.raises(MethodNotApplicable, match=f"^compile: '{name}' runs as reference only: .*holdfast.{path} "):
            getattr(fast, name)
        assert not hasattr(fast, name)
    with pytest.raises(AttributeError, match="'CompiledChain' object has no attribute 'dynamo'"):
        fast.dynamo  # noqa: B018


def test_made_when_needed():
    """Compiling a chain makes none of them; chains of one structure share them."""
    chain = chain_of(((3, "rigid"), (2, "ball")), seed=5)
    fast, other = holdfast.compile(chain), holdfast.compile(replace(chain, gravity=(0.0, 1.0, 2.0)))
    assert not {*EVERY} & {*vars(fast)}
    q = np.zeros(5)
    pose = [1, 0, 0, 0, 0, 0, 1]
    assert fast.potential_energy(q, pose) != other.potential_energy(q, pose)
    assert {*EVERY} & {*vars(fast)} == {"potential_energy"}
    assert fast.potential_energy.calls.kernel is other.potential_energy.calls.kernel


def test_shapes():
    """Numbers and plain arrays for one system, a leading axis for a batch, a batch of none included."""
    fast = named("all kinds")
    given = one(inputs_of(fast.chain, 1), 0)
    for batch in (None, 0, 1, 3):
        now = given | {"q": given["q"] if batch is None else np.tile(given["q"], (batch, 1))}
        lead = () if batch is None else (batch,)
        assert called(fast, "inverse_dynamics", now)[""].shape == (*lead, fast.chain.joint_count)
        assert {k: x.shape for k, x in called(fast, "mass_matrix", now).items()} == {
            name: (*lead, arm.joint_count, arm.joint_count) for name, arm in fast.chain.arms.items()
        }
        assert called(fast, "jacobian", now)["arm0"].shape == (*lead, 6, fast.chain.arms["arm0"].joint_count)
        gaps = fast.closure(*(now[name] for name in QUESTIONS["closure"].inputs))
        rows_of = {"rigid": (6, 6), "hinge": (5, 5), "softfinger": (3, 4), "ball": (3, 3)}
        for name, grasp in fast.chain.grasps.items():
            i, j = rows_of[grasp.kind]
            assert (gaps[name].position.shape, gaps[name].velocity.shape) == ((*lead, i), (*lead, j))
        assert list(gaps) == list(fast.chain.grasps)
        assert called(fast, "kinetic_energy", now)[""].shape == lead
    assert isinstance(fast.potential_energy(given["q"], given["object_pose"]), float)


@functions
def test_refusals(function):
    """Wrong shapes, unknown parameters, batches that disagree and odd thread counts are refused by name."""
    fast = named("all kinds")
    given, inputs = one(inputs_of(fast.chain, 1), 0), QUESTIONS[function].inputs
    refused = [
        ({}, {"gravitas": 1.0}, "no parameter 'gravitas'"),
        ({}, {"object_wrench": np.zeros(6)}, "no parameter 'object_wrench'"),
        ({}, {"threads": 0}, "threads: expected an integer >= 1, got 0"),
    ]
    for name in inputs:
        refused.append(({name: np.zeros(2)}, {}, rf"{name}: expected shape \(.*\) or \(batch"))
        refused.append(({name: np.full(np.shape(given[name]), 1j)}, {}, f"{name}: expected real numbers"))
    if len(inputs) > 1:
        many = {name: np.zeros((k, *np.shape(given[name]))) for name, k in ((inputs[0], 2), (inputs[-1], 3))}
        refused.append((many, {}, f"expected one batch size, got {inputs[0]}: 2, {inputs[-1]}: 3"))
    for change, options, message in refused:
        with pytest.raises(StateError, match=message):
            called(fast, function, given | change, **options)


@functions
def test_invalid_inputs(function):
    """One system with an invalid number is refused; in a batch its results alone are not-a-number."""
    fast = named("all kinds")
    given = inputs_of(fast.chain, 5)
    sound = called(fast, function, given)
    inputs = QUESTIONS[function].inputs
    faults = [(name, value) for name in inputs for value in (np.nan, np.inf, -np.inf)]
    faults += [x for x in (("q", 1.1e5), ("q", -1.1e5), ("object_pose", 1.5)) if x[0] in inputs]
    for name, value in faults:
        changed = given | {name: given[name].copy()}
        changed[name].reshape(5, -1)[3, 0] = value
        with pytest.raises(StateError, match=rf"^{name}: expected (finite numbers|at most 100000 rad|a unit quat)"):
            called(fast, function, one(changed, 3))
        with np.errstate(all="raise"):
            found = called(fast, function, changed)
        for k in sound:
            assert np.isnan(found[k][3]).all(), (k, name, value)
        for i in (0, 1, 2, 4):
            assert same_bits(one(found, i), one(sound, i))
        if len(inputs) > 1:
            shared = called(fast, function, given | {name: changed[name][3]})
            assert all(np.isnan(x).all() for x in shared.values())


def test_far_slides():
    """What slides may go as far as it likes."""
    fast = named("all kinds")
    kinds = [joint.kind for arm in fast.chain.arms.values() for joint in arm.joints]
    q = np.where([kind == "prismatic" for kind in kinds], 2e5, 0.5)
    assert "prismatic" in kinds
    assert np.isfinite(fast.mass_matrix(np.stack([q, q]))["arm0"]).all()
    assert np.isfinite(fast.potential_energy(q, [1, 0, 0, 0, 0, 0, 0]))


def test_wrench_on_an_arm_that_holds_nothing():
    """It is refused for one system and for a batch alike."""
    fast = named("all kinds")
    given = inputs_of(fast.chain, 3)
    free = next(name for name in fast.chain.names if name not in fast.chain.grasps)
    given["grasp_wrench"][2, fast.chain.names.index(free), 1] = 1.0
    match = rf"grasp_wrench: arm '{free}' holds nothing, expected zeros, got \[0. 1. 0. 0. 0. 0.\]"
    with pytest.raises(StateError, match=match + "$"):
        called(fast, "inverse_dynamics", one(given, 2))
    with pytest.raises(StateError, match=match + " in system 2"):
        called(fast, "inverse_dynamics", given)
    called(fast, "inverse_dynamics", one(given, 1))


def test_fortran_order():
    """Arrays in any memory order, and lists, are taken as they read."""
    fast = named("all kinds")
    given = one(inputs_of(fast.chain, 1), 0)
    extra = one(parameters_of(fast.inverse_dynamics, 1), 0)
    expected = called(fast, "inverse_dynamics", given, **extra)
    turned = {name: np.asfortranarray(x) for name, x in extra.items()}
    listed = {name: x.tolist() for name, x in given.items()}
    assert same_bits(called(fast, "inverse_dynamics", listed, **turned), expected)
    turned = {name: np.asfortranarray([x, x]) for name, x in extra.items()}
    assert same_bits(one(called(fast, "inverse_dynamics", given, **turned), 1), expected)


def test_jacobian_that_nothing_changes():
    """A gantry's Jacobian depends on its base alone: no input of a call has a part in it."""
    x, y, none = np.eye(3)[0], np.eye(3)[1], np.zeros(2)
    joints = [holdfast.Joint("prismatic", x), holdfast.Joint("prismatic", y)]
    gantry = holdfast.Arm(joints, [holdfast.Link(1.0, inertia=np.eye(3))] * 2)
    box = holdfast.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    chain = holdfast.ClosedChain({"gantry": gantry}, box, {"gantry": holdfast.Grasp("rigid")})
    compiled = holdfast.compile(chain)
    expected = holdfast.dynamics.tip_jacobian(gantry, none)
    np.testing.assert_array_equal(compiled.jacobian(none)["gantry"], expected)
    np.testing.assert_array_equal(compiled.jacobian(np.zeros((3, 2)))["gantry"], [expected] * 3)


def test_mobility_that_nothing_changes():
    """A rigid object on three slides moves as its mass and those of the links above each slide allow, wherever it is.

    The filter reads what depends on parameters only from groups that nothing else calls.
    """
    slides = [holdfast.Joint("prismatic", axis) for axis in np.eye(3)]
    gantry = holdfast.Arm(slides, [holdfast.Link(m, inertia=np.eye(3)) for m in (1.0, 2.0, 4.0)])
    box = holdfast.HeldObject.box(8.0, 0.1, 0.1, 0.1)
    chain = holdfast.ClosedChain({"gantry": gantry}, box, {"gantry": holdfast.Grasp("rigid")})
    moved = [0.3, -0.2, 0.1]
    found = holdfast.compile(chain).object_mobility(moved, [1.0, 0.0, 0.0, 0.0, *moved])
    np.testing.assert_allclose(found, np.diag([0.0, 0.0, 0.0, 1 / 15, 1 / 14, 1 / 12]), atol=1e-15)
