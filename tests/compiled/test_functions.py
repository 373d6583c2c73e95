"""The other compiled functions: inverse dynamics, mass matrices, poses, closure, projection, energies, momentum."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import FunctionType

import numpy as np
import pytest
from holdfast.compiled.arm_functions import COMPUTATIONS
from holdfast.compiled.functions import ChainFunctions

import holdfast
from holdfast import ClosedChain, Inputs, MethodNotApplicable, Pose, State, StateError
from holdfast.compiled import CompiledChain
from holdfast.compiled.not_compiled import REASONS
from holdfast.compiled.structure import Options
from holdfast.compiler.interpret import interpret_schedule
from holdfast.compiler.targets import cpu
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.projection import after_step
from holdfast.forces.wrist import across_tips
from holdfast.model.grasp import WrenchLimits
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from tests.compiled import problems
from tests.compiled.problems import chain_named, chain_of, compiled, numbers, one
from tests.dynamics.problems import CASES, random_problem, stored
from tests.surface import PUBLIC
from tests.systems.as_chain import Problem

BOUND = 1e-11
OF_FORCES = ("grasp_margins", "joint_margins", "wrist_wrenches")
ARGUMENTS = {
    "inverse_dynamics": ("q", "qd", "qdd", "grasp_wrench"),
    "grasp_margins": ("object_pose", "grasp_wrench"),
    "joint_margins": ("q", "qd", "tau"),
    "wrist_wrenches": ("q", "grasp_wrench"),
    "mass_matrix": ("q",),
    "jacobian": ("q",),
    "closure": ("q", "qd", "object_pose", "object_twist"),
    "kinetic_energy": ("q", "qd", "object_pose", "object_twist"),
    "potential_energy": ("q", "object_pose"),
    "momentum": ("q", "qd", "object_pose", "object_twist"),
    "centre_of_mass": ("q", "object_pose"),
    "object_mobility": ("q", "object_pose"),
    "tip_poses": ("q",),
    "link_poses": ("q",),
    "project": ("q", "qd", "object_pose", "object_twist"),
}
EVERY = list(ARGUMENTS)
# these compile the filter: elsewhere than against the reference it is the same machinery, and takes longest
functions = pytest.mark.parametrize(
    "function",
    [pytest.param(name, marks=pytest.mark.long) if name in ("project", "object_mobility") else name for name in EVERY],
)


def states(chain, batch: int, seed: int = 0) -> dict[str, Array]:
    """Return random inputs of all functions; arms that hold nothing bear nothing."""
    random = np.random.default_rng((seed, 2))
    f = 10.0 * random.normal(size=(batch, len(chain.arms), 6))
    for row, name in enumerate(chain.names):
        if name not in chain.grasps:
            f[:, row] = 0.0
    given = numbers(chain, batch, seed)
    return given | {"qdd": random.normal(size=(batch, chain.joint_count)), "grasp_wrench": f}


def parameters(chain, batch: int, seed: int = 0) -> dict[str, dict[str, Array]]:
    """Return random parameters of all functions, those that each takes."""
    random, n, l = np.random.default_rng((seed, 3)), chain.joint_count, len(chain.arms)

    def poses(count: int) -> Array:
        q = random.normal(size=(batch, count, 4))
        return np.concatenate([q / np.linalg.norm(q, axis=-1)[..., None], random.normal(size=(batch, count, 3))], -1)

    def spread(count: int) -> Array:
        return np.array([np.diag(x) for x in random.uniform(0.5, 0.9, (count, 3))])

    links = {
        "link_mass": random.uniform(0.1, 5.0, (batch, n)),
        "link_com": random.normal(size=(batch, n, 3)),
        "link_inertia": spread(batch * n).reshape(batch, n, 3, 3),
    }
    body = {
        "object_mass": random.uniform(0.1, 5.0, batch),
        "object_com": random.normal(size=(batch, 3)),
        "object_inertia": spread(batch),
    }
    base, twist = {"base_pose": poses(l)}, {"base_twist": random.normal(size=(batch, l, 6))}
    gravity = {"gravity": random.normal(size=(batch, 3))}
    moving = {"base_acceleration": random.normal(size=(batch, l, 6)), "link_wrench": random.normal(size=(batch, n, 6))}
    return {
        "inverse_dynamics": base | twist | gravity | moving | links,
        "grasp_margins": {"grasp_pose": poses(len(chain.grasps))},
        "joint_margins": {},
        "wrist_wrenches": base,
        "mass_matrix": links,
        "jacobian": base,
        "closure": base | twist | {"grasp_pose": poses(len(chain.grasps))},
        "kinetic_energy": base | twist | body | links,
        "potential_energy": base | gravity | body | links,
        "momentum": base | twist | body | links | {"about": random.normal(size=(batch, 3))},
        "centre_of_mass": base | body | links,
        "object_mobility": base | body | links | {"grasp_pose": poses(len(chain.grasps))},
        "tip_poses": base,
        "link_poses": base,
        "project": twist | body | links,
    }


def called(fast: ChainFunctions, function: str, given: dict[str, Array], **options) -> dict[str, Array]:
    """Return a function's results as arrays by name."""
    found = getattr(fast, function)(*(given[name] for name in ARGUMENTS[function]), **options)
    if function == "joint_margins":
        return found._asdict()
    if not isinstance(found, dict):
        return {"": np.asarray(found)}
    if function not in ("closure", "tip_poses", "link_poses"):
        return found
    return {f"{arm}.{field}": x for arm, gap in found.items() for field, x in gap._asdict().items()}


def reference(
    chain, function: str, given: dict[str, Array], inputs: Inputs | None = None, about: Array | None = None
) -> dict[str, Array]:
    """Return the same by the reference, for one system."""
    inputs = inputs or Inputs()
    state = State(*(given[name] for name in ("q", "qd", "object_pose", "object_twist")))
    if function == "inverse_dynamics":
        return {"": holdfast.inverse_dynamics(chain, state, given["qdd"], given["grasp_wrench"], inputs)}
    if function == "grasp_margins":
        return {"": holdfast.forces.grasp_margins(chain, state, given["grasp_wrench"])}
    if function == "joint_margins":
        return holdfast.forces.joint_margins(chain, state, given["tau"])._asdict()
    if function == "wrist_wrenches":
        return {"": across_tips(chain, state, given["grasp_wrench"])}
    if function == "closure":
        gaps = holdfast.dynamics.closure(chain, state, inputs)
        return {f"{arm}.{field}": x for arm, gap in gaps.items() for field, x in gap._asdict().items()}
    if function == "kinetic_energy":
        return {"": np.array(holdfast.dynamics.kinetic_energy(chain, state, inputs))}
    if function == "potential_energy":
        return {"": np.array(holdfast.dynamics.potential_energy(chain, state))}
    if function == "momentum":
        return {"": holdfast.dynamics.momentum(chain, state, about, inputs)}
    if function in ("centre_of_mass", "object_mobility"):
        return {"": getattr(holdfast.dynamics, function)(chain, state)}
    if function == "project":
        found = after_step(chain, state, inputs.shaped(chain))
        return {name: getattr(found, name) for name in ARGUMENTS[function]}
    if function == "tip_poses":
        tips = {name: holdfast.dynamics.tip_pose(arm, state.q[chain.joints[name]]) for name, arm in chain.arms.items()}
        return {f"{name}.{field}": getattr(tip, field) for name, tip in tips.items() for field in ("R", "p")}
    if function == "link_poses":
        links = {
            name: holdfast.dynamics.link_poses(arm, state.q[chain.joints[name]]) for name, arm in chain.arms.items()
        }
        stacked = {
            name: {field: np.array([getattr(x, field) for x in of]) for field in "Rp"} for name, of in links.items()
        }
        return {f"{name}.{field}": x for name, of in stacked.items() for field, x in of.items()}
    at = {name: forward_kinematics(arm, state.q[chain.joints[name]]) for name, arm in chain.arms.items()}
    if function == "mass_matrix":
        return {name: mass_matrix(arm, at[name])[0] for name, arm in chain.arms.items()}
    return {name: jacobian(arm, at[name]) for name, arm in chain.arms.items()}


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


def rows(found: dict[str, Array], i: int) -> dict[str, Array]:
    """Return the i-th system's results."""
    return {name: x[i] for name, x in found.items()}


def stacked(found: list[dict[str, Array]]) -> dict[str, Array]:
    """Return the results of many systems as those of a batch."""
    return {name: np.stack([each[name] for each in found]) for name in found[0]}


def problem_given(problem: Problem, seed: int) -> tuple[dict[str, Array], dict[str, dict[str, Array]]]:
    """Return inputs and parameters of a problem, with random accelerations and grasp wrenches."""
    s, i = problem.state, problem.inputs.shaped(problem.chain)
    random = one(states(problem.chain, 1, seed), 0)
    given = random | {"q": s.q, "qd": s.qd, "object_pose": s.object_pose, "object_twist": s.object_twist}
    twist = {"base_twist": i.base_twists}
    inverse = twist | {"base_acceleration": i.base_accelerations, "link_wrench": i.link_wrenches}
    moving = dict.fromkeys(("closure", "kinetic_energy", "momentum", "project"), twist)
    return given, moving | {"inverse_dynamics": inverse}


@cache
def alone(chain: ClosedChain, link_inertia: bool = False) -> ChainFunctions:
    """Return the functions without forward dynamics, which takes longest to compile."""
    made = ChainFunctions()
    made.chain, made.options = chain, Options("auto", link_inertia, link_wrenches=True)
    return made


def named(name: str) -> ChainFunctions:
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
    given, extra = problem_given(problem, seed)
    fast = alone(problem.chain)
    found = called(fast, function, given, **extra.get(function, {}))
    return gap(found, reference(problem.chain, function, given, problem.inputs))


def stored_names():
    """Return the stored cases; one of them is quick, and `test_random_systems` has every kind of arm and grasp."""
    sample = ("legs_3_RRP_ball_moving_base",)
    assert set(sample) <= set(CASES)
    return [pytest.param(name, marks=[] if name in sample else pytest.mark.long) for name in CASES]


@pytest.mark.parametrize("name", stored_names())
def test_stored_cases(name):
    """All functions agree with the reference on every stored case."""
    for function in EVERY:
        assert disagreement(stored(name), function) < BOUND, function


@pytest.mark.parametrize("function", EVERY)
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2))])
def test_random_systems(function, seed):
    """Every grasp kind, an arm without one, prismatic joints, moving bases, wrenches on the links."""
    grasps = ("rigid", "hinge", None, "softfinger", "ball")
    problem = random_problem(seed, grasps=grasps, joints=(6, 5, 3, 4, 3), moving_base=True)
    kinds = {joint.kind for arm in problem.chain.arms.values() for joint in arm.joints}
    assert kinds == {"revolute", "prismatic"}
    assert disagreement(problem, function, seed) < BOUND


@pytest.mark.parametrize("function", [name for name in EVERY if name not in ("object_mobility", "project")])
@pytest.mark.parametrize("name", ["interleaved", "all kinds", "nobody holds", "nine"])
def test_open_states(function, name):
    """States far from closed, arms of one type apart from each other in order, no grasps at all.

    The grasps' own equations may be singular there: for what solves them these are no states.
    """
    fast = named(name)
    chain, given = fast.chain, states(fast.chain, 5)
    found = called(fast, function, given)
    for i in range(5):
        here = rows(found, i) if chain.grasps or function != "closure" else found
        assert gap(here, reference(chain, function, one(given, i))) < BOUND


@functions
def test_batch_is_single(function):
    """Batches of every size, on any number of threads, have the bits of single calls."""
    fast = named("all kinds")
    lanes = cpu.lanes()
    given, extra = states(fast.chain, 2 * lanes + 3), parameters(fast.chain, 2 * lanes + 3)[function]
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
    given, extra = states(fast.chain, batch), parameters(fast.chain, batch)[function]
    for varied in (*ARGUMENTS[function], *extra):
        now = {name: x if name == varied else x[0] for name, x in given.items()}
        of = {name: x if name == varied else x[0] for name, x in extra.items()}
        found = called(fast, function, now, **of)
        for i in (0, 1, batch - 1):
            single = called(
                fast,
                function,
                {name: x[i] if name == varied else x for name, x in now.items()},
                **{name: x[i] if name == varied else x for name, x in of.items()},
            )
            assert same_bits(rows(found, i), single)


@functions
@pytest.mark.parametrize("name", [pytest.param("all kinds", marks=pytest.mark.long), "interleaved"])
def test_run_time_parameters(function, name):
    """Parameters of a call give what a chain built with them gives, and the next call has the chain's own again."""
    fast = named(name)
    given = one(states(fast.chain, 1), 0)
    extra = one(parameters(fast.chain, 1)[function], 0)
    own = called(fast, function, given)
    found = called(fast, function, given, **extra)
    chain = built_with(fast.chain, extra)
    inputs = Inputs(None, extra.get("link_wrench"), extra.get("base_twist"), extra.get("base_acceleration"))
    assert gap(found, reference(chain, function, given, inputs, extra.get("about"))) < BOUND
    again = alone(chain)
    acting = {k: x for k, x in extra.items() if k in ("about", "link_wrench", "base_twist", "base_acceleration")}
    assert gap(found, called(again, function, given, **acting)) < 1e-12
    assert same_bits(called(fast, function, given), own)
    assert same_bits(found, own) == (not extra)


def built_with(chain, extra: dict[str, Array]):
    """Return the chain with parameters built in."""
    arms = dict(chain.arms)
    if "base_pose" in extra:
        arms = {name: arm.at(pose) for (name, arm), pose in zip(arms.items(), extra["base_pose"], strict=True)}
    if "link_mass" in extra:
        for name, arm in arms.items():
            part = chain.joints[name]
            of = zip(*(extra[k][part] for k in ("link_mass", "link_com", "link_inertia")), strict=True)
            arms[name] = replace(arm, links=[holdfast.Link(m, com, I) for m, com, I in of])
    grasps = dict(chain.grasps)
    if "grasp_pose" in extra:
        poses = zip(grasps.items(), extra["grasp_pose"], strict=True)
        grasps = {name: replace(grasp, frame=pose) for (name, grasp), pose in poses}
    held = chain.held_object
    if "object_mass" in extra:
        held = holdfast.HeldObject(extra["object_mass"], extra["object_inertia"], extra["object_com"])
    return holdfast.ClosedChain(arms, held, grasps, extra.get("gravity", chain.gravity))


@functions
def test_interpreter(function):
    """The schedule read number by number gives the bits of the machine code."""
    chain, computation = chain_named("all kinds"), COMPUTATIONS[function]
    structure = computation.structure(chain, Options(link_wrenches=True))
    made = alone(chain)._function(function)
    given = one(states(chain, 1), 0)
    inputs = tuple(given[name] for name in computation.inputs)
    expected = interpret_schedule(computation.schedule(structure), made._own | given)
    assert same_bits(made(inputs, {}, 1), expected)


@pytest.mark.parametrize("name", ["two", "all kinds", "rows first"])
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
    given = one(states(fast.chain, 1), 0)
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
    given = states(fast.chain, 4)
    M = fast.mass_matrix(given["q"])
    T = fast.kinetic_energy(given["q"], given["qd"], given["object_pose"], np.zeros(6))
    expected = sum(
        0.5 * np.einsum("bi,bij,bj->b", given["qd"][:, part], M[name], given["qd"][:, part])
        for name, part in fast.chain.joints.items()
    )
    np.testing.assert_allclose(T, expected, rtol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0, np.pi - 1e-6, np.pi])
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
    counts = {name: len(c.structure(chain, Options()).types) for name, c in COMPUTATIONS.items()}
    assert counts == {name: 3 if c.by_grasp else 1 for name, c in COMPUTATIONS.items()}
    arms = dict(chain.arms)
    heavy = [holdfast.Link(2 * link.mass, link.com, 2 * link.inertia) for link in arms["arm0"].links]
    arms["arm0"] = replace(arms["arm0"], links=heavy)
    other = replace(chain, arms=arms)
    for name, c in COMPUTATIONS.items():
        same = c.structure(chain, Options()).key == c.structure(other, Options()).key
        assert same == (name in ("jacobian", "closure", "tip_poses", "link_poses", *OF_FORCES))


def test_every_function_of_the_dynamics():
    """All that is public is compiled, or says by name why it is not, and what there is."""
    rooms = ("holdfast.dynamics.", "holdfast.forces.")
    public = {path: verb for path, verb in PUBLIC.items() if isinstance(verb, FunctionType)}
    verbs = {path for path, verb in public.items() if verb.__module__.startswith(rooms)}
    verbs |= {"holding_torques", "linearise"}
    last = {path: path.rpartition(".")[2] for path in verbs}
    compiled_too = {path for path in verbs if callable(getattr(CompiledChain, last[path], None))}
    assert verbs - compiled_too == set(REASONS)
    assert set(COMPUTATIONS) <= {last[path] for path in compiled_too} | {"mass_matrix", "jacobian", "tip_poses"}
    fast = named("all kinds")
    for path in REASONS:
        name = last[path]
        with pytest.raises(MethodNotApplicable, match=f"^compile: '{name}' runs as reference only: .*holdfast.{path} "):
            getattr(fast, name)
        assert not hasattr(fast, name)
    with pytest.raises(AttributeError, match="'ChainFunctions' object has no attribute 'dynamo'"):
        fast.dynamo  # noqa: B018


def test_made_when_needed():
    """Compiling a chain makes none of them; chains of one structure share them."""
    chain = chain_of(((3, "rigid"), (2, "ball")), seed=5)
    fast, other = holdfast.compile(chain), holdfast.compile(replace(chain, gravity=(0.0, 1.0, 2.0)))
    assert "_codes" not in vars(fast)
    q = np.zeros(5)
    pose = [1, 0, 0, 0, 0, 0, 1]
    assert fast.potential_energy(q, pose) != other.potential_energy(q, pose)
    assert set(vars(fast)["_codes"]) == {"potential_energy"}
    assert fast._function("potential_energy")._kernel is other._function("potential_energy")._kernel


def test_shapes():
    """Numbers and plain arrays for one system, a leading axis for a batch, a batch of none included."""
    fast = named("all kinds")
    given = one(states(fast.chain, 1), 0)
    for batch in (None, 0, 1, 3):
        now = given | {"q": given["q"] if batch is None else np.tile(given["q"], (batch, 1))}
        lead = () if batch is None else (batch,)
        assert called(fast, "inverse_dynamics", now)[""].shape == (*lead, fast.chain.joint_count)
        assert {k: x.shape for k, x in called(fast, "mass_matrix", now).items()} == {
            name: (*lead, arm.joint_count, arm.joint_count) for name, arm in fast.chain.arms.items()
        }
        assert called(fast, "jacobian", now)["arm0"].shape == (*lead, 6, fast.chain.arms["arm0"].joint_count)
        gaps = fast.closure(*(now[name] for name in ARGUMENTS["closure"]))
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
    given = one(states(fast.chain, 1), 0)
    for name in ARGUMENTS[function]:
        with pytest.raises(StateError, match=rf"{name}: expected shape \(.*\) or \(batch"):
            called(fast, function, given | {name: np.zeros(2)})
        with pytest.raises(StateError, match=f"{name}: expected real numbers"):
            called(fast, function, given | {name: np.full(np.shape(given[name]), 1j)})
    with pytest.raises(StateError, match="no parameter 'gravitas'"):
        called(fast, function, given, gravitas=1.0)
    with pytest.raises(StateError, match="no parameter 'object_wrench'"):
        called(fast, function, given, object_wrench=np.zeros(6))
    with pytest.raises(StateError, match="threads: expected an integer >= 1, got 0"):
        called(fast, function, given, threads=0)
    if len(ARGUMENTS[function]) > 1:
        first, *_, last = ARGUMENTS[function]
        with pytest.raises(StateError, match=f"expected one batch size, got {first}: 2, {last}: 3"):
            called(
                fast,
                function,
                given | {name: np.zeros((k, *np.shape(given[name]))) for name, k in ((first, 2), (last, 3))},
            )


@functions
def test_faulty_inputs(function):
    """One system with a faulty number is refused; in a batch its results alone are not-a-number."""
    fast = named("all kinds")
    given = states(fast.chain, 5)
    sound = called(fast, function, given)
    faults = [(name, value) for name in ARGUMENTS[function] for value in (np.nan, np.inf, -np.inf)]
    for name, value in [*faults, ("q", 1.1e5), ("q", -1.1e5), ("object_pose", 1.5)]:
        if name not in ARGUMENTS[function]:
            continue
        changed = given | {name: given[name].copy()}
        changed[name].reshape(5, -1)[3, 0] = value
        with pytest.raises(StateError, match=rf"^{name}: expected (finite numbers|at most 100000 rad|a unit quat)"):
            called(fast, function, one(changed, 3))
        with np.errstate(all="raise"):
            found = called(fast, function, changed)
        for k in sound:
            assert np.isnan(found[k][3]).all(), (k, name, value)
        for i in (0, 1, 2, 4):
            assert same_bits(rows(found, i), rows(sound, i))
        shared = given | {name: changed[name][3]}
        if len(ARGUMENTS[function]) > 1:
            assert all(np.isnan(x).all() for x in called(fast, function, shared).values())


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
    given = states(fast.chain, 3)
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
    given = one(states(fast.chain, 1), 0)
    extra = one(parameters(fast.chain, 1)["inverse_dynamics"], 0)
    expected = called(fast, "inverse_dynamics", given, **extra)
    turned = {name: np.asfortranarray(x) for name, x in extra.items()}
    listed = {name: x.tolist() for name, x in given.items()}
    assert same_bits(called(fast, "inverse_dynamics", listed, **turned), expected)
    batch = {name: np.stack([x, x]) for name, x in extra.items()}
    turned = {name: np.asfortranarray(x) for name, x in batch.items()}
    found = called(fast, "inverse_dynamics", given, **turned)
    assert same_bits(rows(found, 1), expected)


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
