"""Hands that slide on the object against closed forms, and the laws of every such run."""

import numpy as np
import pytest

import holdfast as hf
from holdfast import Arm, ClosedChain, Friction, Grasp, Joint, Link, Pose, State
from holdfast.errors import MethodNotApplicable
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.world import HalfSpace, Touching, corners
from tests.simulation.gantries import BLOCK, LINK, REACH, SMALL, block, contact_frame, squeezed

G, MU = 9.81, 0.5
PADS = {
    "ball": Friction(MU),
    "softfinger": Friction(MU, torsion_radius=0.01),
    "hinge": Friction(MU, half_length=0.02),
}
STARTS, RATE, AGAIN, FIRM = 40.0, 60.0, 0.5, 50.0  # N, N/s, s, N


def jaw(side, moving=LINK, wrist=False):
    """Return one slide along world x on a side of the block, perhaps with a wrist about it."""
    frame = contact_frame(side)
    joints, links = [Joint("prismatic", [1, 0, 0], name="x")], [Link(moving, np.zeros(3), SMALL)]
    if wrist:
        joints.append(Joint("revolute", [1, 0, 0], name="turn"))
        links.append(Link(0.0, np.zeros(3), SMALL))
    return Arm(joints, links, tip=Pose(frame.R, np.zeros(3)), base=Pose(np.eye(3), frame.p))


def clamped(kind, contact, gravity=G, touching=None, wrist=False):
    """Return a block between two jaws that can move along x only."""
    arms = {"left": jaw(-1.0, wrist=wrist), "right": jaw(1.0)}
    grasps = {name: Grasp(kind, contact_frame(side), contact) for name, side in (("left", -1.0), ("right", 1.0))}
    chain = ClosedChain(arms, block(), grasps, np.array([0.0, 0.0, -gravity]), touching=touching)
    return chain, State(np.zeros(chain.joint_count), np.zeros(chain.joint_count), [1, 0, 0, 0, 0, 0, 0])


def relaxed(t, state, memory):
    """Squeeze less and less, until a firm grip again."""
    f = STARTS - RATE * t if t < AGAIN else FIRM
    return np.array([f, -f]), memory


relaxed.breakpoints = [AGAIN]


def events(run, kind):
    """Return the times and names of the log's entries of a kind."""
    return [(one.t, one.name) for one in run.occurrences if one.kind == kind]


def require_laws(run):
    """Check that the run is complete, and that energy, momentum and grasps are kept."""
    assert run.stopped is None
    np.testing.assert_allclose(run.imbalance, 0.0, atol=1e-9)
    assert run.position_gap[:, 1].max() <= 1e-14
    assert np.diff(run.impact).max() <= 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*PADS])
def test_slips_and_is_caught(kind):
    """A block slides down between two hands that yield, and is caught: every time and length is a polynomial."""
    chain, state = clamped(kind, PADS[kind])
    run = hf.simulate(chain, state, relaxed, 1.0, 0.1, on_slip="slide")
    require_laws(run)
    np.testing.assert_allclose(run.momentum_imbalance, 0.0, atol=1e-6)
    slips = (STARTS - BLOCK * G / (2.0 * MU)) / RATE
    fall = lambda s: MU * RATE * s**3 / (3.0 * BLOCK)  # noqa: E731  a = 2 mu RATE s / BLOCK
    s = AGAIN - slips
    speed, slowing = MU * RATE * s**2 / BLOCK, 2.0 * MU * FIRM / BLOCK - G
    assert sorted(events(run, "slip")) == [(pytest.approx(slips, abs=1e-12), name) for name in ("left", "right")]
    stops = AGAIN + speed / slowing
    assert sorted(events(run, "stick")) == [(pytest.approx(stops, abs=1e-12), name) for name in ("left", "right")]
    assert run.object_pose[-1, 6] == pytest.approx(-fall(s) - speed**2 / (2.0 * slowing), abs=1e-12)
    np.testing.assert_allclose(run.object_twist[-1], 0.0, atol=1e-12)
    assert run.holding[-1].all() and not run.holding[np.searchsorted(run.t, 0.5 * (slips + stops))].any()
    lost = run.work[-1].sum()  # all that gravity gave
    assert lost == pytest.approx(BLOCK * G * run.object_pose[-1, 6], abs=1e-9)
    sliding = (run.t > slips + 1e-9) & (run.t < stops - 1e-9)
    f = run.grasp_wrench[sliding, :, 3:]
    np.testing.assert_allclose(np.hypot(f[..., 1], f[..., 2]), MU * np.abs(f[..., 0]), rtol=1e-9)


@pytest.mark.slow
def test_one_hand_slides():
    """A hand is pushed along the block until it slides; the block and the other hand go on with its friction."""
    chain, state = squeezed(("ball", "rigid"), (Friction(0.3), None))
    f, rate = 20.0, 100.0

    def law(t, state, memory):
        return np.array([f, 0.0, rate * t, -f, 0.0, 0.0]), memory

    law.breakpoints = []
    run = hf.simulate(chain, state, law, 0.3, 0.05, on_slip="slide")
    require_laws(run)
    others = BLOCK + LINK
    slips = 0.3 * f * (others + LINK) / (others * rate)
    assert events(run, "slip") == [(pytest.approx(slips, abs=1e-12), "left")]
    s, v, z = run.t[-1] - slips, rate * slips**2 / (2.0 * (others + LINK)), rate * slips**3 / (6.0 * (others + LINK))
    assert run.object_pose[-1, 6] == pytest.approx(z + v * s + 0.5 * (0.3 * f / others) * s**2, abs=1e-12)
    pushed = (rate * slips - 0.3 * f) / LINK
    assert run.q[-1, 2] == pytest.approx(z + v * s + 0.5 * pushed * s**2 + rate * s**3 / (6.0 * LINK), abs=1e-12)
    assert [*run.holding[-1]] == [False, True]


@pytest.mark.slow
def test_soft_finger_spins():
    """A soft finger that is twisted turns block and wrist together, then spins with the moment e mu f."""
    e, f, rate = 0.02, 30.0, 1.0
    chain, state = clamped("softfinger", Friction(MU, torsion_radius=e), gravity=0.0, wrist=True)
    chain = hf.dynamics.release(chain, "right").with_grasp("right", Grasp("ball", contact_frame(1.0)))
    law = lambda t, state, memory: (np.array([f, rate * t, -f]), memory)  # noqa: E731
    run = hf.simulate(chain, state, law, 0.6, 0.1, on_slip="slide")
    require_laws(run)
    own, other = SMALL[0, 0], block().inertia[0, 0]
    slips = e * MU * f * (own + other) / (other * rate)
    assert events(run, "slip") == [(pytest.approx(slips, abs=1e-12), "left")]
    s = run.t[-1] - slips
    w = rate * slips**2 / (2.0 * (own + other))
    assert run.object_twist[-1, 0] == pytest.approx(w + e * MU * f * s / other, abs=1e-10)
    assert run.qd[-1, 1] == pytest.approx(w + ((rate * slips - e * MU * f) * s + 0.5 * rate * s**2) / own, abs=1e-10)


@pytest.mark.slow
def test_slides_and_spins_on_an_ellipsoid():
    """Friction opposes slip and spin together, and its force and moment lie on the ellipsoid."""
    e = 0.02
    chain, state = clamped("softfinger", Friction(MU, torsion_radius=e), wrist=True)

    def law(t, state, memory):
        f = 12.0 - 10.0 * t
        return np.array([f, 0.3, -f]), memory

    run = hf.simulate(chain, state, law, 0.04, 0.02, on_slip="slide")
    assert run.stopped is None and {name for _, name in events(run, "slip")} == {"left", "right"}
    state, f = run.state(len(run) - 1), run.grasp_wrench[-1, 0]
    n = state.object_frame.R[:, 0]
    tip, turns = np.array([state.q[0] - REACH, 0.0, 0.0]), np.array([state.qd[1], 0.0, 0.0])
    twist = state.object_twist
    u = twist[3:] + np.cross(twist[:3], tip - state.object_frame.p) - np.array([state.qd[0], 0.0, 0.0])
    assert abs(n @ u) <= 1e-12
    slip = np.append(u, e * (n @ (twist[:3] - turns)))
    friction = np.append(f[3:] - (n @ f[3:]) * n, n @ f[:3] / e)
    assert np.linalg.norm(friction) == pytest.approx(MU * (n @ f[3:]), rel=1e-9)
    np.testing.assert_allclose(friction / np.linalg.norm(friction), -slip / np.linalg.norm(slip), atol=1e-9)
    assert abs(slip[3]) > 0.05 * np.linalg.norm(slip)


@pytest.mark.slow
def test_lifts():
    """Hands whose force vanishes let go, at rest."""
    chain, state = clamped("ball", PADS["ball"], gravity=0.0)
    law = lambda t, state, memory: (np.array([1.0, -1.0]) * (10.0 - 50.0 * t), memory)  # noqa: E731
    run = hf.simulate(chain, state, law, 0.3, 0.02, on_slip="slide")
    require_laws(run)
    assert sorted(events(run, "release")) == [(pytest.approx(0.2, abs=1e-12), name) for name in ("left", "right")]
    assert not run.holding[-1].any()
    assert run.q[-1, 0] == pytest.approx(-50.0 * 0.1**3 / (6.0 * LINK), abs=1e-12)


@pytest.mark.long
def test_slides_onto_a_table():
    """A block slides down between two hands and lands: hands and table share one problem, also in the impact."""
    edges = (2 * REACH, 2 * REACH, 2 * REACH)
    touching = Touching(
        points=corners(*edges), world={"table": HalfSpace(normal=[0, 0, 1], offset=-REACH - 0.02, friction=0.4)}
    )
    chain, state = clamped("ball", PADS["ball"], touching=touching)
    law = lambda t, state, memory: (np.array([1.0, -1.0]) * max(25.0 - 50.0 * t, 12.0), memory)  # noqa: E731
    law.breakpoints = [0.26]
    run = hf.simulate(chain, state, law, 0.3, 0.02, on_slip="slide")
    require_laws(run)
    np.testing.assert_allclose(run.momentum_imbalance, 0.0, atol=1e-5)
    assert run.touch_gap.min() >= -1e-12
    assert run.object_pose[-1, 6] == pytest.approx(-0.02, abs=1e-12)
    assert {name for _, name in events(run, "stick")} >= {"left", "right"}
    assert run.impact[-1] < -1e-3


@pytest.mark.parametrize(
    ("argument", "value", "words"),
    [("contacts", "steps", "contacts='steps'"), ("scheme", "dop853", "adaptive"), ("base_motion", {}, None)],
)
def test_what_is_refused(argument, value, words):
    """What does not go with hands that slide is refused by name."""
    chain, state = clamped("ball", PADS["ball"])
    if words is None:
        value, words = {"left": lambda t: (jaw(-1.0).base, np.zeros(6), np.zeros(6))}, "bases that move"
    with pytest.raises(MethodNotApplicable, match=words):
        hf.simulate(chain, state, relaxed, 0.1, 0.02, on_slip="slide", **{argument: value})


@pytest.mark.slow
def test_resumes_to_the_bit():
    """From a checkpoint while hands slide, and from any other, a run goes on with the same bits."""
    chain, state = clamped("ball", PADS["ball"])
    kept = []
    given = (chain, state, relaxed, 0.6, 0.06)
    whole = hf.simulate(*given, on_slip="slide", on_checkpoint=kept.append)
    for saved in kept[6::6]:
        start = Checkpoint.from_data(*saved.to_data())
        rest = hf.simulate(*given, on_slip="slide", start=start)
        first = len(whole) - len(rest)
        for name in ("t", "q", "qd", "object_pose", "object_twist", "grasp_wrench", "work", "holding"):
            np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name)[first:], err_msg=name)
