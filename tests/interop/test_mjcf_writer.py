"""MuJoCo computes the same arms from our MJCF, and nearly the same closed chains."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, HeldObject, Joint, Link, Pose, State, forward_dynamics
from holdfast.dynamics import project_velocity
from holdfast.dynamics.contact_places import tip_frames
from holdfast.dynamics.diagnose import diagnose
from holdfast.errors import ModelError, StateError
from holdfast.interop.mjcf_writer import nested_order, to_mjcf
from holdfast.robots import ROBOTS, stewart_platform, three_finger_hand
from tests.control.two_pandas import two_pandas
from tests.laws.test_anchors import still
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.systems import well_conditioned_system
from tests.systems.anchored import by_anchor
from tests.systems.as_chain import as_chain
from tests.systems.trunk_runs import still_base

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")

ARM_DIGITS = 1e-10
SOFTNESS = 0.01  # of accelerations, at the hardest setting: 0.5 to 0.9 % for rigid grasps of two arms


def loaded(chain, state, **options):
    """Return MuJoCo's model and data at a state, nothing applied."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(chain, state, **options))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return model, data


def moving(chain, state):
    """Return the state with consistent random velocities."""
    rng = np.random.default_rng(len(state.q))
    return project_velocity(chain, State(state.q, 0.3 * rng.normal(size=len(state.q)), state.object_pose))


def compare_arms(chain, state):
    """Return the largest differences in M, J and bias of every arm, relative to the largest entries."""
    free = ClosedChain(chain.arms, chain.held_object, {}, chain.gravity)
    model, data = loaded(free, state)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    gaps = []
    for name, arm in chain.arms.items():
        part = chain.joints[name]
        ours = mass_jacobian_bias(arm, state.q[part], state.qd[part], chain.gravity)
        site, linear, angular = model.site(f"{name}/tip").id, np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, linear, angular, site)
        theirs = M[part, part], np.concatenate([angular, linear])[:, part], data.qfrc_bias[part]
        gaps += [np.abs(a - b).max() / max(np.abs(a).max(), 1e-9) for a, b in zip(ours, theirs, strict=True)]
    return max(gaps)


def test_built_in_arms():
    """M, J and bias of every built-in robot, mounted askew, moving, under tilted gravity."""
    rng = np.random.default_rng(5)
    turns = [q / np.linalg.norm(q) for q in rng.normal(size=(4, 4))]
    mounts = [Pose.from_wxyz_xyz(np.r_[q, p]) for q, p in zip(turns, rng.normal(size=(4, 3)), strict=True)]
    arms = {n: make(at, armature=0.1) for (n, make), at in zip(ROBOTS.items(), mounts, strict=True)}
    chain = ClosedChain(arms, HeldObject.box(1.0, 0.1, 0.2, 0.3), {}, np.array([1.0, 2.0, -9.0]))
    state = State(rng.normal(size=27), rng.normal(size=27), [1, 0, 0, 0, 0, 0, 0])
    assert compare_arms(chain, state) <= ARM_DIGITS


def test_random_arms():
    """The same for arms of any axes, sliding joints among them, with armature; damping counts as theirs."""
    for seed in range(3):
        p = as_chain(well_conditioned_system(seed, grasps=["rigid", "ball"], joints=[7, 6], moving_base=False))
        assert compare_arms(p.chain, p.state) <= ARM_DIGITS
        _, data = loaded(p.chain, p.state)
        damping = np.concatenate([arm.damping for arm in p.chain.arms.values()])
        assert data.qfrc_damper[: len(damping)] == pytest.approx(-damping * p.state.qd, abs=1e-12)


def massless(arm: Arm) -> Arm:
    """Return the arm with its second and third link weightless and their turns and shifts kept."""
    links = [Link(0.0) if k in (1, 2) else link for k, link in enumerate(arm.links)]
    return replace(arm, links=links)


def test_massless_links_share_a_body():
    """Joints of weightless links go to the next body and stay where they are."""
    case = as_chain(well_conditioned_system(1, grasps=["rigid"], joints=[7], moving_base=False, extras=False))
    (name, arm), state = next(iter(case.chain.arms.items())), case.state
    chain = ClosedChain({name: massless(arm)}, case.chain.held_object, {})
    assert compare_arms(chain, state) <= ARM_DIGITS
    model, _ = loaded(chain, state)
    assert model.nbody == 1 + 1 + 5 + 1  # world, base, five links with mass, object


@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "hinge"), ("ball", "hinge")])
def test_closed_chains_to_their_softness(kinds):
    """The grasps are closed there too, and accelerations agree to what MuJoCo's hardest equality gives way."""
    chain, state = two_pandas(*kinds)
    state = moving(chain, state)
    model, data = loaded(chain, state)
    rows = {"rigid": 6, "hinge": 6, "ball": 3}
    assert len(data.efc_pos) == sum(rows[kind] for kind in kinds)
    assert np.abs(data.efc_pos).max() <= 1e-12
    assert np.abs(data.efc_vel).max() <= 1e-12
    tau = np.random.default_rng(3).normal(size=14)
    data.ctrl[:] = tau
    mujoco.mj_forward(model, data)
    found = forward_dynamics(chain, state, tau)
    ours = np.r_[found.qdd, found.object_acceleration[3:]]
    gap = np.abs(data.qacc[:17] - ours).max() / np.abs(ours).max()
    print(f"{kinds}: accelerations differ by {gap:.1e}")
    assert 1e-12 < gap < SOFTNESS


def test_short_legs():
    """A Stewart platform opens and moves as ours; a soft finger's missing row is what the docstring says."""
    parts = stewart_platform()
    chain = ClosedChain(*parts)
    state = moving(chain, State(np.zeros(18), np.zeros(18), [1, 0, 0, 0, 0, 0, 0.45]))
    _, data = loaded(chain, state, visuals=False)
    found = forward_dynamics(chain, state, np.zeros(18))
    assert data.qacc[:18] == pytest.approx(found.qdd, abs=1e-3 * np.abs(found.qdd).max())
    hand = ClosedChain(*three_finger_hand())
    assert diagnose(hand, State(np.zeros(12), np.zeros(12), [1, 0, 0, 0, 0, 0, 0.08])).rows == 18
    assert to_mjcf(hand).count("<connect") == 3
    assert to_mjcf(hand).count("its moment about the normal is not written") == 3


def test_limits_drives_and_looks():
    """Ranges, force ranges and friction go along; solids are seen and touch nothing; without looks there are none."""
    arm = Arm(
        [Joint(position_limits=(-np.inf, 1.5), effort_limit=7.0, friction=0.3), Joint("prismatic", name="lift")],
        [Link(1.0, inertia=np.eye(3)), Link(2.0, inertia=np.eye(3))],
    )
    chain = ClosedChain({"a": arm}, HeldObject.box(1.0, 0.3, 0.2, 0.1), {})
    model = mujoco.MjModel.from_xml_string(to_mjcf(chain))
    first, second = model.joint("a/joint1"), model.joint("a/lift")
    assert first.range.tolist() == [-1e10, 1.5]
    assert model.jnt_actfrcrange[first.id].tolist() == [-7.0, 7.0]
    assert not model.jnt_limited[second.id]
    assert not model.jnt_actfrclimited[second.id]
    assert model.dof_frictionloss[0] == 0.3
    assert model.nu == 2
    assert model.ngeom > 3
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    drawn = [g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name == "object"]
    assert sorted(2 * model.geom_size[drawn[0]]) == pytest.approx([0.1, 0.2, 0.3])
    assert mujoco.MjModel.from_xml_string(to_mjcf(chain, visuals=False)).ngeom == 0
    assert ElementTree.fromstring(to_mjcf(chain)).find("keyframe") is None
    with pytest.raises(StateError, match="expected 2"):
        to_mjcf(chain, State(np.zeros(3), np.zeros(3), [1, 0, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize(
    ("links", "message"),
    [
        ([Link(1.0, inertia=np.eye(3)), Link(0.0)], "a last link with mass"),
        ([Link(1.0), Link(1.0, inertia=np.eye(3))], "arm 'a', link 'link1': .*without rotational inertia"),
        (
            [Link(1.0, inertia=np.diag([1, 1, 3.0]), physical=False), Link(1.0, inertia=np.eye(3))],
            "no mass distribution",
        ),
        ([Link(1.0, inertia=np.eye(3), name="x"), Link(1.0, inertia=np.eye(3), name="x")], "two are called 'a/x'"),
    ],
)
def test_what_mujoco_cannot_have(links, message):
    """It is refused by name before MuJoCo would."""
    chain = ClosedChain({"a": Arm([Joint(), Joint()], links)}, HeldObject.box(1, 1, 1, 1), {})
    with pytest.raises(ModelError, match=message):
        to_mjcf(chain)


def on_a_trunk(seed, joints, floating, kinds):
    """Return a random chain on a trunk that MuJoCo can have: no external wrenches, no base motion."""
    arms = {"arms": 4, "grasps": kinds, "joints": 6}
    p = still_base(seed, joints, floating=floating, arms=arms, in_world=0.3)
    return p.chain, p.state, p.tau


def answer(chain, state, tau):
    """Return data and qacc of MuJoCo, and ours in its order: linear halves first, turns in a body's own axes."""
    model, data = loaded(chain, state)
    data.ctrl[:] = tau
    mujoco.mj_forward(model, data)
    found = forward_dynamics(chain, state, tau, check=False)
    free = [(state.object_frame, found.object_acceleration)]
    if chain.floats:
        free.insert(0, (state.base_frame, found.base_acceleration))
    ours = [np.r_[a[3:], a[:3] @ frame.R] for frame, a in free]
    ours.insert(len(free) - 1, np.concatenate([found.qdd[chain.joints[name]] for name in nested_order(chain)]))
    return data, data.qacc, np.concatenate(ours)


@pytest.mark.parametrize(("seed", "joints", "floating"), [(1, 3, False), (2, 3, True), (3, 0, True), (4, 5, True)])
def test_arms_on_a_trunk(seed, joints, floating):
    """Trunk, nested arms, those in the world and a floating base: with nothing held, all accelerations to rounding."""
    chain, state, tau = on_a_trunk(seed, joints, floating, "rigid")
    free = replace(chain, grasps={})
    data, theirs, ours = answer(free, state, tau)
    assert theirs == pytest.approx(ours, abs=1e-9 * np.abs(ours).max())
    for name, tip in tip_frames(free, state, free.names).items():
        site = data.site(f"{name}/tip")
        assert site.xpos == pytest.approx(tip.p, abs=1e-12)
        assert site.xmat == pytest.approx(tip.R.ravel(), abs=1e-12)


@pytest.mark.parametrize("floating", [False, True])
def test_closed_chains_on_a_trunk(floating):
    """With an object in their hands they agree to what MuJoCo's hardest equality gives way."""
    chain, state, tau = on_a_trunk(6, 2, floating, "ball")
    data, theirs, ours = answer(chain, state, tau)
    assert np.abs(data.efc_pos).max() <= 1e-12
    assert np.abs(data.efc_vel).max() <= 1e-12
    assert 1e-12 < np.abs(theirs - ours).max() / np.abs(ours).max() < SOFTNESS


def test_massless_links_of_a_trunk():
    """Arms stand on bodies, so each needs mass; one without is named."""
    chain, *_ = on_a_trunk(1, 3, False, "rigid")
    light = replace(chain.trunk, links=[chain.trunk.links[0], Link(0.0, name="none"), chain.trunk.links[2]])
    with pytest.raises(ModelError, match="trunk, link 'none': to_mjcf: expected links with mass"):
        to_mjcf(replace(chain, trunk=light, mounts={}))


@pytest.mark.parametrize("kind", ["ball", "hinge", "rigid"])
def test_anchors(kind):
    """Bodies without joints, in the world and on a trunk: poses are ours, accelerations up to the softness."""
    p = still(1, kind)
    data, theirs, ours = answer(p.chain, p.state, p.tau)
    touched = p.state.object_frame @ p.chain.grasps["pin1"].frame
    assert data.site("pin1/tip").xpos == pytest.approx(touched.p, abs=1e-12)
    assert 1e-12 < np.abs(theirs - ours).max() / np.abs(ours).max() < SOFTNESS
    _, below = by_anchor(0)
    data, theirs, ours = answer(below.chain, below.state, below.tau)
    assert np.abs(data.efc_pos).max() <= 1e-12
    assert 1e-12 < np.abs(theirs - ours).max() / np.abs(ours).max() < SOFTNESS
