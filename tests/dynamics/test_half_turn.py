"""Special configurations: grasps turned by half a turn, right angles, contacts on lines, point masses."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import holdfast
import holdfast as hf
from holdfast import ClosedChain, Grasp, HeldObject, Inputs, Pose, State
from holdfast.assembly.reaching_configurations import reaching_configurations
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import constraint_rows, coordinate_sizes
from holdfast.dynamics.projection import largest_gaps
from holdfast.dynamics.rank import constraint_rank
from holdfast.errors import ClosureError, StateError
from holdfast.robots import gen3, ur5e
from holdfast.simulation.rollout.traced_step import GRASP_OPEN
from holdfast.state import shaped_inputs
from tests.longer import mostly_long, mostly_slow
from tests.oracles.maximal_kkt import solve
from tests.systems.as_case import as_case
from tests.systems.as_chain import Problem, mounted
from tests.systems.lower_pairs import PITCH, grasp_of, pair
from tests.systems.problems import relative_gap
from tests.systems.right_angle_systems import RIGHT_ANGLES, right_angle_system

# Contact axes about which grasps are free to turn, or closed again after half a turn, as a cardan cross is.
FREE = {
    "rigid": "",
    "slider": "",
    "hinge": "x",
    "cylinder": "x",
    "screw": "x",
    "planar": "z",
    "two slides": "",
    "three slides": "",
    "scara": "z",
    "lead in a plane": "x",
    "softfinger": "xyz",
    "ball": "xyz",
    "universal": "xyz",
}
ANGLES = (np.pi, np.deg2rad(179.9999), np.deg2rad(120.0), np.deg2rad(95.0))
OFF = [(kind, axis) for kind, free in FREE.items() for axis in "xyz" if axis not in free]
STILL = [(kind, axis) for kind, free in FREE.items() for axis in free]


def turned(kind, axis, angle, grasp=None):
    """Return a chain of two arms at rest whose first grasp is closed but for a turn, and its state."""
    p = pair(("rigid", "rigid"), 4)
    turn = Rotation.from_rotvec(angle * np.eye(3)["xyz".index(axis)]).as_matrix()
    turn = np.round(turn) if angle == np.pi else turn  # exactly half a turn
    frame = p.chain.grasps["arm0"].frame
    contact = hf.Pose(frame.R @ turn.T, frame.p)
    grasps = {"arm0": grasp_of(kind, contact) if grasp is None else grasp(contact), "arm1": p.chain.grasps["arm1"]}
    chain = hf.ClosedChain(p.chain.arms, p.chain.held_object, grasps)
    assert Rotation.from_matrix(turn).magnitude() == pytest.approx(angle, abs=1e-9)
    return chain, hf.State(p.state.q, np.zeros(14), p.state.object_pose, np.zeros(6))


def opened(chain, state):
    """Return the angle of the smallest rotation between tip and contact frame that its kind does not leave free."""
    grasp = chain.grasps["arm0"]
    tip = hf.dynamics.tip_pose(chain.arms["arm0"], state.q[chain.joints["arm0"]]).R
    seen = (state.object_frame.R @ grasp.frame.R).T @ tip
    free = FREE.get(grasp.kind, "")
    if len(free) == 1:
        column = "xyz".index(free)
        return float(np.arctan2(np.linalg.norm(np.delete(seen[:, column], column)), seen[column, column]))
    return float(Rotation.from_matrix(seen).magnitude())


@pytest.mark.parametrize("angle", mostly_slow(ANGLES, ANGLES[1:3]))
@pytest.mark.parametrize(("kind", "axis"), OFF)
def test_measured(kind, axis, angle):
    """`closure` measures the angle; the measure of a step does to 0.16 rad, and exactly near half a turn."""
    chain, state = turned(kind, axis, angle)
    gap = hf.dynamics.closure(chain, state)["arm0"].position
    assert np.linalg.norm(gap[: 3 - len(FREE[kind])]) == pytest.approx(angle, abs=1e-7)
    found = largest_gaps(chain, state, shaped_inputs(chain, None)).position
    assert angle - 1e-7 <= found <= angle + max(1e-7, (np.pi - angle) ** 3 / 24)


@pytest.mark.parametrize("angle", mostly_slow(ANGLES, ANGLES[1:3]))
@pytest.mark.parametrize(("kind", "axis"), OFF)
def test_refused(kind, axis, angle):
    """`project` and `simulate` refuse it and say how open it is; `close` turns it all the way, or refuses it."""
    chain, state = turned(kind, axis, angle)
    with pytest.raises(ClosureError, match=rf"open by {angle:.3g} \(m or rad\)"):
        hf.project(chain, state)
    with pytest.raises(StateError, match=f"arm 'arm0': position gap {angle:.3g}"):
        hf.simulate(chain, state, hf.control.GravityCompensation(chain), duration=0.01, step=1e-3)
    try:
        closed = hf.close(chain, state, limits=False)
    except ClosureError:
        return
    if kind not in ("two slides", "three slides", "scara", "lead in a plane"):
        assert opened(chain, closed) < 1e-7


@pytest.mark.parametrize(("kind", "axis"), STILL)
def test_free_turns_stay_closed(kind, axis):
    """A turn that a grasp leaves free is no gap, however long; that of a screw counts along its thread."""
    chain, state = turned(kind, axis, np.pi)
    found = largest_gaps(chain, state, shaped_inputs(chain, None)).position
    expected = np.pi * PITCH if kind in ("screw", "lead in a plane") else 0.0
    assert found == pytest.approx(expected, rel=2e-3, abs=1e-8)
    assert np.abs(hf.dynamics.closure(chain, state)["arm0"].position).max() == pytest.approx(
        expected, rel=2e-3, abs=1e-8
    )


def test_a_fine_thread():
    """Half a turn past a thread of 2 mm per radian is 6 mm, less than a step may leave, but no step closes it."""
    chain, state = turned("screw", "x", np.pi, lambda contact: hf.Grasp("screw", contact, pitch=2e-3))
    with pytest.raises(ClosureError, match=r"open by 0\.00628"):
        hf.project(chain, state)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", mostly_long([kind for kind, free in FREE.items() if free != "xyz"], ("rigid", "screw"))
)
def test_compiled(kind):
    """Rollouts do not start there, because the grasps are open; what compiled `project` returns is not closed."""
    turns = [(axis, angle) for axis in "xyz" if axis not in FREE[kind] for angle in ANGLES]
    made = [turned(kind, *turn) for turn in turns]
    chain, state = made[0]
    poses = np.array([[grasp.frame.wxyz_xyz for grasp in one.grasps.values()] for one, _ in made])
    given = [np.tile(x, (len(made), 1)) for x in (state.q, state.qd, state.object_pose, state.object_twist)]
    rollout = hf.compile_rollout(chain, hf.control.GravityCompensation(chain))
    systems = rollout.start(*given, grasp_pose=poses)
    assert (systems.arrays["code"] == GRASP_OPEN).all()
    compiled = hf.compile(chain)
    there = compiled.project(*given, grasp_pose=poses)
    gaps = compiled.closure(**there, grasp_pose=poses)["arm0"].position
    near = np.array([angle for _, angle in turns]) > 3.0
    np.testing.assert_allclose(np.abs(gaps).max(axis=1)[near], np.pi, atol=1e-4)


@pytest.mark.parametrize("axis", "xyz")
def test_searched(axis):
    """A search for configurations does not take one that is half a turn off for reached."""
    chain, state = turned("rigid", axis, np.pi)
    arm, q = chain.arms["arm0"], state.q[chain.joints["arm0"]]
    for found in reaching_configurations(arm, chain.grasps["arm0"], state.object_frame, [q], q):
        tip = hf.dynamics.tip_pose(arm, found).R
        assert Rotation.from_matrix((state.object_frame.R @ chain.grasps["arm0"].frame.R).T @ tip).magnitude() < 1e-5


# Wrong by 1e-4 .. 1e5 when a pivot was judged by its own computed diagonal, status OK or INDETERMINATE_FORCES.
# 3931: refused as an overflow, where a grasp's row sees columns of the mobility by the rounding of zero only.
ONCE_WRONG = [6, 67, 73, 84, 164, 166, 168, 225, 232, 263, 315, 3931]


GIVE = 1e-16  # of the most that any tip gives way to a force: what Lambda is rounded by


def excess(p: Problem, give: float = GIVE, **options) -> float:
    """Return the largest error against 50 digits, in parts of 1e-9; 1 where the chain is singular and refused.

    A moment about an axis that nothing resists is only as exact as forces and levers are, which a small inertia
    makes a large acceleration: 1e-15 of the largest force at 1 m is granted. And Lambda rounds to 1e-16 of its
    largest entry, so that a tip that cannot move gives by as much: granted is what grasps that give by `give` of
    Lambda change in the exact answer. It matters for a few in 10,000, whose forces are thousands of newtons.
    """
    try:
        found = holdfast.forward_dynamics(p.chain, p.state, p.tau, **options)
    except holdfast.errors.SingularChainError:
        return 1.0
    unique = found.status is holdfast.dynamics.Status.OK
    case, softness = as_case(p.chain, p.state, p.tau), 0.0 if unique else 1e-20
    answer = solve(case, digits=50, softness=softness)
    f = np.array(answer["f"]) if unique else found.grasp_wrench
    spin = 1e-15 * np.abs(f).max() / np.linalg.eigvalsh(p.chain.held_object.inertia)[0]
    exact = (np.concatenate(answer["qdd"]), f, answer["alpha_C"])
    ours = (found.qdd, found.grasp_wrench, found.object_acceleration)

    def largest(granted: tuple[float, ...]) -> float:
        sizes = [1e-9 * max(1.0, np.abs(x).max()) + more for x, more in zip(exact, granted, strict=True)]
        return max(float(np.abs(x - y).max() / size) for x, y, size in zip(ours, exact, sizes, strict=True))

    error = largest((0.0, 0.0, spin))
    if error <= 1.0 or not give:
        return error
    mobile = max(np.linalg.norm(J @ np.linalg.solve(M, J.T), 2) for M, J in zip(answer["M"], answer["J"], strict=True))
    soft = solve(case, digits=50, softness=softness + give * mobile)
    changed = (np.concatenate(soft["qdd"]), np.array(soft["f"]) if unique else f, soft["alpha_C"])
    qdd, wrench, alpha = (float(np.abs(x - y).max()) for x, y in zip(changed, exact, strict=True))
    return largest((qdd, wrench, alpha + spin))


@pytest.mark.parametrize("seed", ONCE_WRONG)
def test_forward_dynamics(seed):
    """Accelerations and forces at right angles are those of 50 digits, by both routes."""
    p = right_angle_system(seed)
    assert max(excess(p, route=route) for route in ("mass_matrix", "recursive")) <= 1.0


@pytest.mark.parametrize("tilt", [0.0, 1e-7, 3.7e-6, 1e-4])
def test_rank(tilt):
    """The rank is that of singular values, also where right angles are off (1.5708 in a file: 3.7e-6 rad)."""
    for seed in range(25):
        p = right_angle_system(seed, tilt)
        motion = chain_motion(p.chain, p.state, p.tau, Inputs().shaped(p.chain))
        rows = constraint_rows(motion)
        sizes = np.linalg.svd(np.hstack([rows.joints, rows.object]) * coordinate_sizes(motion), compute_uv=False)
        rank = constraint_rank(p.chain, p.state) - p.chain.contact_freedom_count
        assert (sizes > 1e-4 * sizes[0]).sum() <= rank <= (sizes > 1e-9 * sizes[0]).sum(), seed


@pytest.mark.parametrize("kind", ["ball", "hinge", "softfinger"])
@pytest.mark.parametrize("robot", [ur5e, gen3])
def test_rigid_then_another(robot, kind):
    """An arm at right angles that holds rigidly, then one by another grasp: as the dense equations say."""
    random, answered = np.random.default_rng(1), 0
    for turns in list(product([-1, 0, 1], repeat=3))[::2]:
        q = np.zeros(robot().joint_count)
        q[:6] = 0.5 * np.pi * np.array([turns[0], turns[1], turns[2], turns[1], turns[0] or 1, turns[2]])
        other = random.uniform(-1, 1, len(q))
        at = Pose(RIGHT_ANGLES[random.integers(24)], [0.4, 0.0, 0.5])
        grasps = {
            "first": Grasp("rigid", Pose(np.eye(3), [0.2, 0, 0])),
            "second": Grasp(kind, Pose(np.eye(3), [-0.2, 0, 0])),
        }
        arms, both = {"first": robot(), "second": robot()}, np.r_[q, other]
        chain = mounted(ClosedChain(arms, HeldObject.box(3.0, 0.3, 0.2, 0.2), grasps), both, at)
        state = State(both, np.zeros(2 * len(q)), at.wxyz_xyz)
        tau = random.normal(size=2 * len(q))
        try:
            found = holdfast.forward_dynamics(chain, state, tau)
            dense = holdfast.forward_dynamics(chain, state, tau, method="kkt")
        except holdfast.HoldfastError:
            continue
        answered += 1
        for field in ("qdd", "grasp_wrench", "object_acceleration"):
            assert relative_gap(getattr(found, field), getattr(dense, field), floor=1.0) < 1e-9
    assert answered > 5


@pytest.mark.parametrize("inertia", [1e-6, 1e-10, 1e-13, 1e-16])
@pytest.mark.parametrize("com", [[0, 0, 0], [0.1, 0, 0], [0.03, -0.05, 0.2]])
def test_point_mass(inertia, com):
    """A point mass on a frame has unique forces and the accelerations of 50 digits."""
    for seed in (2, 11, 12):
        p = right_angle_system(seed)
        held = HeldObject(2.0, inertia * np.eye(3), com, physical=False)
        chain = ClosedChain(p.chain.arms, held, p.chain.grasps, p.chain.gravity)
        assert excess(Problem(chain, p.state, p.tau, p.inputs)) <= 1.0
        known = ClosedChain(p.chain.arms, HeldObject(2.0, 1e-2 * np.eye(3), com), p.chain.grasps)
        assert constraint_rank(chain, p.state) == constraint_rank(known, p.state)


def test_smallest_wrenches():
    """The motion part is the smallest wrench with the same effect, contacts on a line included."""
    random = np.random.default_rng(5)
    for _ in range(60):
        chain, state = _on_a_line(random)
        f = random.normal(size=(len(chain.arms), 6))
        for row, grasp in zip(f, chain.grasps.values(), strict=True):
            turn = state.object_frame.R @ grasp.frame.R
            kept = [turn.T @ row[:3], turn.T @ row[3:]]
            kept = np.concatenate(kept) * [float(i in grasp.transmitted) for i in range(6)]
            row[:] = np.concatenate([turn @ kept[:3], turn @ kept[3:]])
        found = holdfast.forces.split(chain, state, f)
        smallest = _by_singular_values(chain, state, f, found.length)
        assert np.abs(found.motion - smallest).max() < 1e-9 * max(1.0, np.abs(f).max())


def _on_a_line(random: np.random.Generator) -> tuple[ClosedChain, State]:
    """Return two to four arms that hold an object at right angles, at points of one line."""
    count, axis = int(random.integers(2, 5)), np.eye(3)[random.integers(3)]
    kinds = random.choice(["rigid", "hinge", "softfinger", "ball"], size=count)
    grasps = {
        f"arm{k}": Grasp(str(kind), Pose(RIGHT_ANGLES[random.integers(24)], axis * random.uniform(-0.5, 0.5)))
        for k, kind in enumerate(kinds)
    }
    chain = ClosedChain({name: ur5e() for name in grasps}, HeldObject.box(2.0, 0.2, 0.2, 0.2), grasps)
    at = Pose(RIGHT_ANGLES[random.integers(24)], random.normal(size=3))
    n = chain.joint_count
    return chain, State(np.zeros(n), np.zeros(n), at.wxyz_xyz)


def _by_singular_values(chain: ClosedChain, state: State, f: np.ndarray, length: float) -> np.ndarray:
    """Return the smallest transmissible wrenches with the net wrench of f, by NumPy's pseudo-inverse."""
    R = state.object_frame.R
    metric = np.r_[np.full(3, 1 / length), np.ones(3)]
    blocks, axes = [], []
    for grasp in chain.grasps.values():
        x, y, z = R @ grasp.frame.p
        lever = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        at_C = np.block([[np.eye(3), lever], [np.zeros((3, 3)), np.eye(3)]])
        turn = np.kron(np.eye(2), R @ grasp.frame.R)[:, list(grasp.transmitted)] / metric[list(grasp.transmitted)]
        blocks.append(metric[:, None] * (at_C @ turn))
        axes.append(turn)
    net = sum(b @ np.linalg.lstsq(t, row)[0] for b, t, row in zip(blocks, axes, f, strict=True))
    lam = np.linalg.pinv(np.hstack(blocks), rcond=1e-9) @ net
    ends = np.cumsum([t.shape[1] for t in axes])[:-1]
    return np.array([t @ part for t, part in zip(axes, np.split(lam, ends), strict=True)])
