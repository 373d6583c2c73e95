"""Universal, sliding, cylindrical, screwed and planar grasps, against joints in their places and their positions."""

from dataclasses import replace

import mpmath
import msgspec
import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.io.typed import Location
from holdfast.model.fingerprint import fingerprint
from holdfast.scenario import parts
from holdfast.scenario.scene import GraspTable
from holdfast.simulation.checkpoint import _grasp, _grasp_data
from holdfast.spatial.spatial_vector import shift_twist
from tests.longer import mostly_slow
from tests.oracles.differenced_positions import Mechanism, exact, rotation_about
from tests.systems.lower_pairs import JOINTS, MOTIONS, PITCH, pair, with_lead
from tests.systems.problems import largest_gaps, relative_gap

ROWS = {"universal": (4, 4), "slider": (5, 5), "cylinder": (4, 4), "screw": (5, 5), "planar": (3, 3), "rigid": (6, 6)}


@pytest.fixture(scope="module", autouse=True)
def lead():
    """The joint type of a thread."""
    with pytest.MonkeyPatch.context() as patch:
        with_lead(patch)
        yield


MIXED = ("universal", "slider", "cylinder", "screw", "planar")
SYSTEMS = [*((kind, "rigid") for kind in JOINTS), *((kind, kind) for kind in MIXED), MIXED, (*MIXED, "ball")]


@pytest.mark.parametrize("kinds", SYSTEMS, ids="-".join)
@pytest.mark.parametrize("method", ["sequential", "kkt", "nonrigid"])
def test_joints_in_their_places(kinds, method):
    """Massless joints between tip and object, rigidly held, say the same: qdd, alpha(C), W_dot and every wrench."""
    p = pair(kinds, len(kinds))
    expected = hf.forward_dynamics(p.by_joints, p.same, p.torques_of_joints())
    found = hf.forward_dynamics(p.chain, p.state, p.tau, method=method)
    assert (largest_gaps(hf.dynamics.closure(p.chain, p.state)) < (1e-14, 1e-13)).all()
    assert relative_gap(found.qdd, expected.qdd[p.own]) < 1e-11
    assert relative_gap(found.object_acceleration, expected.object_acceleration) < 1e-11
    assert relative_gap(found.grasp_wrench, p.wrenches(expected)) < 1e-11
    others = np.delete(expected.qdd, p.own)
    if not {"planar", *MOTIONS} & set(
        kinds
    ):  # whose slides are along the object's axes, those of the joints along the tip's
        assert relative_gap(found.contact_acceleration[: len(others)], others) < 1e-11


def mechanism(chain: hf.ClosedChain, state: hf.State, links) -> Mechanism:
    """The chain from positions alone, grasps as lengths and angles; `links(name, q)` yields R, p and link."""
    body, frame = chain.held_object, state.object_frame

    def held(y):
        return rotation_about(y[-6:-3]) @ exact(frame.R), exact(frame.p) + y[-3:]

    def placed(y):
        return {name: list(links(name, y[:-6][chain.joints[name]])) for name in chain.arms}

    def poses(y):
        R, C = held(y)
        found = [(R, x + R @ exact(link.com)) for of_arm in placed(y).values() for R, x, link in of_arm]
        return [*found, (R, C + R @ exact(body.com))]

    def gaps(y):
        (R, C), ends, found = held(y), placed(y), []
        for name, grasp in chain.grasps.items():
            link_R, x, _ = ends[name][-1]
            tip, contact = chain.arms[name].tip, R @ exact(grasp.frame.R)
            T, shift = link_R @ exact(tip.R), x + link_R @ exact(tip.p) - C - R @ exact(grasp.frame.p)
            found += gap(grasp.kind, contact.T @ T, shift @ contact)
        return np.array(found)

    at_start = placed(np.concatenate([state.q, np.zeros(6)])).values()
    bodies = [*(link for of_arm in at_start for _, _, link in of_arm), body]
    masses, inertias = [mpmath.mpf(b.mass) for b in bodies], [exact(b.inertia) for b in bodies]
    return Mechanism(poses, gaps, masses, inertias, exact(chain.gravity))


def turned_links(chain: hf.ClosedChain):
    """Return the links of arms whose joints are turns about axes, for `mechanism`."""

    def links(name, q):
        arm = chain.arms[name]
        R, x = exact(arm.base.R), exact(arm.base.p)
        for joint, link, angle in zip(arm.joints, arm.links, q, strict=True):
            x = x + R @ exact(joint.placement.p)
            R = R @ exact(joint.placement.R) @ rotation_about(angle * exact(joint.axis))
            yield R, x, link

    return links


def gap(kind, T, p) -> list:
    """What vanishes, of a tip's attitude and place in contact axes."""
    x_across, all_across = [T[1, 0], T[2, 0]], [T[1, 0], T[2, 0], T[2, 1]]
    return {
        "rigid": lambda: [*p, *all_across],
        "universal": lambda: [*p, T[1, 0]],
        "cardan": lambda: [*p, T[1, 0]],
        "slider": lambda: [*p[1:], *all_across],
        "cylinder": lambda: [*p[1:], *x_across],
        "screw": lambda: [p[0] - PITCH * mpmath.atan2(T[2, 1], T[1, 1]), *p[1:], *x_across],
        "planar": lambda: [p[2], T[0, 2], T[1, 2]],
    }[kind]()


@pytest.mark.parametrize("kind", mostly_slow(MIXED, ("screw", "planar")))
def test_positions_alone(kind):
    """One dense system of what differences of the positions say, in 60 digits, has the same accelerations."""
    p = pair((kind, "rigid"), 11, joints=4)
    rates = np.concatenate([p.state.qd, p.state.object_twist])
    forces = np.concatenate([p.tau, np.zeros(6)])
    truth = mechanism(p.chain, p.state, turned_links(p.chain)).accelerations(
        np.concatenate([p.state.q, np.zeros(6)]), rates, forces
    )
    assert np.abs(truth["gap"]).max() < 1e-14
    assert np.abs(truth["rate"]).max() < 1e-12
    found = hf.forward_dynamics(p.chain, p.state, p.tau)
    assert relative_gap(found.qdd, truth["accelerations"][:-6]) < 1e-9
    assert relative_gap(found.object_acceleration, truth["accelerations"][-6:]) < 1e-9
    assert hf.dynamics.kinetic_energy(p.chain, p.state) == pytest.approx(truth["energy"], rel=1e-13)


@pytest.mark.parametrize("kinds", SYSTEMS, ids="-".join)
def test_closing(kinds):
    """Projected, closed or projected by machine code, a state beside the grasps comes onto all their rows."""
    p = pair(kinds, 5)
    random = np.random.default_rng(2)
    q = p.state.q + 1e-4 * random.normal(size=len(p.state.q))
    off = hf.State(q, p.state.qd, p.state.object_pose, p.state.object_twist)
    for closed in (hf.project(p.chain, off)[0], hf.close(p.chain, off)):
        gaps = hf.dynamics.closure(p.chain, closed)
        assert (largest_gaps(gaps) < (1e-12, 1e-12)).all()
        for grasp, gap in zip(p.chain.grasps.values(), gaps.values(), strict=True):
            counts = ROWS | {"ball": (3, 3), "subspace": (6 - len(grasp.free),) * 2}
            assert (len(gap.position), len(gap.velocity)) == counts[grasp.kind]


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("slider", "universal", "rigid"), ("screw", "planar", "cylinder")], ids="-".join)
def test_machine_code(kinds):
    """Compiled functions answer as the reference does, for one system and for a batch on other bases."""
    p = pair(kinds, 7, joints=4)
    chain, state = p.chain, p.state
    compiled = hf.compile(chain)
    given = {"q": state.q, "qd": state.qd, "object_pose": state.object_pose, "object_twist": state.object_twist}
    fast, found = compiled.forward_dynamics(tau=p.tau, **given), hf.forward_dynamics(chain, state, p.tau)
    for name in ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration"):
        assert relative_gap(getattr(fast, name), getattr(found, name)) < 1e-11
    away = hf.Pose(np.eye(3), np.array([0.3, -0.2, 0.5]))
    bases = {name: (away @ arm.base).wxyz_xyz for name, arm in chain.arms.items()}
    moved = hf.State(state.q, state.qd, (away @ state.object_frame).wxyz_xyz, state.object_twist)
    again = compiled.forward_dynamics(
        tau=np.tile(p.tau, (3, 1)),
        **given | {"object_pose": moved.object_pose},
        base_pose=np.array(list(bases.values())),
    )
    assert relative_gap(again.qdd[2], found.qdd) < 1e-11
    off = given | {"q": state.q + 1e-4}
    gaps, fast_gaps = hf.dynamics.closure(chain, hf.State(**off)), compiled.closure(**off)
    for name in chain.grasps:
        np.testing.assert_allclose(fast_gaps[name].position, gaps[name].position, atol=1e-14)
        np.testing.assert_allclose(fast_gaps[name].velocity, gaps[name].velocity, atol=1e-13)
    closed = compiled.project(**off)
    assert largest_gaps(hf.dynamics.closure(chain, hf.State(**{name: closed[name] for name in off}))).max() < 1e-12


@pytest.mark.parametrize("kinds", [MIXED, ("planar", "rigid")], ids="-".join)
def test_powers_and_torques(kinds):
    """Grasps have no power between them and the motion; inverse dynamics returns the torques; forces split."""
    p = pair(kinds, 3)
    chain, state = p.chain, p.state
    found = hf.forward_dynamics(chain, state, p.tau)
    motion, powers = chain_motion(chain, state, p.tau, hf.Inputs().shaped(chain)), []
    for arm, c, f in zip(motion.holding, motion.contacts, found.grasp_wrench, strict=True):
        powers += [f @ shift_twist(c.offset, state.object_twist), -f @ arm.tip_twist]
        np.testing.assert_allclose(c.HT.T @ f, 0.0, atol=1e-11)
    assert abs(sum(powers)) < 1e-11 * np.abs(powers).sum()
    assert relative_gap(hf.inverse_dynamics(chain, state, found.qdd, found.grasp_wrench), p.tau) < 1e-10
    split = hf.forces.split(chain, state, found.grasp_wrench)
    np.testing.assert_allclose(split.motion + split.internal, found.grasp_wrench, rtol=1e-12)
    net = sum(
        np.concatenate([f[:3] + np.cross(c.offset, f[3:]), f[3:]])
        for c, f in zip(motion.contacts, split.internal, strict=True)
    )
    np.testing.assert_allclose(net, 0.0, atol=1e-10)
    still = hf.State(state.q, 0.0 * state.qd, state.object_pose)
    tau = hf.holding_torques(chain, still)
    np.testing.assert_allclose(hf.forward_dynamics(chain, still, tau).object_acceleration, 0.0, atol=1e-9)


LONGER = [("slider", "universal"), ("screw", "rigid")]


@pytest.mark.parametrize(
    "kinds",
    [
        pytest.param(("cylinder", "planar"), marks=pytest.mark.slow),
        *(pytest.param(k, marks=pytest.mark.long) for k in LONGER),
    ],
    ids="-".join,
)
def test_simulation(kinds):
    """Runs without torques keep energy and grasps, and a rollout is the same run."""
    p = pair(kinds, 9, joints=4)
    chain, n = p.chain, p.chain.joint_count
    run = hf.simulate(chain, p.state, lambda t, state, memory: (np.zeros(n), memory), 0.1, 1e-3)
    assert run.stopped is None
    assert run.position_gap[:, 1].max() < 1e-12
    first, last = (
        hf.dynamics.kinetic_energy(chain, state) + hf.dynamics.potential_energy(chain, state)
        for state in (run.state(0), run.state(-1))
    )
    assert last == pytest.approx(first, rel=1e-10)
    rollout = hf.compile_rollout(chain, hf.ControlLaw(lambda t, state, memory, given: (0.0 * state.qd, memory)))
    systems = rollout.start(np.tile(p.state.q, (2, 1)), p.state.qd, p.state.object_pose, p.state.object_twist)
    rollout.step(systems, 1e-3, steps=100)
    assert systems.running.all()
    np.testing.assert_allclose(systems.q[1], run.state(-1).q, atol=1e-11)


def test_a_thread_turns_on():
    """After two whole turns the screw has gone two leads; between them it is open by what is missing."""
    kind = hf.Grasp("screw", pitch=PITCH).of_kind
    lead = 2 * np.pi * PITCH
    for turns in (-1.25, 0.0, 2.0):
        tip = hf.Pose.from_rpy(2 * np.pi * turns, 0.0, 0.0).R
        on, off = (kind.across(np.array([turns * lead + x, 0.0, 0.0]), tip, np.arctan2)[0] for x in (0.0, 0.01))
        assert on == pytest.approx(0.0, abs=1e-14) and off == pytest.approx(0.01, rel=1e-12)


@pytest.mark.parametrize("kind", JOINTS)
def test_gripping(kind):
    """A grasp made where the tip is, is closed; `assemble` finds a configuration for it too."""
    p = pair((kind, "rigid"), 4)
    free = p.chain.without_grasp("arm0")
    made = hf.dynamics.attach(free, p.state, "arm0", p.chain.grasps["arm0"], here=True)
    assert (largest_gaps(hf.dynamics.closure(made.chain, made.state)) < (1e-12, 1e-11)).all()
    chain, state = hf.assemble(p.chain.arms, p.chain.held_object, p.chain.grasps, object_pose=p.state.object_pose)
    assert (largest_gaps(hf.dynamics.closure(chain, state)) < (1e-10, 1e-10)).all()


def test_what_cannot_be():
    """Pitches where there is no thread, and threads without one; MJCF has none of these grasps."""
    with pytest.raises(hf.errors.ModelError, match="a screw grasp needs a pitch"):
        hf.Grasp("screw")
    with pytest.raises(hf.errors.ModelError, match="a hinge grasp has no pitch"):
        hf.Grasp("hinge", pitch=0.1)
    with pytest.raises(hf.errors.ModelError, match=r"pitch: expected at least 1e-06 m/rad, got 0\.0; try a hinge"):
        hf.Grasp("screw", pitch=0.0)
    with pytest.raises(hf.errors.ModelError, match="a slider grasp is two-sided"):
        hf.Grasp("slider", contact=hf.Friction(0.5))
    p = pair(("slider", "rigid"), 4)
    with pytest.raises(hf.errors.ModelError, match="no equality of MJCF says what a slider grasp does"):
        hf.interop.to_mjcf(p.chain)


NAMED = {
    "hinge": np.eye(6)[:, [0]],
    "ball": np.eye(6)[:, :3],
    "slider": np.eye(6)[:, [3]],
    "cylinder": np.eye(6)[:, [0, 3]],
    "screw": np.eye(6)[:, [0]] + PITCH * np.eye(6)[:, [3]],
    "planar": np.eye(6)[:, 2:5],
}


@pytest.mark.parametrize("kind", NAMED)
def test_motions_given_by_hand(kind):
    """Given as twists at a tip that stands elsewhere, askew and mixed, a joint is what its name says."""
    p = pair((kind, "rigid"), 6)
    chain, state, aside = p.chain, p.state, hf.Pose.from_rpy(0.3, -0.5, 0.8, [0.2, -0.1, 0.15])
    arm, grasp = chain.arms["arm0"], chain.grasps["arm0"]
    turn, slide = np.split(NAMED[kind], 2)
    there = aside.R @ turn, aside.R @ slide + np.cross(aside.p, aside.R @ turn, axis=0)
    random = np.random.default_rng(1)
    mixed = np.vstack(there) @ random.normal(size=(turn.shape[1],) * 2)
    other = hf.ClosedChain(
        chain.arms | {"arm0": arm.with_tip(arm.tip @ aside.inverse())},
        chain.held_object,
        chain.grasps | {"arm0": hf.Grasp("subspace", grasp.frame @ aside.inverse(), motion=mixed)},
    )
    assert (largest_gaps(hf.dynamics.closure(other, state)) < (1e-14, 1e-13)).all()
    expected = hf.forward_dynamics(chain, state, p.tau)
    for method in ("sequential", "kkt", "nonrigid"):
        found = hf.forward_dynamics(other, state, p.tau, method=method)
        assert relative_gap(found.qdd, expected.qdd) < 1e-11
        assert relative_gap(found.object_acceleration, expected.object_acceleration) < 1e-11
        np.testing.assert_allclose(found.grasp_wrench[0, 3:], expected.grasp_wrench[0, 3:], atol=1e-9)
    off = hf.State(state.q + 1e-4 * random.normal(size=14), state.qd, state.object_pose, state.object_twist)
    for closed in (hf.project(other, off)[0], hf.close(other, off)):
        for one in (chain, other):  # closed for one, closed for the other
            assert (largest_gaps(hf.dynamics.closure(one, closed)) < (1e-12, 1e-12)).all()


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("scara", "lead in a plane", "rigid")], ids="-".join)
def test_machine_code_by_hand(kinds):
    """Machine code of motions given by hand: accelerations, wrenches, gaps and projection."""
    test_machine_code(kinds)


REFUSED = {
    "a soft finger's": (np.eye(6)[:, :2], "closed under the bracket"),
    "a turn and a slide across": (np.eye(6)[:, [0, 4]], "closed under the bracket"),
    "nothing held": (np.eye(6), "expected shape"),
    "nothing free": (np.zeros((6, 0)), "expected shape"),
    "rows": (np.eye(6)[:2], "expected shape"),
    "zeros": (np.zeros((6, 1)), "linearly independent"),
    "twice": (np.ones((6, 2)), "linearly independent"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_no_group(name):
    """What is no group's is refused, whatever the tip's axes."""
    motion, message = REFUSED[name]
    with pytest.raises(hf.errors.ModelError, match=message):
        hf.Grasp("subspace", motion=motion)


def test_the_lengths_of_columns_do_not_matter():
    """Not even where their squares overflow or vanish."""
    usual, odd = np.eye(6)[:, [2, 5]], np.eye(6)[:, [2, 5]] * [1e200, 1e-200]
    given = [hf.Grasp("subspace", motion=motion).of_kind.given for motion in (usual, odd)]
    assert given[0] == replace(given[1], columns=given[0].columns)


def test_motion_and_kind():
    """A subspace needs a motion, and no other kind has one."""
    with pytest.raises(hf.errors.ModelError, match="a subspace grasp needs a motion"):
        hf.Grasp("subspace")
    with pytest.raises(hf.errors.ModelError, match="a ball grasp has no motion"):
        hf.Grasp("ball", motion=np.eye(6)[:, :3])


def test_files():
    """Scenes tell pitches and motions; a run that is left and goes on knows them."""
    twists = [[0.0, 0.0, 1.0, 0.1, 0.2, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]
    for keys, expected in (
        ({"kind": "screw", "pitch": -0.02}, hf.Grasp("screw", pitch=-0.02)),
        ({"kind": "subspace", "motion": twists}, hf.Grasp("subspace", motion=np.transpose(twists))),
    ):
        read = parts.grasp(msgspec.convert({"arm": "left", **keys}, GraspTable), Location("scene.toml"))
        assert fingerprint(read) == fingerprint(expected)
        arrays = {}
        name, kept = _grasp(_grasp_data("left", expected, arrays), arrays)
        assert (name, fingerprint(kept)) == ("left", fingerprint(expected))
