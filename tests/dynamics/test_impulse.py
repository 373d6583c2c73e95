"""Gripping in motion: energy, momentum, velocities; and letting go."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, Friction, Grasp, HeldObject, Inputs, Joint, Link, Pose, State, forward_dynamics
from holdfast.dynamics import Status, closure, kinetic_energy, momentum
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.impulse import attach, grasp_here, release
from holdfast.errors import ClosureError, ModelError, StateError
from holdfast.model.grasp import WrenchLimits
from holdfast.spatial import rotation
from holdfast.spatial.spatial_vector import shift_wrench, unrotate
from tests.systems import planar_three_arms
from tests.systems.as_chain import as_chain
from tests.systems.problems import largest_gaps, random_problem, relative_gap

KINDS = ("rigid", "hinge", "softfinger", "ball")
OPTIONS = {"grasps": ("softfinger", None, "rigid", None, "ball"), "joints": (7, 7, 6, 8, 7)}
EXACT = 1e-12  # of the sum of absolute terms
grips = pytest.mark.parametrize(
    ("kind", "seed", "moving_base"), [(kind, seed, seed % 2 == 1) for kind in KINDS for seed in range(3)]
)


def gripped(kind: str, seed: int, moving_base: bool):
    """Return a chain of five arms, and what happens when the second one, in motion, grips it."""
    p = random_problem(seed, moving_base=moving_base, **OPTIONS)
    frame = Pose(rotation.exp(np.random.default_rng(seed).normal(size=3)), np.zeros(3))
    return p, attach(p.chain, p.state, "arm2", Grasp(kind, frame), here=True, inputs=p.inputs)


def motion_before(p, done):
    """Return the chain that has the grasp with the velocities before it."""
    return chain_motion(done.chain, p.state, np.zeros(done.chain.joint_count), p.inputs.shaped(done.chain))


@grips
def test_energy(kind, seed, moving_base):
    """K Omega K^T p = K (V_tip - A V(C)), solved densely; Delta T - sum V_b.j_b = -1/2 p^T K Omega K^T p <= 0."""
    p, done = gripped(kind, seed, moving_base)
    before = kinetic_energy(p.chain, p.state, p.inputs)
    after = kinetic_energy(done.chain, done.state, p.inputs)
    motion = motion_before(p, done)
    s = Stacked(motion)
    f = done.impulses[[done.chain.names.index(name) for name in done.chain.grasps]].ravel()
    omega = s.J @ s.mass_solve(s.J.T) + s.A @ s.M_C_inverse @ s.A.T
    tips = np.concatenate([arm.tip_twist for arm in motion.holding])
    gap = s.K @ (tips - s.A @ p.state.object_twist)
    assert relative_gap(f, s.K.T @ np.linalg.solve(s.K @ omega @ s.K.T, gap)) < 1e-10
    lost = 0.5 * f @ omega @ f
    by_bases = (p.inputs.shaped(p.chain).base_twists * done.base_impulses).sum()
    size = before + after + lost + abs(by_bases)
    assert abs(after - before - by_bases + lost) <= EXACT * size
    assert abs(done.energy_change - (after - before)) <= EXACT * size
    assert lost > 1e-3
    assert (by_bases != 0) == moving_base
    assert done.status is Status.OK


@grips
def test_momentum(kind, seed, moving_base):
    """Linear and angular momentum of the whole chain change by the base impulses only."""
    p, done = gripped(kind, seed, moving_base)
    before = momentum(p.chain, p.state, inputs=p.inputs)
    after = momentum(done.chain, done.state, inputs=p.inputs)
    impulses = [shift_wrench(arm.base.p, j) for arm, j in zip(p.chain.arms.values(), done.base_impulses, strict=True)]
    size = np.abs(impulses).sum(axis=0).max() + np.abs(before).max()
    assert np.abs(after - before - np.sum(impulses, axis=0)).max() <= EXACT * size
    assert np.abs(after - before).max() > 1e-2


@grips
def test_velocities(kind, seed, moving_base):
    """Every grasp holds in position and velocity; nothing else has moved; a free arm goes on as it was."""
    p, done = gripped(kind, seed, moving_base)
    assert largest_gaps(closure(done.chain, done.state, p.inputs)).max() < 1e-12
    np.testing.assert_array_equal(done.state.q, p.state.q)
    np.testing.assert_array_equal(done.state.object_pose, p.state.object_pose)
    free = p.chain.joints["arm4"]
    np.testing.assert_array_equal(done.state.qd[free], p.state.qd[free])
    np.testing.assert_array_equal([done.impulses[3], done.base_impulses[3]], np.zeros((2, 6)))
    assert list(done.chain.grasps) == ["arm1", "arm2", "arm3", "arm5"]


@grips
def test_free_motions_stay_free(kind, seed, moving_base):
    """No impulse along a contact's free axes: a finger may go on rolling, a ball turning, a hinge swinging."""
    p, done = gripped(kind, seed, moving_base)
    for name, grasp in done.chain.grasps.items():
        axes = p.state.object_frame.R @ grasp.frame.R
        along = unrotate(axes, done.impulses[done.chain.names.index(name)])
        assert np.abs(along[list(grasp.free)]).max(initial=0.0) < 1e-14 * np.abs(along).max()
        assert np.abs(along[3:]).max() > 1e-3
    motion = chain_motion(done.chain, done.state, np.zeros(done.chain.joint_count), p.inputs.shaped(done.chain))
    rates = {name: c.W for name, c in zip(done.chain.grasps, motion.contacts, strict=True)}
    assert {name: len(W) for name, W in rates.items()} == {"arm1": 2, "arm2": KINDS.index(kind), "arm3": 0, "arm5": 3}
    assert all(np.abs(W).max(initial=1.0) > 1e-3 for W in rates.values())


def slider(mass: float, axis) -> Arm:
    """Return one body on a rail."""
    return Arm([Joint("prismatic", axis)], [Link(mass, [0, 0, 0], np.eye(3))])


def test_two_bodies_couple():
    """A wagon of 2 kg at 3 m/s couples to one of 4 kg at rest: 1 m/s, and 6 of 9 J are gone."""
    load = HeldObject(4.0, inertia=np.eye(3))
    chain = ClosedChain({"wagon": slider(2.0, [1.0, 0, 0])}, load, {})
    state = State([0.0], [3.0], [1, 0, 0, 0, 0, 0, 0])
    done = attach(chain, state, "wagon", Grasp("rigid"))
    np.testing.assert_allclose(done.state.qd, [1.0], rtol=1e-14)
    np.testing.assert_allclose(done.state.object_twist, [0, 0, 0, 1, 0, 0], atol=1e-14)
    np.testing.assert_allclose(done.impulses, [[0, 0, 0, 4, 0, 0]], atol=1e-14)
    np.testing.assert_allclose(done.base_impulses, np.zeros((1, 6)), atol=1e-14)  # along the rail
    assert done.energy_change == pytest.approx(-6.0, rel=1e-14)


@pytest.mark.parametrize("seed", range(2))
def test_impulses_that_are_not_unique(seed):
    """A third planar arm welded on: velocities, energy and momentum are unique, the smallest impulses returned."""
    p = as_chain(planar_three_arms(seed))
    chain = p.chain.without_grasp("arm2")
    qd = p.state.qd.copy()
    qd[chain.joints["arm2"]] += np.random.default_rng(seed).normal(size=7)
    state = State(p.state.q, qd, p.state.object_pose, p.state.object_twist)
    done = attach(chain, state, "arm2", p.chain.grasps["arm2"])
    assert done.status is Status.INDETERMINATE_FORCES
    change = kinetic_energy(done.chain, done.state) - kinetic_energy(chain, state)
    assert done.energy_change == pytest.approx(change, rel=1e-11)
    assert change < -1e-2
    motion = chain_motion(done.chain, state, np.zeros(19), Inputs().shaped(chain))
    s = Stacked(motion)
    _, sizes, Vt = np.linalg.svd(np.hstack([s.J, s.A]).T)
    unfelt = Vt[int((sizes > 1e-9 * sizes[0]).sum()) :]
    assert len(unfelt) == 6
    metric = np.tile(np.r_[np.full(3, length_scale([c.offset for c in motion.contacts]) ** -2), np.ones(3)], 3)
    assert np.abs(unfelt @ (metric * done.impulses.ravel())).max() < 1e-10 * np.abs(metric).max()
    assert largest_gaps(closure(done.chain, done.state))[1] < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_gripping_where_the_tip_is(kind):
    """The frame gives way as little as closes the grasp; contact and limits stay; without `here` it is refused."""
    p = random_problem(2, **OPTIONS)
    contact = Friction(0.5, half_length=0.1) if kind == "hinge" else None
    turned = rotation.exp(np.array([0.4, -0.2, 0.9]))
    grasp = Grasp(kind, Pose(turned, np.array([0.1, 0.2, 0.3])), contact, WrenchLimits(force=9.0))
    done = attach(p.chain, p.state, "arm2", grasp, here=True, inputs=p.inputs)
    made = done.chain.grasps["arm2"]
    tip = motion_before(p, done).arms["arm2"].at.tip
    seen = p.state.object_frame.inverse() @ tip
    np.testing.assert_allclose(made.frame.p, seen.p, atol=1e-14)
    if kind == "rigid":
        np.testing.assert_allclose(made.frame.R, seen.R, atol=1e-14)
    elif kind == "hinge":
        np.testing.assert_allclose(made.frame.R[:, 0], seen.R[:, 0], atol=1e-14)
        x, n, z = seen.R[:, 0], turned[:, 2], made.frame.R[:, 2]
        assert z @ n == pytest.approx(np.sqrt(1 - (x @ n) ** 2), rel=1e-12)  # no direction across x is nearer
    else:
        np.testing.assert_array_equal(made.frame.R, grasp.frame.R)
    assert (made.kind, made.contact, made.wrench_limits) == (kind, contact, grasp.wrench_limits)
    again = attach(p.chain, p.state, "arm2", made, inputs=p.inputs)
    np.testing.assert_array_equal(again.state.qd, done.state.qd)
    angle = r"" if kind in ("softfinger", "ball") else r" and \d\.?\d* rad"
    with pytest.raises(ClosureError, match=rf"arm 'arm2': its tip is 0\.\d+ m{angle} away from the grasp.*here=True"):
        attach(p.chain, p.state, "arm2", grasp, inputs=p.inputs)


def test_gap_within_the_tolerance():
    """A gap is measured against the tolerance given."""
    p = random_problem(2, **OPTIONS)
    made = attach(p.chain, p.state, "arm2", Grasp("ball"), here=True, inputs=p.inputs).chain.grasps["arm2"]
    off = replace(made, frame=Pose(made.frame.R, made.frame.p + np.array([1e-4, 0, 0])))
    with pytest.raises(ClosureError, match=r"its tip is 0\.0001 m away from the grasp, expected <= 1e-06"):
        attach(p.chain, p.state, "arm2", off, inputs=p.inputs)
    assert attach(p.chain, p.state, "arm2", off, inputs=p.inputs, tolerance=1.1e-4).chain.grasps["arm2"] is off


def test_a_hinge_along_the_normal():
    """A tip whose axis stands on the surface cannot grip by an edge."""
    tip = Pose(rotation.exp(np.array([0.0, -np.pi / 2, 0.0])), np.zeros(3))  # its x axis along z
    with pytest.raises(ClosureError, match=r"arm 'left': cannot grip by a hinge here.*along the contact's normal"):
        grasp_here(Grasp("hinge"), Pose.identity(), tip, "left")


def test_refused():
    """No such arm, an arm that holds already, a state that breaks a grasp."""
    p = random_problem(2, **OPTIONS)
    with pytest.raises(ModelError, match=r"grasp 'arm9': no such arm"):
        attach(p.chain, p.state, "arm9", Grasp("ball"))
    with pytest.raises(ModelError, match=r"grasp 'arm1': expected an arm without a grasp.*softfinger"):
        attach(p.chain, p.state, "arm1", Grasp("ball"), here=True, inputs=p.inputs)
    open_state = State(p.state.q + 0.1, p.state.qd, p.state.object_pose, p.state.object_twist)
    with pytest.raises(StateError, match="does not satisfy the grasps"):
        attach(p.chain, open_state, "arm2", Grasp("ball"), here=True, inputs=p.inputs)


def test_bases_that_cannot_be_followed():
    """Two sliders along x on bases that part along y: no velocities keep both grasps."""
    chain = ClosedChain(
        {"a": slider(1.0, [1.0, 0, 0]), "b": slider(1.0, [1.0, 0, 0])},
        HeldObject(1.0, inertia=np.eye(3)),
        {"a": Grasp("rigid")},
    )
    state = State([0.0, 0.0], [1.0, 0.0], [1, 0, 0, 0, 0, 0, 0], [0, 0, 0, 1, 0, 0])
    parting = Inputs(base_twists=[[0] * 6, [0, 0, 0, 0, 1, 0]])
    with pytest.raises(ClosureError, match=r"no velocities keep every grasp while the bases move.*a gap of"):
        attach(chain, state, "b", Grasp("rigid"), inputs=parting)
    alongside = Inputs(base_twists=[[0] * 6, [0, 0, 0, 2, 0, 0]])
    together = attach(chain, state, "b", Grasp("rigid"), inputs=alongside)
    np.testing.assert_allclose(together.state.qd, [4 / 3, 4 / 3 - 2], rtol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_letting_go(kind):
    """No impulse: the velocities keep the grasps that are left, and gripping again at once stops nothing."""
    p, done = gripped(kind, 3, True)
    opened = release(done.chain, "arm2")
    assert list(opened.grasps) == list(p.chain.grasps)
    forward_dynamics(opened, done.state, p.tau, inputs=p.inputs)  # refuses what does not hold
    again = attach(opened, done.state, "arm2", done.chain.grasps["arm2"], inputs=p.inputs)
    np.testing.assert_allclose(again.state.qd, done.state.qd, atol=1e-12)
    assert np.abs(again.impulses).max() < 1e-11 * np.abs(done.impulses).max()
    assert abs(again.energy_change) < 1e-12 * kinetic_energy(p.chain, p.state, p.inputs)
    with pytest.raises(ModelError, match="grasp 'arm2': no such grasp"):
        release(opened, "arm2")


def test_nobody_holds_any_more():
    """When the last arm lets go the object flies free: its mass centre falls with g, its spin is kept."""
    p = random_problem(1, grasps=("ball",), joints=(7,), moving_base=False, extras=False)
    opened = release(p.chain, "arm1")
    assert not opened.grasps
    found = forward_dynamics(opened, p.state, p.tau)
    body, frame, w = p.chain.held_object, p.state.object_frame, p.state.object_twist[:3]
    lever, I = frame.R @ body.com, frame.R @ body.inertia @ frame.R.T
    alpha = found.object_acceleration
    fall = alpha[3:] + np.cross(alpha[:3], lever) + np.cross(w, np.cross(w, lever))
    np.testing.assert_allclose(fall, p.chain.gravity, atol=1e-12)
    np.testing.assert_allclose(I @ alpha[:3] + np.cross(w, I @ w), 0, atol=1e-12)
