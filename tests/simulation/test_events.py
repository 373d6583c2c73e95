"""Gripping and letting go at given times: impacts known on paper, hand-overs without a spike."""

import numpy as np
import pytest

from holdfast import Grasp, ModelError, Pose, StateError
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.simulation.events import Attach, Release
from holdfast.simulation.simulate import simulate
from tests.simulation.gantries import BLOCK, LINK, contact_frame, squeezed
from tests.simulation.runs import limp

STEP = 0.01


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
    run = simulate(chain, state, limp, 0.08, STEP, events=events)
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
    run = simulate(chain, state, controller, 0.08, STEP, events=events)
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
    run = simulate(chain, state, limp, 0.05, STEP, events=[Attach(0.025, "right", off)])
    assert run.t[-1] == np.nextafter(0.025, 0)
    assert "arm 'right': its tip is 0.003 m and 0 rad away" in str(run.stopped)
    taken = simulate(chain, state, limp, 0.05, STEP, events=[Attach(0.025, "right", off, here=True)])
    assert taken.stopped is None
    assert taken.holding[-1].all()


def test_released_object_is_free():
    """When the last arm lets go the object flies on by itself, and can be caught again."""
    chain, state = carried(v_arm=0.4)
    events = [Release(0.02, "left"), Attach(0.04, "right", right_grasp("ball"))]
    run = simulate(chain, state, limp, 0.06, STEP, events=events)
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
    simulate(chain, state, Listening(chain), 0.05, STEP, events=events)
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
        simulate(chain, state, limp, 0.05, STEP, events=events)
    assert message in str(caught.value)


def test_event_after_a_slip():
    """An arm that has slipped before it was to let go is logged as such; the run goes on."""
    from tests.simulation.test_contacts import DURATION, ramped_squeeze

    chain, state, controller, _ = ramped_squeeze()
    run = simulate(chain, state, controller, DURATION, STEP, on_slip="release", events=[Release(0.09, "left")])
    assert run.stopped is None
    assert run.occurrences[-1].text == "'left' had let go before"


def test_event_at_the_end():
    """An event at the very end still happens."""
    chain, state = carried()
    run = simulate(chain, state, limp, 0.03, STEP, events=[Release(0.03, "left")])
    assert run.t[-1] == 0.03
    assert run.holding[-2:, 0].tolist() == [True, False]


def test_open_start_is_refused():
    """Grasps must hold at the start; an event does not excuse a gap."""
    chain, state = carried()
    away = state.__class__(state.q + 0.01, state.qd, state.object_pose, state.object_twist)
    with pytest.raises(StateError, match="does not satisfy the grasps"):
        simulate(chain, away, limp, 0.05, STEP, events=[Release(0.01, "left")])
