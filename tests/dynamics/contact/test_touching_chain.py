"""Contacts of chains: stored instants, laws of motion with them, and chains without them."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli.contact_answers import contact_answers
from holdfast.dynamics import ContactMode, ContactStatus, kinetic_energy
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.sequential import sequential, tips_of
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.dynamics.contact.touching_chain import chain_mobility, mobility_found, pushed, with_push
from holdfast.errors import ContactError, ModelError, StateError
from holdfast.world import HalfSpace, Touching, corners
from tests.derivatives.functions import problem
from tests.longer import mostly_slow
from tests.systems.problems import relative_gap
from tests.systems.stored_cases import stored_cases

CASES = stored_cases("cases_contact.json")
INSTANTS = [name for name, of in CASES.raw.items() if of["kind"] in ("impact", "rest", "sliding")]
RESTING = next(name for name, of in CASES.raw.items() if of["kind"] == "rest")
SOON = [name for name in INSTANTS if name.endswith(("_1", "sliding_3"))]


def block(friction=0.4, restitution=0.0, **more):
    """Return a box on a table and its state at rest there."""
    table = HalfSpace(friction=friction, restitution=restitution)
    touching = Touching(points=corners(0.3, 0.2, 0.1), world={"table": table})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.3, 0.2, 0.1), {}, touching=touching, **more)
    return chain, hf.State(np.zeros(0), np.zeros(0), hf.Pose.translation(0, 0, 0.05).wxyz_xyz, np.zeros(6))


@pytest.mark.parametrize("name", mostly_slow(INSTANTS, SOON))
def test_stored_instants(name):
    """Accelerations, velocities, net wrench, modes and forces are those found in 40 digits, to 1e-9."""
    (answer,) = contact_answers(CASES[name], ["sequential"])
    assert answer.status in ("OK", "INDETERMINATE_FORCES")
    assert answer.error < 1e-9


@pytest.mark.parametrize("method", ["kkt", "rccfd1"])
def test_other_methods(method):
    """Contact forces enter as any wrench on the object, so every method answers."""
    case = CASES[RESTING]
    (answer,) = contact_answers(case, [method])
    assert answer.error < 1e-9


@pytest.mark.parametrize("name", SOON[:4])
def test_the_impulse_is_shared(name):
    """The change of the object's momentum is the sum of the impulses of world and grasps; energy is their work."""
    case = CASES[name]
    hit = hf.touch(case.chain, case.state)
    after = hit.state
    assert np.array_equal(after.q, case.state.q)
    before = kinetic_energy(case.chain, case.state)
    assert kinetic_energy(case.chain, after) - before == pytest.approx(hit.energy_change, rel=1e-9)
    assert hit.energy_change < 0.0
    rows = contact_rows(case.chain.touching, after.object_frame, after.object_twist)
    assert rows.velocity(after.object_twist)[:, 2].min() > -1e-9
    assert hf.touch(case.chain, after).rounds == 0
    hf.forward_dynamics(case.chain, after, case.tau)  # the grasps still agree


def test_a_block_rests_slides_and_starts():
    """Coulomb's block: at rest below the angle of friction; mu g while it slides, g (sin - mu cos) on a slope."""
    chain, state = block()
    still = hf.forward_dynamics(chain, state, [])
    np.testing.assert_allclose(still.object_acceleration, 0.0, atol=1e-11)
    np.testing.assert_allclose(still.touch_force.sum(axis=0), [0, 0, 19.62], atol=1e-11)
    assert still.touch_status is ContactStatus.INDETERMINATE_FORCES
    slides = hf.forward_dynamics(chain, replace(state, object_twist=np.array([0, 0, 0, 0.2, 0, 0])), [])
    np.testing.assert_allclose(slides.object_acceleration, [0, 0, 0, -0.4 * 9.81, 0, 0], atol=1e-10)
    for angle, a in ((0.3, 0.0), (0.5, 9.81 * (np.sin(0.5) - 0.4 * np.cos(0.5)))):
        steep, _ = block(gravity=[9.81 * np.sin(angle), 0, -9.81 * np.cos(angle)])
        found = hf.forward_dynamics(steep, state, [])
        np.testing.assert_allclose(found.object_acceleration[3:], [a, 0, 0], atol=1e-10)
        closed = found.touch_mode[found.touch_gap < 0.05]
        assert set(closed) == {int(ContactMode.STICKS if a == 0.0 else ContactMode.SLIPS)}


def test_without_contact_nothing_changes():
    """A chain whose candidates are all open moves as one without touching, to the bit."""
    case = CASES[RESTING]
    plain = replace(case.chain, touching=None)
    far = replace(case.chain, touching=Touching({"p": [0, 0, 0]}, {"floor": HalfSpace(offset=-100.0, friction=1.0)}))
    first, second = (hf.forward_dynamics(chain, case.state, case.tau) for chain in (plain, far))
    for name in ("qdd", "grasp_wrench", "object_acceleration", "base_wrench"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
    assert first.touch_force is None
    assert not second.touch_force.any()


def test_restitution():
    """A flat box that falls on a table rebounds with e times its speed."""
    chain, state = block(0.3, 0.5)
    hit = hf.touch(chain, replace(state, object_twist=np.array([0, 0, 0, 0, 0, -2.0])))
    np.testing.assert_allclose(hit.state.object_twist, [0, 0, 0, 0, 0, 1.0], atol=1e-12)
    assert hit.energy_change == pytest.approx(-3.0, rel=1e-12)


def test_refusals():
    """What the laws do not allow is refused by name: an approach, a jam, a chain without touching."""
    chain, state = block()
    falls = replace(state, object_twist=np.array([0, 0, 0, 0, 0, -1.0]))
    with pytest.raises(StateError, match=r"approaches.*holdfast\.touch"):
        hf.forward_dynamics(chain, falls, [])
    with pytest.raises(ModelError, match="without touching"):
        hf.touch(replace(chain, touching=None), falls)
    with pytest.raises(ModelError, match="pairs"):
        Touching({"p": [0, 0, 0]}, {"floor": HalfSpace()}, [("p", "wall")])
    rod = CASES["contact_rod_1"]
    with pytest.raises(ContactError, match="jams") as caught:
        hf.forward_dynamics(rod.chain, rod.state, [])
    assert caught.value.status == "JAMMED"


@pytest.mark.parametrize("kind", ["plain", "trunk", "floating"])
def test_the_factors_at_hand_know_what_another_wrench_does(kind):
    """On a trunk, too, they give the mobility and the response to a push that an elimination of its own gives."""
    p = problem(kind)
    motion = chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain))
    tips, push = tips_of(motion), np.arange(1.0, 7.0)
    free, loaded = sequential(motion, tips=tips), pushed(motion, p.state, push)
    assert relative_gap(mobility_found(motion, free, tips), chain_mobility(motion, tips)) < 1e-13
    found, expected = with_push(loaded, free, tips, push), sequential(loaded, tips=tips)
    for name in ("qdd", "wrenches", "base_wrenches", "trunk"):
        pairs = zip(getattr(found, name), getattr(expected, name), strict=True)
        assert all(relative_gap(own, x) < 1e-12 for own, x in pairs if x is not None and len(x)), name
