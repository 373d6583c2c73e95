"""Where slips stop or begin beside other contacts, and where the force of a contact jumps."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import holdfast as hf
from holdfast.world import Box, HalfSpace, Sphere, Touching

GRAVITY = 9.81


def without_torques(t, state, memory):
    """A law for chains without joints."""
    return np.zeros(0), memory


def times_of(run, kind):
    """Return the times of the log's entries of a kind."""
    return [one.t for one in run.occurrences if one.kind == kind]


@pytest.mark.slow
def test_a_needle_that_slides_along_itself_stops():
    """Two points with friction stop at v / (mu g), after v^2 / (2 mu g), whatever spin of 1e-3 rad/s they begin with.

    The needle turns so easily that friction at either point could turn its slip 40 times faster than it slows it down.
    """
    v, mu, l = 0.5, 0.5, 0.1
    needle = hf.HeldObject(1.0, np.diag([1e-3, 5e-4, 5e-4]))
    touching = Touching({"front": [l, 0.0, 0.0], "back": [-l, 0.0, 0.0]}, {"table": HalfSpace(friction=mu)})
    chain = hf.ClosedChain({}, needle, {}, touching=touching)
    for spin in (0.0, 1e-3):
        begin = hf.State(np.zeros(0), np.zeros(0), hf.Pose.identity(), np.array([0.0, 0.0, spin, v, 0.0, 0.0]))
        run = hf.simulate(chain, begin, without_torques, 0.12, 0.01, contacts="events")
        assert run.stopped is None
        stops = times_of(run, "stick")
        assert len(stops) == 2
        np.testing.assert_allclose(stops, v / (mu * GRAVITY), rtol=1e-12 if spin == 0.0 else 1e-7)
        np.testing.assert_allclose(run.object_pose[-1, 4], v**2 / (2.0 * mu * GRAVITY), rtol=1e-6)


@pytest.mark.slow
def test_a_ladder_slips_sideways_along_a_wall():
    """Its foot sticks, so its top can only move on a circle in the wall: an equation for one angle, until it leaves.

    With the top at r (sin p, cos p) in the wall and the foot at a distance d from the wall, the wall presses with
    N = m d (g cos p / (2 r) - p'^2 / 3), and r p'' / 3 = g sin p / 2 - mu N / m. Derived from angular momentum about
    the foot.
    """
    length, d, m, mu, leaning = 1.0, 0.6, 2.0, 0.3, 1.0
    r = np.sqrt(length**2 - d**2)
    along = np.array([-d, r * np.sin(leaning), r * np.cos(leaning)]) / length
    side = np.cross([0.0, 0.0, 1.0], along)
    side /= np.linalg.norm(side)
    pose = hf.Pose(np.column_stack([along, side, np.cross(along, side)]), [d, 0.0, 0.0] + along * length / 2.0)
    ladder = hf.HeldObject(m, np.diag([1e-4, m * length**2 / 12.0, m * length**2 / 12.0]))
    world = {"floor": HalfSpace(friction=5.0), "wall": HalfSpace(normal=[1.0, 0.0, 0.0], friction=mu)}
    ends = {"foot": [-length / 2.0, 0.0, 0.0], "top": [length / 2.0, 0.0, 0.0]}
    chain = hf.ClosedChain({}, ladder, {}, touching=Touching(ends, world))
    begin = hf.State(np.zeros(0), np.zeros(0), pose, np.zeros(6))
    run = hf.simulate(chain, begin, without_torques, 0.2, 0.01, contacts="events")

    def pressing(x):
        return m * d * (GRAVITY * np.cos(x[0]) / (2.0 * r) - x[1] ** 2 / 3.0)

    def rate(t, x):
        return [x[1], 3.0 / r * (GRAVITY * np.sin(x[0]) / 2.0 - mu * pressing(x) / m)]

    of = solve_ivp(rate, (0.0, 0.2), [leaning, 0.0], rtol=1e-12, atol=1e-14, dense_output=True).sol
    leaves = brentq(lambda t: pressing(of(t)), 0.1, 0.2, xtol=1e-14)
    assert run.stopped is None
    assert times_of(run, "lift") == [pytest.approx(leaves, abs=1e-6)]
    k = int(np.searchsorted(run.t, 0.1))
    top = run.object_pose[k, 4:] + hf.Pose.from_wxyz_xyz(run.object_pose[k]).R @ ends["top"]
    np.testing.assert_allclose(np.arctan2(top[1], top[2]), of(run.t[k])[0], rtol=1e-6)


@pytest.mark.slow
def test_a_ball_leaves_a_face_where_its_edge_begins():
    """Held by three slides with dampers, it passes the face's end at v_0 (1 - exp(-c t / M)) M / c, and leaves there.

    The normal force jumps from M g to less than nothing, as v^2 / (edge + radius) > g. No sample shows the latter.
    """
    radius, half, edge, v, c, begins = 0.02, 0.1, 0.005, 0.8, 4.0, 0.05
    joints = [hf.Joint("prismatic", axis, name=name) for name, axis in zip("xyz", np.eye(3), strict=True)]
    links = [hf.Link(mass, np.zeros(3), 1e-3 * np.eye(3)) for mass in (0.2, 0.3, 0.5)]
    place = hf.Pose(np.eye(3), [begins, 0.0, half + radius])
    arm = hf.Arm(joints, links, tip=hf.Pose.identity(), base=place)
    touching = Touching({"ball": Sphere(np.zeros(3), radius)}, {"block": Box(half=[half] * 3, edge=edge, friction=0.0)})
    ball = hf.HeldObject.sphere(1.0, radius)
    chain = hf.ClosedChain({"arm": arm}, ball, {"arm": hf.Grasp("ball", hf.Pose.identity())}, touching=touching)
    begin = hf.State(np.zeros(3), np.array([v, 0.0, 0.0]), place, np.array([0.0, 0.0, 0.0, v, 0.0, 0.0]))

    def law(t, state, memory):
        return -c * state.qd, memory

    run = hf.simulate(chain, begin, law, 0.1, 0.01, contacts="events")
    M = 2.0
    leaves = -M / c * np.log(1.0 - (half - edge - begins) * c / (M * v))
    assert run.stopped is None
    assert times_of(run, "lift") == [pytest.approx(leaves, abs=1e-9)]
    assert run.touch_force[:, 0, 2].min() >= 0.0
