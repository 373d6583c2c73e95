"""`sequential` keeps its digits, by the reference and by machine code; what is singular is refused and nothing else.

Light and heavy objects, nearly straight arms, far-off points, constantly low rank: against 50 digits.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

import holdfast
from holdfast import Inputs, State
from holdfast.dynamics import METHODS, Status
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import constraint_rows
from holdfast.errors import SingularChainError
from tests.acceptance.comparison import errors, relative
from tests.compiled.problems import answer, compiled_for
from tests.dynamics.test_half_turn import excess
from tests.longer import mostly_slow
from tests.oracles.arithmetic import arithmetic
from tests.oracles.maximal_kkt import KktSystem, solve
from tests.systems import (
    one_straight_arm_of_three,
    planar_parallelogram,
    planar_three_arms,
    two_collinear_stretched_6r,
    well_conditioned_system,
)
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import CASES
from tests.systems.right_angle_systems import right_angle_system

DIGITS = 50
TOLERANCE = 1e-12
GRASPS = {
    "rigid": ["rigid", "rigid", "rigid"],
    "mixed": ["rigid", "hinge", "ball"],
    "rigid last": ["softfinger", "hinge", "rigid"],
    "no rigid": ["softfinger", "ball", "hinge"],
    "balls": ["ball", "ball", "ball"],
}
OUT_OF_PLANE = (0, 1, 5)  # moments about x and y, force along z

Solver = Callable[..., object]


def by_machine_code() -> Solver:
    """Return forward dynamics by machine code, which is kept as long as this function is."""
    kept = []

    def solved(p: Problem, route: str = "auto"):
        fast, given = compiled_for(p, method=route)
        kept.append(fast)
        return fast.forward_dynamics(**given)

    return solved


@pytest.fixture(params=["reference", pytest.param("machine code", marks=pytest.mark.long)])
def solver(request) -> Solver:
    """Forward dynamics of a problem."""
    return Problem.solved if request.param == "reference" else by_machine_code()


def worst_errors(solver: Solver, cases) -> dict[str, float]:
    """Return the relative errors of `sequential` by both routes against 50 digits, the worst of some cases."""
    each = []
    for case in cases:
        answer, p = solve(case, digits=DIGITS), as_chain(case)
        each += [errors(solver(p, route=route), answer) for route in ("mass_matrix", "recursive")]
    return {key: max(e[key] for e in each) for key in each[0]}


def over_seeds(solver: Solver, seeds: range, **options) -> dict[str, float]:
    """Return the worst errors over well-conditioned random systems; of machine code the first, each is to compile."""
    seeds = seeds if solver is Problem.solved else seeds[:1]
    return worst_errors(solver, (well_conditioned_system(seed, **options) for seed in seeds))


def show(what: str, worst: dict[str, float]) -> None:
    """Print the worst errors."""
    print(f"\n{what}: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()), end="")


@pytest.mark.parametrize("scale", mostly_slow([1e-8, 1e-4, 1.0, 1e2, 1e8], (1e-8, 1e8)))
@pytest.mark.parametrize("grasps", GRASPS)
def test_object_mass_does_not_cost_digits(scale, grasps):
    """Object mass and inertia from 1e-8 to 1e8 of the usual: <= 1e-12 (every Lambda_i regular)."""
    worst = over_seeds(Problem.solved, range(1), grasps=GRASPS[grasps], joints=7, object_scale=scale)
    assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("grasps", GRASPS)
def test_object_mass_sweep(solver, grasps):
    """The same over every decade from 1e-8 to 1e8 and ten seeds, printed."""
    for scale in 10.0 ** np.arange(-8, 9):
        worst = over_seeds(solver, range(10), grasps=GRASPS[grasps], joints=7, object_scale=float(scale))
        show(f"object x {scale:.0e}, {grasps}", worst)
        assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("arm_count", [1, 2, 5])
def test_light_object_any_arms(solver, arm_count):
    """Objects from 1e-8 to 1e2 of the usual mass, arms of 3 to 12 joints, condition < 1e3: <= 1e-12."""
    for scale in (1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2):
        worst = over_seeds(solver, range(8), arms=arm_count, grasps="rigid", object_scale=scale, limit=1e3)
        show(f"object x {scale:.0e}, {arm_count} arms", worst)
        assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("scale", [1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2])
def test_stored_cases_of_any_mass(solver, scale):
    """Every stored rigid or mixed case with the object scaled: <= 1e-12."""
    worst = {}
    for name, case in copy.deepcopy(CASES).items():
        kinds = {arm["grasp"]["type"] for arm in case["arms"]}
        if case["tags"]["f_unique"] and (kinds == {"rigid"} or len(kinds) > 1):
            case["object"]["mass"] *= scale
            case["object"]["inertia"] = (scale * np.array(case["object"]["inertia"])).tolist()
            worst[name] = max(worst_errors(solver, [case]).values())
    name = max(worst, key=worst.__getitem__)
    print(f"\n{len(worst)} cases, object x {scale:.0e}: worst {worst[name]:.1e} ({name})", end="")
    assert worst[name] <= TOLERANCE


@pytest.mark.parametrize("which", [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2)])
def test_nearly_straight_arms(which):
    """One arm of three (first, middle, last) or two, 1e-6 rad from straight: <= 1e-12."""
    worst = worst_errors(Problem.solved, [one_straight_arm_of_three(1e-6, which)])
    assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("joints", [(6, 6, 6), (7, 7, 7)])
@pytest.mark.parametrize("which", [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2)])
def test_straight_arm_sweep(solver, which, joints):
    """Bends from 0.1 rad to exactly straight: <= 1e-12 throughout, printed."""
    seeds = range(3 if solver is Problem.solved else 1)
    for bend in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 0.0):
        worst = worst_errors(solver, (one_straight_arm_of_three(bend, which, seed, joints) for seed in seeds))
        show(f"arms {which} of {joints}, bend {bend:.0e}", worst)
        assert max(worst.values()) <= TOLERANCE


@pytest.mark.parametrize(
    "options",
    [
        {"com_offset": 1.0},
        {"world_offset": (20.0, -15.0, 10.0)},
        {"angle_scale": 100.0},
        {"moving_base": True, "base_speed": 5.0},
        {"joint_speed": 10.0},
    ],
    ids=lambda options: next(iter(options)),
)
@pytest.mark.parametrize("grasps", [None, "rigid"])
def test_stretched_systems(solver, options, grasps):
    """C a metre off, contacts 20 m from the origin, angles of 100 rad, fast bases and joints: <= 1e-11."""
    worst = over_seeds(solver, range(3), grasps=grasps, **options)
    assert max(worst.values()) <= 1e-11


def planar_answer(case: dict) -> np.ndarray:
    """Return qdd and alpha_C of a planar chain in 50 digits: one grasp is enough out of the plane."""
    numbers = arithmetic(DIGITS)
    with numbers.precision():
        system = KktSystem(case, numbers)
        extra = {part.start + i for part in system.f[1:] for i in OUT_OF_PLANE}
        keep = [i for i in range(system.size) if i not in extra]
        x = numbers.solve(system.matrix[np.ix_(keep, keep)], system.rhs[keep])
    wanted = [i for part in (*system.qdd, system.alpha) for i in range(part.start, part.stop)]
    return np.array([float(x[keep.index(i)]) for i in wanted])


@pytest.mark.parametrize("method", METHODS)
def test_flat_parallelogram_is_refused(method):
    """At the flat position the rank drops: every method refuses."""
    with pytest.raises(SingularChainError, match="rank 8 of 12 here, but 9 nearby"):
        as_chain(planar_parallelogram(0.0)).solved(method=method)


@pytest.mark.parametrize("angle", [0.5, 1e-1, 1e-2, 1e-3])
def test_parallelogram_near_flat_is_solved(solver, angle):
    """Down to 1e-3 rad from flat it is solved, to 1e-8."""
    case = planar_parallelogram(angle)
    result = solver(as_chain(case))
    assert result.status is Status.INDETERMINATE_FORCES
    assert relative(np.r_[result.qdd, result.object_acceleration], planar_answer(case)) <= 1e-8


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("seed", mostly_slow(range(4), (0,)))
def test_planar_three_arms_are_never_refused(solver, seed, tilted):
    """Rank 12 of 18 everywhere: accelerations are right and f is said to be the smallest."""
    case = planar_three_arms(seed, tilted=tilted)
    result = solver(as_chain(case))
    assert result.status is Status.INDETERMINATE_FORCES
    assert "smallest" in result.status.value
    assert result.rank == 12
    if not tilted:
        assert relative(np.r_[result.qdd, result.object_acceleration], planar_answer(case)) <= 1e-10


@pytest.mark.parametrize("opposed", [True, False])
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2))])
def test_collinear_stretched_arms_are_refused(solver, seed, opposed):
    """Two 6R arms stretched along one line: refused, moving or at rest."""
    case = two_collinear_stretched_6r(seed, opposed)
    with pytest.raises(SingularChainError):
        solver(as_chain(case))
    for arm in case["arms"]:
        arm["qd"] = [0.0] * 6
    case["object"] |= {"omega": [0.0] * 3, "v": [0.0] * 3}
    with pytest.raises(SingularChainError):
        solver(as_chain(case))


@pytest.mark.parametrize("which", [(0,), (2,), (0, 1)])
def test_straight_arms_among_three_are_not_singular(solver, which):
    """One or two straight arms of three leave the chain regular."""
    result = solver(as_chain(one_straight_arm_of_three(0.0, which)))
    assert result.status is Status.OK
    assert result.rank == 18


@pytest.mark.slow
def test_machine_code():
    """In short: a light object, a parallelogram 1e-3 rad from flat and flat, two straight arms of three."""
    solver = by_machine_code()
    worst = over_seeds(solver, range(1), grasps=["hinge", "rigid", "rigid"], joints=6, object_scale=1e-8)
    assert max(worst.values()) <= TOLERANCE
    test_parallelogram_near_flat_is_solved(solver, 1e-3)
    with pytest.raises(SingularChainError, match="rank 8 of 12 here, but 9 in general"):
        solver(as_chain(planar_parallelogram(0.0)))
    test_straight_arms_among_three_are_not_singular(solver, (0, 1))


CHUNKS, EACH = 20, 500
COMPILED_EVERY = 20  # every compiled chain is another code: half a second


@pytest.mark.long
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_right_angles(chunk, monkeypatch):
    """All answers within 1e-9 or the rounding of Lambda (other methods: 1e-7), or refused by name; counts printed."""
    monkeypatch.setenv("HOLDFAST_CACHE", "off")  # thousands of chains, each of which is met once
    seen: Counter[str] = Counter()
    worst: dict[str, float] = {}

    def note(what: str, error: float) -> None:
        seen[what] += 1
        worst[what] = max(worst.get(what, 0.0), error)

    for seed in range(chunk * EACH, (chunk + 1) * EACH):
        p = right_angle_system(seed)
        try:
            found = holdfast.forward_dynamics(p.chain, p.state, p.tau)
        except holdfast.errors.SingularChainError:
            seen["singular"] += 1
            continue
        seen[found.status.name] += 1
        error = excess(p, give=0.0) * 1e-9
        note("sequential" if error <= 1e-9 else "sequential, rounding of Lambda", error)
        assert error <= 1e-9 or excess(p) <= 1.0, seed
        for name, error in _other_methods(p, found):
            assert error <= 1e-7, (seed, name)
            note(name, error)
        if seed % COMPILED_EVERY == 0:
            note("machine code", _compiled(p, found))
        for name, error in (("split", _split(p, found)), ("held", _held(p)), ("projected", _projected(p))):
            assert error <= 1e-8, (seed, name)
            note(name, error)
    print(f"\nchunk {chunk}: {dict(seen)}\n  worst: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()), end="")
    assert worst["machine code"] <= 1e-9


def _other_methods(p: Problem, found: holdfast.dynamics.ForwardResult) -> list[tuple[str, float]]:
    """Return the differences of the other methods that answer; forces only where they are unique."""
    errors = []
    for name in METHODS:
        if name == "sequential":
            continue
        try:
            other = holdfast.forward_dynamics(p.chain, p.state, p.tau, method=name)
        except holdfast.errors.MethodNotApplicable:
            continue
        errors.append((name, relative(other.qdd, found.qdd, floor=1.0)))
    return errors


def _compiled(p: Problem, found: holdfast.dynamics.ForwardResult) -> float:
    """Return what machine code differs by; status and rank must agree."""
    fast = answer(p)
    assert (fast.rank, fast.status) == (found.rank, found.status)
    return relative(fast.qdd, found.qdd, floor=1.0)


def _split(p: Problem, found: holdfast.dynamics.ForwardResult) -> float:
    """Return how much of the internal part could be taken from the motion part, which is the smallest."""
    parts = holdfast.forces.split(p.chain, p.state, found.grasp_wrench)
    metric = np.r_[np.full(3, 1 / parts.length), np.ones(3)]
    motion, internal = parts.motion * metric, parts.internal * metric
    size = max(1.0, float(np.abs([motion, internal]).max()))  # contacts 3 mm apart: both are thousands of newtons
    return abs(float((motion * internal).sum())) / size**2  # the smallest is orthogonal to all that move nothing


def _held(p: Problem) -> float:
    """Return the accelerations left under holding torques, 0 where no torques hold."""
    still = State(p.state.q, np.zeros(p.chain.joint_count), p.state.object_pose)
    try:
        tau = holdfast.holding_torques(p.chain, still)
        found = holdfast.forward_dynamics(p.chain, still, tau)
    except (holdfast.errors.StateError, holdfast.errors.SingularChainError):
        return 0.0
    return float(np.abs(found.qdd).max()) / max(1.0, float(np.abs(tau).max()))


def _projected(p: Problem) -> float:
    """Return what projected velocities still mismatch, and by how much they are not the nearest."""
    random = np.random.default_rng(3)
    wild = State(p.state.q, random.normal(size=p.chain.joint_count), p.state.object_pose, random.normal(size=6))
    near = holdfast.dynamics.project_velocity(p.chain, wild)
    motion = chain_motion(p.chain, near, np.zeros(p.chain.joint_count), Inputs().shaped(p.chain))
    rows = constraint_rows(motion)
    gap = rows.joints @ near.qd + rows.object @ near.object_twist
    again = holdfast.dynamics.project_velocity(p.chain, near)
    return float(max(np.abs(gap).max(), np.abs(again.qd - near.qd).max()))
