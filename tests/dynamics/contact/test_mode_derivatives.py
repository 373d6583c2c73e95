"""Derivatives of forward dynamics in the modes of contacts, against dense equations of the modes written out here."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import ContactMode, ContactStatus
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.forces import ForceLimits, distribute
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.world import Ball, HalfSpace, Sphere, Touching, corners
from tests.systems.touched import touched_problem

RESULTS = ("qdd", "object_acceleration", "grasp_wrench", "touch_force")
BY = ("q", "qd", "tau", "object_pose", "object_twist", "object_wrench", "object_mass", "gravity")


def strict_problem(seed, slides):
    """Return a problem with torques that hold contacts in their modes with room."""
    p = touched_problem(seed, most=2, slides=slides)
    names = p.chain.touching.names
    limits = ForceLimits(effort=None, **{"least_normal" if slides else "least_margin": dict.fromkeys(names, 2.0)})
    found = distribute(p.chain, p.state, np.zeros(0), task=np.zeros((0, 6)), limits=limits, inputs=p.inputs)
    return replace(p, tau=found.tau), found.touch_status


def half_space_rows(touching, frame, twist):
    """Return C (k, 3, 6), drift, u and normals, (k, 3) each, of points on half-spaces at rest, world axes."""
    C, drift, u, normals = [], [], [], []
    for one in touching.candidates:
        arm = frame.R @ one.feature.centre
        C.append(np.hstack([np.array([np.cross(arm, e) for e in np.eye(3)]), np.eye(3)]))
        drift.append(np.cross(twist[:3], np.cross(twist[:3], arm)))
        u.append(twist[3:] + np.cross(twist[:3], arm))
        normals.append(one.shape.normal)
    return np.array(C), np.array(drift), np.array(u), np.array(normals)


def dense(p, modes, equations=half_space_rows):
    """Return the results of the equations of the modes: forward dynamics without contacts is affine in the wrench."""
    chain, state = p.chain, p.state
    bare = replace(chain, touching=None)
    C, drift, u, normals = equations(chain.touching, state.object_frame, state.object_twist)
    A, b, gives = [], [], []
    for j, n in enumerate(normals):
        if modes[j] == ContactMode.STICKS:
            A.append(C[j])
            b.append(drift[j])
            gives += [(j, e) for e in np.eye(3)]
        else:
            t = u[j] - n * (n @ u[j])
            A.append((n @ C[j])[None])
            b.append([n @ drift[j]])
            gives.append((j, n - chain.touching.candidates[j].shape.friction * t / np.linalg.norm(t)))
    A, b = np.vstack(A), np.concatenate(b)
    D = np.array([C[j].T @ give for j, give in gives])
    known = np.zeros(6) if p.inputs.object_wrench is None else p.inputs.object_wrench

    def free(w):
        inputs = replace(p.inputs, object_wrench=known + w)
        found = hf.forward_dynamics(bare, state, p.tau, inputs=inputs, check=False)
        return {name: getattr(found, name) for name in RESULTS[:3]}

    none = free(np.zeros(6))
    by_w = [{k: one[k] - none[k] for k in none} for one in (free(e) for e in np.eye(6))]
    P = np.array([one["object_acceleration"] for one in by_w]).T
    x = np.linalg.lstsq(A @ P @ D.T, -(A @ none["object_acceleration"] + b))[0]
    w = D.T @ x
    found = {name: none[name] + sum(own * one[name] for own, one in zip(w, by_w, strict=True)) for name in none}
    force = np.zeros((len(normals), 3))
    for (j, give), own in zip(gives, x, strict=True):
        force[j] += own * give
    return found | {"touch_force": force}


def moved(p, along, h):
    """Return a problem moved by a step along a direction in its arguments."""
    chain, state, inputs, tau = p.chain, p.state, p.inputs, p.tau
    values = {}
    for name, x in along.items():
        if name in ("q", "qd"):
            values[name] = getattr(state, name) + h * x
        elif name == "object_pose":
            frame = state.object_frame
            values["object_pose"] = Pose(rotation.exp(h * x[:3]) @ frame.R, frame.p + h * x[3:]).wxyz_xyz
        elif name == "object_twist":
            values[name] = state.object_twist + h * x
        elif name == "tau":
            tau = tau + h * x
        elif name == "object_wrench":
            known = np.zeros(6) if inputs.object_wrench is None else inputs.object_wrench
            inputs = replace(inputs, object_wrench=known + h * x)
        elif name == "gravity":
            chain = replace(chain, gravity=chain.gravity + h * x)
        else:
            chain = replace(chain, held_object=replace(chain.held_object, mass=chain.held_object.mass + h * float(x)))
    return replace(p, chain=chain, state=replace(state, **values), inputs=inputs, tau=tau)


STEPS = {"tau": 1.0, "object_wrench": 1.0, "gravity": 1.0}  # on which results depend linearly
STEPS["object_mass"] = 0.02  # shorter ones show the rounding of large accelerations
STEPS["object_twist"] = 1e-3  # that a slow slip has other directions nearby is beyond the eighth order of longer ones
WEIGHTS = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}  # central differences of order 8


def differences(function, h):
    """Return the derivative at 0 of a function of one number, of order 8."""
    found = {}
    for k, weight in WEIGHTS.items():
        up, down = function(k * h), function(-k * h)
        for name in up:
            found[name] = found.get(name, 0.0) + weight * (up[name] - down[name]) / h
    return found


def shape_of(p, name):
    """Return the shape of an argument's direction."""
    n = p.chain.joint_count
    return {"q": (n,), "qd": (n,), "tau": (n,), "object_mass": (), "gravity": (3,)}.get(name, (6,))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("slides", [False, True], ids=["sticks", "slides"])
def test_against_dense_equations(seed, slides):
    """Jacobian, rates and gradients agree with differences of the dense equations to 1e-9, and with each other."""
    p, status = strict_problem(seed, slides)
    if status is not ContactStatus.OK:
        return
    back = hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
    found = dense(p, back.touch_mode)
    for name in RESULTS:
        size = max(1.0, np.abs(found[name]).max())
        np.testing.assert_allclose(found[name], getattr(back, name), rtol=0, atol=1e-8 * size)
    fd = hf.forward_dynamics
    random = np.random.default_rng(seed)
    J = fd.jacobian(p.chain, p.state, p.tau, inputs=p.inputs, of=RESULTS, by=BY)
    for name in BY:
        x = random.normal(size=shape_of(p, name))
        expected = differences(
            lambda h, along={name: x}: dense(moved(p, along, h), back.touch_mode), STEPS.get(name, 4e-3)
        )
        rates = fd.jvp(p.chain, p.state, p.tau, inputs=p.inputs, along={name: x})
        for o in RESULTS:
            own = J[o, name]
            own = np.tensordot(own, x, axes=np.ndim(x)) if np.ndim(x) else own * x
            size = max(1.0, float(np.abs(expected[o]).max()))
            np.testing.assert_allclose(own, expected[o], rtol=0, atol=1e-9 * size, err_msg=f"{o} by {name}")
            if o != "touch_force":
                np.testing.assert_allclose(rates[o], own, rtol=0, atol=1e-11 * size)
    bars = {o: random.normal(size=J[o, "tau"].shape[:-1]) for o in RESULTS}
    gradient = fd.vjp(p.chain, p.state, p.tau, inputs=p.inputs, by=BY, **bars)
    for name in BY:
        expected = sum(np.tensordot(bars[o], J[o, name], axes=bars[o].ndim) for o in RESULTS)
        np.testing.assert_allclose(gradient[name], expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max()))


def block(mu=0.4, points=None):
    """Return a box of 2 kg on a table, with given points, and its state at rest there."""
    points = corners(0.3, 0.2, 0.1) if points is None else points
    touching = Touching(points, {"table": HalfSpace(friction=mu)})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.3, 0.2, 0.1), {}, touching=touching)
    return chain, hf.State(np.zeros(0), np.zeros(0), hf.Pose.translation(0, 0, 0.05).wxyz_xyz, np.zeros(6))


def test_a_block_that_slides():
    """Coulomb's block: dv/dt = -mu g v / |v| turns with v, grows with g, and does not depend on mass or place."""
    chain, state = block()
    v = np.array([0.3, 0.1, 0.0])
    state = replace(state, object_twist=np.r_[np.zeros(3), v])
    asked = {"of": ["object_acceleration"], "by": ["object_twist", "gravity", "object_mass", "object_pose"]}
    found = hf.forward_dynamics.jacobian(chain, state, np.zeros(0), **asked)
    t = v / np.linalg.norm(v)
    by_v = -0.4 * 9.81 / np.linalg.norm(v) * (np.eye(3) - np.outer(t, t))
    along = found["object_acceleration", "object_twist"]
    np.testing.assert_allclose(along[3:5, 3:5], by_v[:2, :2], atol=1e-10)
    np.testing.assert_allclose(found["object_acceleration", "gravity"][3:5, 2], 0.4 * t[:2], atol=1e-11)
    np.testing.assert_allclose(found["object_acceleration", "object_mass"], 0.0, atol=1e-11)
    slid = found["object_acceleration", "object_pose"][:, 3:5]
    np.testing.assert_allclose(slid, 0.0, atol=1e-11)


def test_a_ball_on_a_ball():
    """A sphere that slides on a ball, whose curvature is in its rows, against differences of forward dynamics.

    All directions are along motions on the ball: around it, with velocities that stay tangential.
    """
    touching = Touching({"sphere": Sphere(radius=0.1)}, {"ball": Ball(radius=0.5, friction=0.2)})
    chain = hf.ClosedChain({}, hf.HeldObject.sphere(1.0, 0.1), {}, touching=touching)

    def at(h):
        turn = rotation.exp(np.array([0.3, 0.2, 0.1]) + h * np.array([0.5, -0.2, 0.3]))
        twist = np.r_[0.3 + h, 0.1, 0.2 - 0.5 * h, 0.4, 0.3 + 2.0 * h, 0.0]
        frame = Pose(turn, turn @ np.array([0.0, 0.0, 0.6]))
        return hf.State([], [], frame.wxyz_xyz, np.r_[turn @ twist[:3], turn @ twist[3:]])

    def of(h):
        found = hf.forward_dynamics(chain, at(h), np.zeros(0))
        return {"object_acceleration": found.object_acceleration, "touch_force": found.touch_force}

    state, h = at(0.0), 1e-6
    ahead, behind = at(h), at(-h)
    turned = rotation.log(ahead.object_frame.R @ behind.object_frame.R.T) / (2.0 * h)
    shifted = (ahead.object_frame.p - behind.object_frame.p) / (2.0 * h)
    along = {
        "object_pose": np.r_[turned, shifted],
        "object_twist": (ahead.object_twist - behind.object_twist) / (2 * h),
    }
    assert np.isclose(at(0.0).object_frame.p @ state.object_twist[3:], 0.0)
    expected = differences(of, 4e-3)
    found = hf.forward_dynamics.jvp(chain, state, np.zeros(0), along=along)
    np.testing.assert_allclose(found.object_acceleration, expected["object_acceleration"], atol=1e-8)
    J = hf.forward_dynamics.jacobian(chain, state, np.zeros(0), of=["touch_force"], by=list(along))
    forces = sum(J["touch_force", name] @ x for name, x in along.items())
    np.testing.assert_allclose(forces, expected["touch_force"], atol=1e-8)


def test_a_table_shared_in_several_ways():
    """Motions have derivatives where forces are not unique; forces have none, and say so."""
    chain, state = block()
    found = hf.forward_dynamics.jacobian(chain, state, np.zeros(0), of=["object_acceleration"], by=["object_wrench"])
    np.testing.assert_allclose(found["object_acceleration", "object_wrench"], 0.0, atol=1e-11)
    with pytest.raises(StateError, match="unique forces"):
        hf.forward_dynamics.vjp(chain, state, np.zeros(0), touch_force=np.ones((8, 3)))


def test_open_contacts():
    """Open contacts change nothing."""
    chain, state = block()
    high = replace(state, object_pose=hf.Pose.translation(0, 0, 0.5).wxyz_xyz)
    bar, none = {"object_acceleration": np.arange(6.0)}, np.zeros(0)
    found = hf.forward_dynamics.vjp(chain, high, none, by=["object_wrench"], **bar)
    free = hf.forward_dynamics.vjp(replace(chain, touching=None), high, none, by=["object_wrench"], **bar)
    assert np.array_equal(found.object_wrench, free.object_wrench)
    rates = hf.forward_dynamics.jvp(chain, high, none, along={"gravity": np.eye(3)})
    np.testing.assert_allclose(rates.object_acceleration[:, 3:], np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gap": 1e-8}, "neither closed nor leaving"),
        ({"slope": np.arctan(0.4)}, "about to slip"),
        ({"slope": 0.6}, "begins to slip"),
        ({"pull": 2.0 * 9.81}, "lifts off"),
    ],
    ids=["grazing", "limit", "start", "lift"],
)
def test_modes_about_to_change(change, words):
    """Grazing, friction at its limit, a slip that begins and a contact that lifts are refused by name."""
    chain, state = block(points={"foot": [0.0, 0.0, -0.05]})
    angle = change.get("slope", 0.0)
    chain = replace(chain, gravity=[9.81 * np.sin(angle), 0, -9.81 * np.cos(angle)])
    raised = hf.Pose.translation(0, 0, 0.05 + change.get("gap", 0.0)).wxyz_xyz
    push = [0, -0.05 * 2.0 * 9.81 * min(0.4 * np.cos(angle), np.sin(angle)), 0, 0, 0, change.get("pull", 0.0)]
    inputs = hf.Inputs(object_wrench=push)  # against the moment of friction
    with pytest.raises(StateError, match=f"'foot/table' .*{words}"):
        hf.forward_dynamics.jacobian(chain, replace(state, object_pose=raised), np.zeros(0), inputs=inputs)


def test_what_has_none():
    """Machine code and linearisation refuse, by name."""
    chain, state = block()
    with pytest.raises(MethodNotApplicable, match="linearise"):
        hf.linearise(chain, state, np.zeros(0))
