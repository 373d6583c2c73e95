"""Contacts that give way at instants known on paper; gripping and letting go at given times: impacts, hand-overs."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Friction, Grasp, Pose
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.errors import ModelError, StateError
from holdfast.forces.margins import grasp_margins
from holdfast.model.grasp import WrenchLimits
from holdfast.simulation.events import Attach, Release
from holdfast.simulation.margins import giving_way
from holdfast.simulation.simulate import simulate
from tests.longer import mostly_slow
from tests.simulation.gantries import BLOCK, LINK, WRIST_INERTIA, block, contact_frame, squeezed
from tests.simulation.runs import limp

G = 9.81
MU = 0.5
STEP = 0.013  # divides nothing
DURATION = 0.1
GRID = 0.01


def linear(*torques):
    """Return the schedule from the first torques to the last, over the run."""
    return TorqueSchedule.linear(np.linspace(0.0, DURATION, len(torques)), torques)


def ramped_squeeze(first=30.0, last=10.0):
    """Two balls carry the block by friction while their internal force fades; when they slip."""
    chain, state = squeezed(("ball", "ball"), Friction(MU), gravity=G)
    lift = LINK * G + BLOCK * G / 2
    controller = linear(*([N, 0, lift, -N, 0, lift] for N in (first, last)))
    return chain, state, controller, (first - BLOCK * G / 2 / MU) / (first - last) * DURATION


def lifted_faster_and_faster():
    """A constant internal force while the lift grows; friction a finger is half the block's share of it."""
    chain, state = squeezed(("ball", "ball"), Friction(MU), gravity=G)
    N, first, last = 20.0, 20.0, 60.0
    controller = linear(*([N, 0, F, -N, 0, F] for F in (first, last)))
    # each finger's friction: m_b (a + g) / 2 = F m_b / (m_b + 2 m)
    slips = MU * N * (BLOCK + 2 * LINK) / BLOCK
    return chain, state, controller, (slips - first) / (last - first) * DURATION


def twisted():
    """A soft finger's wrist turns the block about the normal, harder and harder; a ball holds the other side."""
    e, N, T = 0.02, 20.0, 0.6
    chain, state = squeezed(("softfinger", "ball"), (Friction(MU, torsion_radius=e), Friction(MU)), ("x", ""))
    controller = linear(*([N, 0, 0, torque, -N, 0, 0] for torque in (0.0, T)))
    inertia = block().inertia[0, 0]
    share = inertia / (inertia + WRIST_INERTIA)  # of the wrist's torque that goes through the contact
    return chain, state, controller, MU * N * e / (share * T) * DURATION


def tipped():
    """Two edges along world y, pressed with N, while both wrists turn against each other about world z."""
    L, N, T = 0.03, 20.0, 1.0
    chain, state = squeezed(("hinge", "hinge"), Friction(MU, half_length=L), ("zx", "z"))
    controller = linear(*([N, 0, 0, torque, 0, -N, 0, 0, -torque] for torque in (0.0, T)))
    return chain, state, controller, L * N / T * DURATION


def tipped_sole():
    """Two soles instead, on which the wrists turn about world z: over their front edges, along contact y."""
    L, N, T = 0.03, 20.0, 1.0
    chain, state = squeezed(("sole", "sole"), Friction(MU, half_lengths=(L, 2.0)), ("z", "z"))
    controller = linear(*([N, 0, 0, torque, -N, 0, 0, -torque] for torque in (0.0, T)))
    return chain, state, controller, L * N / T * DURATION


def let_go():
    """The internal force passes through zero without any load: both fingers lift off."""
    chain, state = squeezed(("ball", "ball"), Friction(MU))
    return chain, state, linear(*([N, 0, 0, -N, 0, 0] for N in (10.0, -7.0))), 10 / 17 * DURATION


WAYS = ("rk4", 0.1), ("midpoint", 0.005), ("midpoint", 0.1), ("dop853", 0.1)  # scheme and step
CASES = {
    "slips": ramped_squeeze,
    "slips while lifted": lifted_faster_and_faster,
    "slips turning": twisted,
    "tips over its edge": tipped,
    "tips over its front edge": tipped_sole,
    "lifts off": let_go,
}


@pytest.mark.parametrize("case", mostly_slow(CASES, ("slips turning", "tips over its edge")))
def test_instant_of_giving_way(case):
    """The run ends at the instant known on paper, to 1e-12 s, and says which grasp does what, and when."""
    chain, state, controller, expected = CASES[case]()
    run = simulate(chain, state, controller, DURATION, STEP)
    assert run.t[-1] == pytest.approx(expected, abs=1e-12)
    words = {"slips while lifted": "slips", "slips turning": "slips"}.get(case, case)
    first = next(one for one in run.occurrences if f"'{one.name}'" in str(run.stopped))  # both may in one instant
    assert first.kind == "violation"
    assert run.stopped == f"grasp '{first.name}' {words} at t = {first.t:.12g} s"
    i = chain.names.index(first.name)
    assert abs(run.margin[-1, i]) < 1e-9
    assert abs(run.lowest_margin[-1, i] - run.margin[-1, i]) < 1e-14  # exactly, where forces are unique
    assert (run.lowest_margin[:-1, i] > 0).all()
    assert np.abs(run.imbalance).max() < 1e-9
    assert np.abs(run.momentum_imbalance).max() < 1e-9


@pytest.mark.parametrize(("scheme", "step"), mostly_slow(WAYS, WAYS[:1]))
def test_instant_does_not_depend_on_the_step(scheme, step):
    """Whatever takes the steps, and however long they are."""
    chain, state, controller, expected = ramped_squeeze()
    run = simulate(chain, state, controller, DURATION, step, scheme=scheme)
    assert run.t[-1] == pytest.approx(expected, abs=1e-12)


def test_record():
    """The run goes on as if the grasps held; when the margins come back is recorded, with the depth."""
    chain, state, _, _ = ramped_squeeze()
    lift = LINK * G + BLOCK * G / 2
    controller = linear(*([N, 0, lift, -N, 0, lift] for N in (30.0, 10.0, 30.0)))
    run = simulate(chain, state, controller, DURATION, STEP, on_slip="record")
    assert run.stopped is None
    assert run.t[-1] == DURATION
    need = BLOCK * G / 2 / MU
    for name in chain.names:
        begin, end = (one for one in run.occurrences if one.name == name)
        assert (begin.kind, end.kind) == ("violation", "recovery")
        assert begin.t == pytest.approx((30 - need) / 40 * DURATION, abs=1e-12)
        assert end.t == pytest.approx((need + 10) / 40 * DURATION, abs=1e-12)
        assert end.lowest == pytest.approx(MU * 10 - BLOCK * G / 2)
        assert end.lowest_time == pytest.approx(0.5 * DURATION)
    assert run.holding.all()


def test_release():
    """The grasp opens at its instant, no velocity jumps, and an object that nobody holds flies free."""
    chain, state, controller, expected = ramped_squeeze()
    moving = replace(state, qd=np.tile([0.0, 0.3, 0.0], 2), object_twist=[0, 0, 0, 0, 0.3, 0])
    run = simulate(chain, moving, controller, DURATION, STEP, on_slip="release")
    assert run.stopped is None
    assert (np.diff(run.t) > 0).all()
    assert sorted(one.kind for one in run.occurrences) == 2 * ["release"] + 2 * ["violation"]
    assert [one.t for one in run.occurrences] == pytest.approx(4 * [expected], abs=1e-12)
    last = int(np.flatnonzero(run.holding.all(axis=1))[-1])
    assert run.t[last + 2] - run.t[last] < 3e-15
    assert not run.holding[last + 2 :].any()
    for before, after in ((last, last + 1), (last + 1, last + 2)):
        assert np.array_equal(run.qd[before], run.qd[after])
        assert np.array_equal(run.object_twist[before], run.object_twist[after])
    assert np.allclose(run.object_acceleration[last + 2 :], [0, 0, 0, 0, 0, -G])
    fall = DURATION - run.t[last]
    assert run.object_twist[-1] == pytest.approx([0, 0, 0, 0, 0.3, -G * fall], abs=1e-9)
    assert not run.grasp_wrench[last + 2 :].any()
    assert np.isinf(run.margin[last + 2 :]).all()
    assert np.abs(run.imbalance).max() < 1e-12
    assert np.abs(run.momentum_imbalance).max() < 1e-12


def test_slipped_at_the_start():
    """What cannot hold from the first instant on stops there, with that one sample."""
    chain, state, controller, _ = ramped_squeeze(first=5.0, last=4.0)
    run = simulate(chain, state, controller, DURATION, STEP)
    assert len(run) == 1
    assert str(run.stopped).endswith("slips at t = 0 s")
    assert simulate(chain, state, controller, DURATION, STEP, on_slip="release").t[-1] == DURATION


def test_wrench_limits():
    """A two-sided grasp that is not strong enough gives way too."""
    chain, state = squeezed(("ball", "ball"))
    limits = WrenchLimits(force=15.0)
    weak = replace(chain, grasps={name: replace(x, wrench_limits=limits) for name, x in chain.grasps.items()})
    run = simulate(weak, state, linear(*([N, 0, 0, -N, 0, 0] for N in (10.0, 30.0))), DURATION, STEP)
    assert run.t[-1] == pytest.approx(0.25 * DURATION, abs=1e-12)
    assert "gives way to the force" in str(run.stopped)


def test_joint_limits():
    """Position, rate and effort: recorded by default with the joint's name, or the run stops there."""
    limits = {"position_limits": (-1.0, 0.005), "rate_limit": 0.3, "effort_limit": 8.0}
    chain, state = squeezed((None, None), **limits)
    force = np.array([4.0, 0, 0, 0, 0, 0])  # on LINK
    controller = TorqueSchedule.linear([0.0, 0.09, 0.1], [force, force, 3 * force])
    run = simulate(chain, state, controller, 0.1, STEP)
    assert run.stopped is None
    found = {one.quantity: one for one in run.occurrences}
    assert {one.name for one in run.occurrences} == {"left/x"}
    acceleration = 4.0 / LINK
    assert found["position"].t == pytest.approx(np.sqrt(2 * 0.005 / acceleration), abs=1e-9)
    assert found["rate"].t == pytest.approx(0.3 / acceleration, abs=1e-9)
    assert found["effort"].t == pytest.approx(0.09 + 0.01 / 2, abs=1e-12)
    k = int(np.argmin(run.lowest_joint_margin[:, 0]))
    assert chain.joint_names()[int(run.lowest_joint[k, 0])] == "left/x"
    stopped = simulate(chain, state, controller, 0.1, STEP, on_limit="stop")
    assert stopped.t[-1] == found["position"].t
    assert stopped.stopped == f"joint 'left/x' reaches its position limit at t = {found['position'].t:.12g} s"


@pytest.mark.slow
def test_not_unique_forces():
    """Where internal forces are unknown a margin is a range; the run ends only where none of them would hold."""
    e = 0.02
    chain, state = squeezed(("softfinger", "softfinger"), Friction(MU, torsion_radius=e), gravity=G)
    lift = LINK * G + BLOCK * G / 2
    controller = linear(*([N, 0, lift, -N, 0, lift] for N in (30.0, 10.0)))
    run = simulate(chain, state, controller, DURATION, 0.05)
    assert run.t[-1] == pytest.approx((30 - BLOCK * G / 2 / MU) / 20 * DURATION, abs=1e-9)
    assert (run.worst_margin == -np.inf).all()
    assert (run.best_margin >= run.margin - 1e-9).all()


def test_words():
    """Each way of giving way is named by the condition that is least."""
    hinge = Grasp("hinge", contact_frame(1.0), Friction(MU, half_length=0.01), WrenchLimits(force=50.0, moment=2.0))
    for wrench, words in (
        ([0, 0, 0, 8, 0, 10], "slips"),
        ([0, 0, 0, 0, 0, -1], "lifts off"),
        ([0, 0.3, 0, 0, 0, 10], "tips over its edge"),
        ([0, 0, 0, 0, 0, 60], "gives way to the force"),
        ([0, 0.01, 2.5, 0, 0, 20], "gives way to the moment"),
    ):
        assert giving_way(hinge, np.array(wrench, dtype=float)) == words


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"on_slip": "stopp"},
            "on_slip: expected one of stop, record, release, slide, got 'stopp'. Did you mean 'stop'?",
        ),
        ({"on_limit": "release"}, "on_limit: expected one of record, stop"),
        ({"scheme": "rk5"}, "no 'rk5'. Did you mean 'rk4'?"),
        ({"breakpoints": [np.nan]}, "breakpoints: expected finite numbers"),
    ],
)
def test_refused_options(options, message):
    """Unknown policies and schemes are refused by name."""
    chain, state, controller, _ = ramped_squeeze()
    with pytest.raises(ModelError) as caught:
        simulate(chain, state, controller, DURATION, STEP, **options)
    assert message in str(caught.value)


def test_margins_are_those_of_the_samples():
    """The margins of a run are `grasp_margins` of its samples, and the lowest since a sample not above them."""
    chain, state, controller, _ = ramped_squeeze()
    run = simulate(chain, state, controller, 0.05, STEP)
    for k in range(len(run)):
        assert run.margin[k] == pytest.approx(grasp_margins(chain, run.state(k), run.grasp_wrench[k]))
    assert (run.lowest_margin <= run.margin).all()
    assert (np.diff(run.lowest_margin_time, axis=0) >= 0).all()


def carried(v_block=0.4, v_arm=-0.2, wrist="xyz"):
    """Left carries the block along y at v_block; right moves beside it at v_arm, its tip at the contact at t = 0."""
    chain, state = squeezed(("rigid", None), wrists=("", wrist))
    qd = np.zeros(chain.joint_count)
    qd[1], qd[chain.joints["right"].start + 1] = v_block, v_arm
    return chain, state.__class__(state.q, qd, state.object_pose, [0, 0, 0, 0, v_block, 0])


def right_grasp(kind="rigid"):
    return Grasp(kind, contact_frame(1.0))


def test_hand_over():
    """One arm grips (an inelastic collision, known on paper), the other lets go: nothing else jumps."""
    chain, state = carried()
    t_grip, t_open = 0.033, 0.05
    events = [Release(t_open, "left"), Attach(t_grip, "right", right_grasp(), here=True)]
    run = simulate(chain, state, limp, 0.08, GRID, events=events)
    assert run.stopped is None
    grip, opened = run.occurrences
    assert (grip.kind, grip.t, grip.name) == ("attach", t_grip, "right")
    assert (opened.kind, opened.t, opened.name) == ("release", t_open, "left")

    jumps = np.flatnonzero(np.diff(run.t) < 1e-15)
    assert run.t[jumps + 1].tolist() == [t_grip, t_open]
    together = (0.4 * (BLOCK + LINK) - 0.2 * LINK) / (BLOCK + 2 * LINK)
    before, after = jumps[0], jumps[0] + 1
    assert run.object_twist[before, 4] == pytest.approx(0.4, abs=1e-12)
    assert run.object_twist[after:, 4] == pytest.approx(together, abs=1e-12)
    assert np.abs(run.q[before] - run.q[after]).max() <= 1e-15  # closed again, to rounding
    impulse = np.array(grip.impulses)
    assert impulse[1, 4] == pytest.approx(LINK * (-0.2 - together), abs=1e-12)  # what right's mass gave away
    assert impulse[0, 4] == pytest.approx(LINK * (0.4 - together), abs=1e-12)
    lost = 0.5 * (BLOCK + LINK) * 0.4**2 + 0.5 * LINK * 0.2**2 - 0.5 * (BLOCK + 2 * LINK) * together**2
    assert grip.energy_change == pytest.approx(-lost, abs=1e-12)
    assert run.impact[after] == grip.energy_change

    # no jump of any velocity where left lets go, and no force there either: nothing pulls
    before, after = jumps[1], jumps[1] + 1
    assert np.array_equal(run.qd[before], run.qd[after])
    assert np.array_equal(run.object_twist[before], run.object_twist[after])
    assert run.holding[before].tolist() == [True, True]
    assert run.holding[after].tolist() == [False, True]
    assert np.abs(run.grasp_wrench).max() < 1e-12
    assert np.abs(run.imbalance).max() < 1e-12
    assert np.abs(run.momentum_imbalance).max() <= 1e-12


def test_load_goes_over_without_a_spike():
    """Under gravity, held by commanded torques, the forces before and after are those of statics."""
    chain, state = squeezed(("rigid", None), wrists=("", "xyz"), gravity=9.81)
    own, load = LINK * 9.81, BLOCK * 9.81
    first = np.r_[0, 0, own + load, 0, 0, own, 0, 0, 0]
    last = np.r_[0, 0, own, 0, 0, own + load, 0, 0.1 * load, 0]
    controller = TorqueSchedule.linear([0.0, 0.02, 0.06], [first, first, last])
    events = [Attach(0.02, "right", right_grasp()), Release(0.06, "left")]
    run = simulate(chain, state, controller, 0.08, GRID, events=events)
    assert run.stopped is None
    assert np.abs(run.object_twist).max() < 1e-12
    assert run.grasp_wrench[0, 0, 5] == pytest.approx(load)
    assert run.grasp_wrench[-1, 1, 5] == pytest.approx(load)
    assert np.linalg.norm(run.grasp_wrench[:, :, 3:], axis=2).max() <= load * (1 + 1e-12)
    shares = run.load_share[:, 0]
    assert shares[0] == pytest.approx(1.0)
    assert shares[-1] == pytest.approx(0.0)
    assert np.abs(run.momentum_imbalance).max() <= 1e-12


def test_gap_is_refused():
    """An arm whose tip is not at the grasp does not grip: the run ends there with the gap; here=True grips."""
    chain, state = squeezed(("rigid", None), wrists=("", "xyz"))
    off = Grasp("rigid", Pose(contact_frame(1.0).R, contact_frame(1.0).p + np.array([0.0, 3e-3, 0.0])))
    run = simulate(chain, state, limp, 0.05, GRID, events=[Attach(0.025, "right", off)])
    assert run.t[-1] == np.nextafter(0.025, 0)
    assert "arm 'right': its tip is 0.003 m and 0 rad away" in str(run.stopped)
    taken = simulate(chain, state, limp, 0.05, GRID, events=[Attach(0.025, "right", off, here=True)])
    assert taken.stopped is None
    assert taken.holding[-1].all()


def test_released_object_is_free():
    """When the last arm lets go the object flies on by itself, and can be caught again."""
    chain, state = carried(v_arm=0.4)
    events = [Release(0.02, "left"), Attach(0.04, "right", right_grasp("ball"))]
    run = simulate(chain, state, limp, 0.06, GRID, events=events)
    assert run.stopped is None
    free = (run.t > 0.02) & (run.t < 0.04)
    assert not run.holding[free].any()
    assert run.object_twist[:, 4] == pytest.approx(0.4, abs=1e-12)
    assert np.abs(run.momentum_imbalance).max() <= 1e-12


def test_controllers_hear_of_other_grasps():
    """A controller that offers `for_chain` is asked for one whenever a grasp closes or opens."""
    seen = []

    class Listening:
        def __init__(self, chain):
            self.chain = chain

        def __call__(self, t, state, memory):
            return np.zeros(len(state.q)), memory

        def for_chain(self, chain):
            seen.append(tuple(chain.grasps))
            return Listening(chain)

    chain, state = carried()
    events = [Attach(0.01, "right", right_grasp(), here=True), Release(0.02, "left")]
    simulate(chain, state, Listening(chain), 0.05, GRID, events=events)
    assert seen == [("left", "right"), ("right",)]


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ([Release(0.01, "lft")], "release of 'lft' at t = 0.01 s: no such arm. Did you mean 'left'?"),
        ([Release(0.01, "right")], "the arm has no grasp then"),
        ([Release(0.01, "left"), Release(0.02, "left")], "the arm has no grasp then"),
        ([Attach(0.01, "left", right_grasp())], "the arm has a grasp already; try a release before it"),
        ([Release(0.0, "left")], "t: expected > 0"),
        ([Release(0.2, "left")], "expected a time within the run of 0.05 s"),
    ],
)
def test_impossible_events(events, message):
    """What cannot happen is refused before the first step."""
    chain, state = carried()
    with pytest.raises(ModelError) as caught:
        simulate(chain, state, limp, 0.05, GRID, events=events)
    assert message in str(caught.value)


def test_event_after_a_slip():
    """An arm that has slipped before it was to let go is logged as such; the run goes on."""
    chain, state, controller, _ = ramped_squeeze()
    run = simulate(chain, state, controller, DURATION, GRID, on_slip="release", events=[Release(0.09, "left")])
    assert run.stopped is None
    assert run.occurrences[-1].text == "'left' had let go before"


def test_event_at_the_end():
    """An event at the very end still happens."""
    chain, state = carried()
    run = simulate(chain, state, limp, 0.03, GRID, events=[Release(0.03, "left")])
    assert run.t[-1] == 0.03
    assert run.holding[-2:, 0].tolist() == [True, False]


def test_open_start_is_refused():
    """Grasps must hold at the start; an event does not excuse a gap."""
    chain, state = carried()
    with pytest.raises(StateError, match="does not satisfy the grasps"):
        simulate(chain, replace(state, q=state.q + 0.01), limp, 0.05, GRID, events=[Release(0.01, "left")])
