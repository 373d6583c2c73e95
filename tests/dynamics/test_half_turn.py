"""Grasps that are turned by half a turn and nearly that: measured as so far open by every measure, or refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import holdfast as hf
from holdfast.assembly.reaching_configurations import reaching_configurations
from holdfast.dynamics.projection import largest_gaps
from holdfast.errors import ClosureError, StateError
from holdfast.simulation.rollout.traced_step import GRASP_OPEN
from holdfast.state import shaped_inputs
from tests.systems.lower_pairs import PITCH, grasp_of, pair

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


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize(("kind", "axis"), OFF)
def test_measured(kind, axis, angle):
    """`closure` measures the angle; the measure of a step does to 0.16 rad, and exactly near half a turn."""
    chain, state = turned(kind, axis, angle)
    gap = hf.dynamics.closure(chain, state)["arm0"].position
    assert np.linalg.norm(gap[: 3 - len(FREE[kind])]) == pytest.approx(angle, abs=1e-7)
    found = largest_gaps(chain, state, shaped_inputs(chain, None)).position
    assert angle - 1e-7 <= found <= angle + max(1e-7, (np.pi - angle) ** 3 / 24)


@pytest.mark.parametrize("angle", ANGLES)
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
@pytest.mark.parametrize("kind", [kind for kind, free in FREE.items() if free != "xyz"])
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
