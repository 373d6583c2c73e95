"""A peg in a hole: Whitney's wedge by geometry, gaps of rims against brute force, and refusals."""

import numpy as np
import pytest
from scipy.optimize import linprog

import holdfast as hf
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.errors import MethodNotApplicable, ModelError
from holdfast.simulation.impulse_step import _on_grasps_and_contacts
from holdfast.spatial import rotation
from holdfast.world import Circle, Cylinder, HalfSpace, Hole, Rod, Touching
from tests.longer import mostly_slow

R, r, HALF = 0.0101, 0.01, 0.03


def peg(mu):
    """Return a peg whose lower rim meets the wall of a hole, and whose side meets the hole's edge at z = 0."""
    touching = Touching(
        {"rim": Circle([0, 0, -HALF], [0, 0, 1], r)},
        {"wall": Cylinder(radius=R, inside=True, friction=mu)},
        solids={"side": Cylinder(radius=r, friction=mu)},
        edges={"edge": Circle([0, 0, 0], [0, 0, 1], R)},
    )
    return hf.ClosedChain({}, hf.HeldObject(0.5, 1e-3 * np.eye(3)), {}, gravity=[0, 0, 0], touching=touching)


def wedged(tilt):
    """Return the state in which rim and edge touch on opposite sides, and the coefficient at which they wedge.

    In the plane of the tilt the rim's point (-R, -d) and the edge (R, 0) are 2 r apart across the peg, so that
    2 R cos(tilt) - d sin(tilt) = 2 r. Along the peg they are l = 2 R sin(tilt) + d cos(tilt) apart. The line through
    both is in both cones, and any load can be carried, if l <= mu 2 r (Whitney 1982).
    """
    c, s = np.cos(tilt), np.sin(tilt)
    d = (2 * R * c - 2 * r) / s
    turned = rotation.exp(np.array([0.0, tilt, 0.0]))
    at = hf.Pose(turned, np.array([-R, 0.0, -d]) - turned @ [-r, 0.0, -HALF])
    return hf.State([], [], at), (2 * R * s + d * c) / (2 * r)


def test_two_points_touch():
    """Both circles have their near places where plane geometry says, on opposite sides."""
    chain, (state, _) = peg(0.1), wedged(0.02)
    rows = contact_rows(chain.touching, state.object_frame, np.zeros(6))
    touching = [i for i, gap in enumerate(rows.gap) if abs(gap) < 1e-12]
    names = {chain.touching.names[i][:4] for i in touching}
    assert names == {"rim.", "edge"} and rows.gap.min() > -1e-12
    places = {chain.touching.names[i][:4]: rows.point[i] + state.object_frame.p for i in touching}
    assert places["rim."][0] == pytest.approx(-R, abs=1e-12)
    np.testing.assert_allclose(places["edge"], [R, 0, 0], atol=1e-9)


def carried(rows, friction, load):
    """Return whether forces within the cones, in the plane of the tilt, balance a load (6,) (linear programme)."""
    edges = []
    for C, axes in zip(rows.C[rows.gap < 1e-9], rows.axes[rows.gap < 1e-9], strict=True):
        along = axes @ np.cross([0.0, 1.0, 0.0], axes[2])  # the tangent in the plane
        edges += [C.T @ ([0.0, 0.0, 1.0] + sign * friction * along) for sign in (-1.0, 1.0)]
    A = np.array(edges).T[[1, 3, 5]]
    scale = np.array([1.0 / r, 1.0, 1.0])
    found = linprog(np.zeros(A.shape[1]), A_eq=scale[:, None] * A, b_eq=-scale * load[[1, 3, 5]])
    return found.status == 0


@pytest.mark.parametrize("tilt", [0.02, 0.03])
def test_whitney_wedge(tilt):
    """Just above Whitney's coefficient the contacts carry every load in the plane; just below, some none."""
    rng, (state, mu) = np.random.default_rng(2), wedged(tilt)
    rows = contact_rows(peg(mu).touching, state.object_frame, np.zeros(6))
    loads = [np.array([0, m, 0, f, 0, z]) for m, f, z in rng.normal(size=(40, 3)) * [0.05, 2.0, 5.0]]
    assert all(carried(rows, 1.001 * mu, load) for load in loads)
    assert not all(carried(rows, 0.999 * mu, load) for load in loads)


@pytest.mark.slow
def test_circle_against_brute_force():
    """Both places of a tilted rim in a chamfered hole: no point of the circle is nearer."""
    rng, hole = np.random.default_rng(1), Hole(radius=R, chamfer=2e-3, edge=1e-4)
    rim = Circle([0.001, 0, -HALF], [0, 0, 1], r, 2e-4)
    touching = Touching({"rim": rim}, {"hole": hole})
    angles = np.linspace(0, 2 * np.pi, 2001)
    for _ in range(30):
        at = hf.Pose(rotation.exp(0.05 * rng.normal(size=3)), 0.001 * rng.normal(size=3) + [0, 0, HALF + 1e-3])
        gaps = [hole.distance(at.R @ rim.at(angle).arm + at.p).phi for angle in angles]
        if min(gaps) < 2e-4:
            continue
        found = contact_rows(touching, at, np.zeros(6)).gap[0]
        assert found <= min(gaps) - rim.thickness + 1e-12
        assert found >= min(gaps) - rim.thickness - 1e-7


@pytest.mark.parametrize("tilt", mostly_slow([0.01, 0.02, 0.03], [0.02]))
def test_what_penetrates_is_pushed_out(tilt):
    """A displaced two-point peg leaves hole and edge, by no more than the displacement: to undo it would suffice."""
    rng, (state, _), chain = np.random.default_rng(4), wedged(tilt), peg(0.1)
    rim, angles = chain.touching.points["rim"], np.linspace(0, 2 * np.pi, 2001)
    metric = np.sqrt([1e-3] * 3 + [0.5] * 3)  # of `peg`
    for _ in range(10):
        by = rng.normal(size=6) * [1e-4, 1e-4, 1e-4, 3e-6, 3e-6, 3e-6]
        at = hf.Pose(rotation.exp(by[:3]) @ state.object_frame.R, state.object_frame.p + by[3:])
        end = _on_grasps_and_contacts(chain, hf.State([], [], at), None, [1.0] * 4).object_frame
        assert contact_rows(chain.touching, end, np.zeros(6)).gap.min() > -1e-12
        assert min(R - np.hypot(*(end.R @ rim.at(angle).arm + end.p)[:2]) for angle in angles) > -1e-12
        moved = np.concatenate([rotation.log(end.R @ at.R.T), end.p - at.p])
        assert np.linalg.norm(metric * moved) < 1.01 * np.linalg.norm(metric * by)


def test_a_rim_wanders_no_farther_than_it_can():
    """Off the middle of a hole by a, and moving across, a rim has gap(t) = R - r - sqrt(a^2 + v^2 t^2)."""
    touching, v = Touching({"rim": Circle([0, 0, 0], [0, 0, 1], r)}, {"wall": Cylinder(radius=R, inside=True)}), 0.03
    for a in (1e-5, 1e-6, 1e-8):
        at, twist = hf.Pose(np.eye(3), [a, 0, 0]), np.array([0, 0, 0, 0, v, 0])
        for t in (1e-6, 1e-4):
            rows = contact_rows(touching, at, twist, t)
            rate = rows.velocity(twist)[0, 2] + t * rows.drift[0, 2]
            assert rate == pytest.approx(-v * v * t / np.hypot(a, v * t), rel=2e-3)


def test_points_for_a_rim_are_refused():
    """Points on a circle stand for it to r (1 - cos pi / m): refused where the clearance is below ten times that."""

    def points(m, r):
        turns = 2 * np.pi * np.arange(m) / m
        return {f"p{i}": [r * np.cos(a), r * np.sin(a), 0] for i, a in enumerate(turns)}

    with pytest.raises(ModelError, match=r"24 points stand for a circle of radius 0.01 m .* try holdfast.world.Circle"):
        Touching(points(24, r), {"hole": Cylinder(radius=R, inside=True)})
    with pytest.raises(ModelError, match="points stand for a circle"):
        Touching(points(24, r), {"hole": Hole(radius=R, chamfer=1e-3)})
    Touching(points(128, r), {"hole": Cylinder(radius=R, inside=True)})  # 3e-6 m of 1e-4 m
    Touching(points(24, r), {"table": HalfSpace()})
    Touching(points(4, r), {"hole": Cylinder(radius=R, inside=True)})  # a square peg


def test_events_refuse_circles():
    """Places of a circle change their order, which modes of the run by events would not survive."""
    state, mu = wedged(0.02)
    law = lambda t, state, memory: (np.zeros(0), memory)  # noqa: E731
    with pytest.raises(MethodNotApplicable, match=r"contacts='steps'.*'rim'"):
        hf.simulate(peg(mu), state, law, 0.01, 0.001)


def coin():
    """Return a thin disc that rolls about its centre, which stays, and the speed at which its axis turns.

    It turns about the line from the contact to the centre, at w; its axis, off the vertical by a, goes around at
    w sin a. With angular momentum I w along that line, I = m r^2 / 4, and the moment m g r cos a:
    (w sin a)^2 = 4 g sin a / r.
    """
    a, m, touching = 0.6, 0.2, Touching({"rim": Circle([0, 0, 0], [0, 0, 1], 0.05)}, {"table": HalfSpace(friction=0.8)})
    turning = np.sqrt(4 * 9.81 / (0.05 * np.sin(a)))
    inertia = m * 0.05**2 / 4 * np.diag([1.0, 1.0, 2.0])
    tilted = rotation.exp(np.array([0.0, a, 0.0]))
    line = tilted @ [-1.0, 0.0, 0.0]
    twist = np.concatenate([turning * line[2] * line, np.zeros(3)])
    state = hf.State([], [], hf.Pose(tilted, [0, 0, 0.05 * np.sin(a)]), twist)
    return hf.ClosedChain({}, hf.HeldObject(m, inertia), {}, touching=touching), state, turning


def no_torque(t, state, memory):
    return np.zeros(0), memory


@pytest.mark.slow
def test_coin_rolls():
    """Steps follow the closed form with order 2, lose energy only, and leave no gap below -1e-12 m."""
    chain, state, turning = coin()
    assert turning**2 * np.sin(0.6) == pytest.approx(4 * 9.81 / 0.05)
    off = []
    for h in (2e-3, 1e-3):
        run = hf.simulate(chain, state, no_torque, 0.04, h, contacts="steps")
        axis = rotation.exp(np.array([0.0, 0.0, 0.04 * turning])) @ state.object_frame.R[:, 2]
        off.append(np.abs(hf.Pose.from_wxyz_xyz(run.object_pose[-1]).R[:, 2] - axis).max())
        assert np.diff(run.kinetic + run.potential).max() < 1e-15
        assert run.touch_gap.min() > -1e-12
    assert off[0] < 1e-3 and off[1] < 0.3 * off[0]


@pytest.mark.long
def test_coin_by_machine_code():
    """A rim becomes machine code: the steps of the reference."""
    chain, state, _ = coin()
    rollout = hf.compile_rollout(chain)
    none, one = np.zeros((1, 0)), (state.object_pose[None], state.object_twist[None])
    systems = rollout.step(rollout.start(none, none, *one), 2e-3, steps=10)
    run = hf.simulate(chain, state, no_torque, 0.02, 2e-3, contacts="steps")
    assert systems.running.all()
    np.testing.assert_allclose(systems.object_pose[0], run.object_pose[-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(systems.touch_force[0], run.touch_force[-1], rtol=0, atol=1e-8)


def test_rounded_profiles():
    """A rod is all points within its edge of the inner cylinder, by a fine sampling of that one."""
    rng, rod = np.random.default_rng(0), Rod(radius=0.2, half_length=0.4, edge=0.05)
    for _ in range(50):
        x = rng.uniform(-0.6, 0.6, 3)
        rho = np.hypot(*x[:2])
        out = np.array([max(rho - 0.15, 0.0), max(abs(x[2]) - 0.35, 0.0)])
        if out.any():
            assert rod.distance(x).phi == pytest.approx(np.hypot(*out) - 0.05, abs=1e-15)
