"""Contacts that give way at instants known on paper, and what a run does about it."""

import numpy as np
import pytest

from holdfast import Friction, ModelError
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.forces.margins import grasp_margins
from holdfast.model.grasp import WrenchLimits
from holdfast.simulation.margins import giving_way
from holdfast.simulation.simulate import simulate
from tests.simulation.gantries import BLOCK, LINK, WRIST_INERTIA, block, contact_frame, squeezed

G = 9.81
MU = 0.5
STEP = 0.013  # divides nothing
DURATION = 0.1


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


def let_go():
    """The internal force passes through zero without any load: both fingers lift off."""
    chain, state = squeezed(("ball", "ball"), Friction(MU))
    return chain, state, linear(*([N, 0, 0, -N, 0, 0] for N in (10.0, -7.0))), 10 / 17 * DURATION


CASES = {
    "slips": ramped_squeeze,
    "slips while lifted": lifted_faster_and_faster,
    "slips turning": twisted,
    "tips over its edge": tipped,
    "lifts off": let_go,
}


@pytest.mark.parametrize("case", CASES)
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
    assert run.lowest_margin[-1, i] == run.margin[-1, i]
    assert (run.lowest_margin[:-1, i] > 0).all()
    assert np.abs(run.imbalance).max() < 1e-9
    assert np.abs(run.momentum_imbalance).max() < 1e-9


@pytest.mark.parametrize(("scheme", "step"), [("rk4", 0.1), ("midpoint", 0.005), ("midpoint", 0.1), ("dop853", 0.1)])
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
    moving = state.__class__(state.q, np.tile([0.0, 0.3, 0.0], 2), state.object_pose, [0, 0, 0, 0, 0.3, 0])
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
    limited = {name: grasp.__class__(grasp.kind, grasp.frame, None, WrenchLimits(force=15.0)) for name, grasp in
               chain.grasps.items()}  # fmt: skip
    weak = chain.__class__(chain.arms, chain.held_object, limited, chain.gravity)
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
    from holdfast import Grasp

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
        ({"on_slip": "stopp"}, "on_slip: expected one of stop, record, release, got 'stopp'. Did you mean 'stop'?"),
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
