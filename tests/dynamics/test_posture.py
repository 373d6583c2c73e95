"""A posture is reached: cheapest on all self-motions, against a closed form, with the defaults that it promises."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import holdfast as hf
from holdfast.dynamics import Posture, closure, motion_basis
from holdfast.errors import ModelError, StateError
from tests.assembly.test_on_trunk import ARMS, GRASPS, ON, TRAY
from tests.systems.problems import largest_gaps

STATIONARY = 1e-8  # slope of the cost along any self-motion
SPOT = np.array([1.1, 0.7, 0.0])
SIDES = (("left", 0.3), ("right", -0.3))


def planar(limits=(-np.inf, np.inf)):
    """Return three unit links in a plane whose tip is pinned to the object at `SPOT`, and a guess."""
    joints = [
        hf.Joint("revolute", placement=hf.Pose.translation(k > 0, 0, 0), name=f"j{k}", position_limits=limits)
        for k in range(3)
    ]
    links = [hf.Link(1.0, com=[0.5, 0, 0], inertia=np.diag([0.01, 0.1, 0.1])) for _ in joints]
    arm = hf.Arm(joints, links, tip=hf.Pose.translation(1, 0, 0))
    chain = hf.ClosedChain({"arm": arm}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {"arm": hf.Grasp("ball")})
    return chain, hf.State([0.4, 0.6, 0.5], np.zeros(3), hf.Pose.translation(*SPOT))


def elbow_angles(q0: float, knee: float) -> np.ndarray:
    """Return the angles of the other two links by the law of cosines."""
    x, y = SPOT[:2] - [np.cos(q0), np.sin(q0)]
    q2 = knee * np.arccos((x * x + y * y - 2) / 2)
    q1 = np.arctan2(y, x) - np.arctan2(np.sin(q2), 1 + np.cos(q2)) - q0
    return np.array([q0, q1, q2])


@pytest.mark.parametrize("weights", [[1, 1, 1], [1, 0, 0], [0.2, 3.0, 1e3]])
def test_closed_form(weights):
    """Three links in a plane: the minimum over the one self-motion that the law of cosines describes."""
    chain, guess = planar()
    wish = np.array([-0.1, 0.9, 0.7])
    found = hf.close(chain, guess, hold_object=True, posture=Posture(wish, weights))

    def cost(q0):
        return 0.5 * np.sum(np.array(weights) * (elbow_angles(q0, 1.0) - wish) ** 2)

    best = minimize_scalar(cost, bounds=(-1.5, 0.9), method="bounded", options={"xatol": 1e-12})
    assert found.q == pytest.approx(elbow_angles(best.x, 1.0), abs=1e-6)  # pyright: ignore[reportAttributeAccessIssue]
    assert found.object_pose == pytest.approx(guess.object_pose, abs=0)
    assert not found.qd.any()


def test_within_limits():
    """A wish beyond a joint's limit leads to that limit, and the other joints to what is closed there."""
    chain, guess = planar((-0.2, 2.5))
    found = hf.close(chain, guess, hold_object=True, posture=Posture({"arm/j0": -1.0}, {"arm": 0.0, "arm/j0": 1.0}))
    assert found.q == pytest.approx(elbow_angles(-0.2, 1.0), abs=1e-9)


@pytest.mark.parametrize("hold_object", [False, True])
def test_cheapest_of_all_self_motions(hold_object):
    """Two arms on a torso: no allowed velocity lowers the cost, that of the torso and of the object included."""
    chain, start = hf.assemble(ARMS, TRAY, GRASPS, object_pose=hf.Pose.translation(0.5, 0.1, 0.9), **ON)
    weights = {"trunk": 0.3, "left": np.linspace(0.2, 2.0, 7), "right/joint4": 5.0}
    posture = Posture({"left/joint1": 0.4}, weights)
    found = hf.close(chain, start, hold_object=hold_object, hold_trunk=False, posture=posture)
    cost = posture.cost(chain, start)
    assert largest_gaps(closure(chain, found))[0] <= 1e-10
    assert cost.of(found.q) < cost.of(start.q) - 1e-3
    basis = motion_basis(chain, found)
    if hold_object:
        _, sizes, Vt = np.linalg.svd(basis[-6:])
        basis = basis @ Vt[int((sizes > 1e-9).sum()) :].T
        assert found.object_pose == pytest.approx(start.object_pose, abs=0)
    assert basis.shape[1] >= 4
    slope = np.linalg.qr(basis)[0][: chain.joint_count].T @ (cost.stiffness * (found.q - cost.wish))
    assert np.abs(slope).max() <= STATIONARY


def test_defaults():
    """Joints with two limits prefer the middle, in units of half their range; others stay, in rad or of the reach."""
    ranged = hf.Joint("revolute", name="ranged", position_limits=(-1.0, 3.0))
    free = hf.Joint("prismatic", placement=hf.Pose.translation(0.5, 0, 0), name="free")
    one_sided = hf.Joint("revolute", placement=hf.Pose.translation(2, 0, 0), name="sided", position_limits=(0, np.inf))
    links = [hf.Link(1.0, inertia=np.diag([0.1, 0.1, 0.1])) for _ in range(3)]
    arm = hf.Arm([ranged, free, one_sided], links, tip=hf.Pose.translation(1.5, 0, 0))
    chain = hf.ClosedChain({"arm": arm, "idle": arm}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {"arm": hf.Grasp("ball")})
    state = hf.State([0.0, 0.0, 0.5] * 2, np.zeros(6), hf.Pose.translation(2, 0, 0))
    cost = Posture().cost(chain, state)
    assert cost.wish == pytest.approx([1.0, 0.0, 0.5, 0.0, 0.0, 0.5])  # the idle arm stays where it is
    reach = 0.5 + 2.0 + 1.5
    assert cost.stiffness[[0, 2]] == pytest.approx([0.25, 1.0])
    assert cost.stiffness[1] == pytest.approx(1 / reach**2, rel=0.2)
    some = Posture({"idle": 0.1, "idle/free": 0.2}, {"idle": 2.0}).cost(chain, state)
    assert some.wish[3:] == pytest.approx([0.1, 0.2, 0.1])
    assert some.stiffness[3:] == pytest.approx(2 * cost.stiffness[3:])


def test_assemble_moves_on():
    """The configuration with a posture costs less than the one without, and is where `close` leads from it."""
    posture = Posture()
    at = hf.Pose.translation(0.5, 0.0, 1.0)
    chain, plain = hf.assemble(ARMS, TRAY, GRASPS, object_pose=at, **ON)
    _, found = hf.assemble(ARMS, TRAY, GRASPS, object_pose=at, posture=posture, **ON)
    cost = posture.cost(chain, plain)
    assert cost.of(found.q) < cost.of(plain.q)
    assert found.object_pose == pytest.approx(plain.object_pose, abs=0)
    closed = hf.close(chain, plain, hold_object=True, hold_trunk=False, posture=posture)
    assert found.q == pytest.approx(closed.q, abs=1e-12)


@pytest.mark.parametrize(
    ("q", "weights", "said"),
    [
        ({"lft": 1.0}, None, "no joint or arm 'lft'. Did you mean 'left'?"),
        ({"left": [1.0, 2.0]}, None, r"posture: q of 'left': expected shape \(7,\)"),
        (None, [1.0, -2.0] + [1.0] * 14, "expected >= 0, got -2 for 'trunk/waist'"),
        (None, {"left": np.nan}, "finite"),
        ({"left/joint1": 1e6}, None, "at most 100000"),
    ],
)
def test_wrong_postures(q, weights, said):
    """A name, a number of values or a weight that does not fit is named."""
    chain, state = hf.assemble(ARMS, TRAY, GRASPS, object_pose=hf.Pose.translation(0.5, 0, 1.0), **ON)
    with pytest.raises(StateError, match=said):
        hf.close(chain, state, posture=Posture(q, weights))


def test_no_posture():
    """Something else in its place is named, too."""
    chain, guess = planar()
    with pytest.raises(ModelError, match="close: posture: expected Posture or None, got dict"):
        hf.close(chain, guess, posture={"arm": 0.0})  # pyright: ignore[reportArgumentType]


def test_bushings_and_floating_bases():
    """An arm behind a bushing stays where it is; with a floating base, whose pose may be held, the cost is least."""
    arms = {name: arm.at(hf.Pose.translation(0, y, 0.2)) for arm, (name, y) in zip(ARMS.values(), SIDES, strict=True)}
    ship = hf.Trunk(floating=hf.Link(200.0, inertia=np.diag([30.0, 30.0, 20.0])))
    mounts = {"left": "base", "right": "base"}
    at = hf.Pose.translation(0.5, 0, 0.8)
    chain, start = hf.assemble(arms, TRAY, GRASPS, object_pose=at, trunk=ship, mounts=mounts)
    cost = Posture().cost(chain, start)
    freely = {"hold_object": True, "hold_trunk": False, "posture": Posture()}
    held, free = (hf.close(chain, start, hold_base=hold, **freely) for hold in (True, False))
    assert held.base_pose is not None and free.base_pose is not None and start.base_pose is not None
    assert held.base_pose.tolist() == start.base_pose.tolist()
    assert np.abs(free.base_pose - start.base_pose).max() > 0.01
    assert cost.of(free.q) < cost.of(held.q) < cost.of(start.q)
    soft = hf.Grasp("bushing", GRASPS["right"].frame, stiffness=np.full(6, 1e3))
    loose = hf.ClosedChain(arms, TRAY, {**GRASPS, "right": soft}, trunk=ship, mounts=mounts)
    found = hf.close(loose, start, hold_object=True, posture=Posture())
    assert found.q[7:] == pytest.approx(start.q[7:], abs=1e-12)
    assert np.abs(found.q[:7] - start.q[:7]).max() > 0.01
