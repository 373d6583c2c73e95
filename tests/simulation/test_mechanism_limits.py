"""Limits and events in runs of chains with branches: margins, instants of violations, policies, impulses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import MethodNotApplicable
from holdfast.forces.margins import conditions
from tests.control.two_pandas import two_pandas
from tests.dynamics.tree.as_branched import AWAY, STRAY, gap
from tests.simulation.dips import Dips, found_dips
from tests.simulation.gantries import pressed
from tests.systems.branched import Branched, palletiser, two_arms_with_grippers

FRICTION = {"softfinger": hf.Friction(0.7, torsion_radius=0.02), "ball": hf.Friction(0.8)}  # one slips first


def constant(tau):
    """Return a controller with constant torques."""
    return lambda t, state, memory: (tau, memory)


def held_box():
    """Return two arms that press a box, with limits of everything, and the same beside an object that falls."""
    chain, state = two_pandas("softfinger", "ball")
    grasps = {name: replace(one, contact=FRICTION[one.kind]) for name, one in chain.grasps.items()}
    chain = replace(chain, grasps=grasps)
    beside = replace(chain, objects={"stray": STRAY})
    apart = replace(state, object_pose=[state.object_pose, AWAY], object_twist=np.zeros((2, 6)))
    return chain, state, beside, apart


def relaxing(chain, state):
    """Return torques that hold the box with an internal force that falls to nothing within 0.1 s."""
    tight, loose = (hf.control.GravityCompensation(chain, force)(0.0, state, None)[0] for force in (40.0, 0.0))
    return lambda t, at, memory: (tight + 10.0 * t * (loose - tight), memory)


def slipping(**policy):
    """Return the runs of a box that slips, as a serial chain and as a forest."""
    chain, state, beside, apart = held_box()
    law = relaxing(chain, state)
    given = {"duration": 0.06, "step": 4e-3, **policy}
    return hf.simulate(chain, state, law, **given), hf.simulate(beside, apart, law, **given)


@pytest.mark.slow
@pytest.mark.parametrize("on_slip", ["stop", "record"])
def test_margins_of_a_serial_chain(on_slip):
    """Run as a forest, a chain of serial arms has the margins of its own run, and slips at the same instant."""
    wanted, found = slipping(on_slip=on_slip)
    assert len(found) == len(wanted)
    assert gap(found.t, wanted.t) < 1e-9
    assert gap(found.margin, wanted.margin) < 1e-6
    assert gap(found.lowest_joint_margin, wanted.lowest_joint_margin) < 1e-6
    assert found.lowest_joint[:, [0, 2]].tolist() == wanted.lowest_joint[:, [0, 2]].tolist()  # all rates are alike
    first, theirs = found.occurrences[0], wanted.occurrences[0]
    assert (first.kind, first.name, first.quantity) == (theirs.kind, theirs.name, theirs.quantity)
    assert first.t == pytest.approx(theirs.t, abs=1e-9)
    assert (found.stopped is None) == (on_slip == "record")


def pendulum(**joint):
    """Return a bar that hangs on a joint with limits beside a loose object, which makes the chain a forest."""
    bar = hf.Link(2.0, [0, 0, -0.5], np.diag([0.2, 0.2, 0.01]), "bar")
    arm = hf.Arm([hf.Joint("revolute", [0, 1, 0], name="swing", **joint)], [bar])
    chain = hf.ClosedChain({"arm": arm}, objects={"stray": hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)})
    return Branched(chain, hf.State([0.3], [0.0], [AWAY.wxyz_xyz]), np.zeros(1))


def swing_through(angle: float) -> float:
    """Return when the bar, released at 0.3 rad, passes an angle, by quadrature of its energy integral."""
    from scipy.integrate import quad

    w2 = 2.0 * 9.81 * 0.5 / (0.2 + 2.0 * 0.25)

    def rate(s):  # with angle = 0.3 - s^2 the square root of cos(angle) - cos(0.3), over s, is regular
        return 2.0 / np.sqrt(2.0 * w2 * np.sin(0.3 - s * s / 2.0) * np.sinc(s * s / (2.0 * np.pi)))

    return quad(rate, 0.0, np.sqrt(0.3 - angle), epsabs=1e-13)[0]


def test_the_instant_of_a_limit():
    """A pendulum reaches the end of its range when its energy integral says, and stops there."""
    p = pendulum(position_limits=(-0.1, 1.0))
    run = hf.simulate(p.chain, p.state, constant(p.tau), 1.0, 1e-3, on_limit="stop")
    t = swing_through(-0.1)
    assert run.t[-1] == pytest.approx(t, abs=1e-9)
    assert run.q[-1, 0] == pytest.approx(-0.1, abs=1e-9)
    assert run.stopped == f"joint 'arm/swing' reaches its position limit at t = {run.t[-1]:.12g} s"
    assert run.lowest_joint_margin[:, 0].min() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_recorded_limits():
    """A recorded violation has the times at which it begins and ends, whatever the step."""
    p = pendulum(position_limits=(-0.1, 1.0), rate_limit=1.0)
    runs = [hf.simulate(p.chain, p.state, constant(p.tau), 1.4, h, every=e) for h, e in ((1e-3, 1), (2e-3, 7))]
    fine, coarse = ([(one.kind, one.quantity, one.t) for one in run.occurrences] for run in runs)
    assert {one[:2] for one in fine} == {(a, b) for a in ("violation", "recovery") for b in ("position", "rate")}
    assert [one[:2] for one in coarse] == [one[:2] for one in fine]
    assert gap([one[2] for one in coarse], [one[2] for one in fine]) < 1e-9
    assert runs[0].stopped is None
    assert runs[1].lowest_joint_margin[:, 0].min() == pytest.approx(runs[0].lowest_joint_margin[:, 0].min(), abs=1e-6)


def beside_stray(chain, state):
    """Return a serial chain with one object beside another that falls, which makes it a forest, and its state."""
    poses = [state.object_pose, AWAY.wxyz_xyz]
    return replace(chain, objects={"stray": STRAY}), replace(state, object_pose=poses, object_twist=np.zeros((2, 6)))


@pytest.mark.slow
@pytest.mark.parametrize(("count", "scheme"), [(8, "rk4"), (40, "midpoint")])  # by the reference, and by machine code
def test_dips(count, scheme):
    """Dips of a contact's margin from a quarter of a step on are found, of any shape, as those of serial chains."""
    h = 5e-3
    found_dips(Dips.random(count, h, 0.25, 1.5, seed=count), h, beside_stray(*pressed()), hf.ControlLaw, scheme=scheme)


@pytest.mark.parametrize("beyond", [1e-5, -1e-5])
def test_a_turning_point_within_a_step(beyond):
    """A pendulum that turns a little beyond the end of its range between two evaluations is found, and to 1e-9 s."""
    p = pendulum(position_limits=(-0.3 + beyond, 1.0))
    run = hf.simulate(p.chain, p.state, constant(p.tau), 1.0, 0.1, scheme="dop853", rtol=1e-11)
    turned, aside = 2.0 * swing_through(0.0), swing_through(0.3 - abs(beyond))
    passed = [turned - aside, turned + aside] if beyond > 0 else []
    k = int(np.searchsorted(run.t, turned))
    assert run.t[k] - run.t[k - 1] > 16.0 * aside  # no evaluation need lie in between
    assert run.lowest_joint_margin[:, 0].min() == pytest.approx(-beyond, abs=1e-9)
    assert [one.t for one in run.occurrences] == pytest.approx(passed, abs=1e-9)


def test_clipped_torques():
    """Torques beyond the effort limit are clipped; without that they are a violation."""
    p = pendulum(effort_limit=2.0)
    clipped = hf.simulate(p.chain, p.state, constant([5.0]), 0.02, 2e-3, on_limit="clip")
    assert clipped.tau.max() == 2.0 and not clipped.occurrences
    stopped = hf.simulate(p.chain, p.state, constant([5.0]), 0.02, 2e-3, on_limit="stop")
    assert len(stopped) == 1 and "effort limit" in stopped.stopped


def gripped(**contact):
    """Return arms with grippers that hold a box, the second one by a contact of its palm."""
    p = two_arms_with_grippers()
    key = ("arm2", "link6")
    grasps = {**p.chain.grasps, key: replace(p.chain.grasps[key], **contact)}
    return replace(p.chain, grasps=grasps), p, key


@pytest.mark.slow
def test_margins_by_frames():
    """The margin of a grasp by a frame is the least of its conditions on the wrench in contact axes."""
    chain, p, key = gripped(wrench_limits=hf.WrenchLimits(force=60.0, moment=8.0))
    run = hf.simulate(chain, p.state, constant(p.tau), 8e-3, 2e-3, on_slip="record")
    i = run.rows.index("arm2/link6")
    for k in range(len(run)):
        state = run.state(k)
        R = state.object_frame.R @ chain.grasps[key].frame.R
        wrench = np.concatenate([R.T @ half for half in np.split(run.grasp_wrench[k, i], 2)])
        assert run.margin[k, i] == pytest.approx(min(c.margin(wrench) for c in conditions(chain.grasps[key])))
    assert np.isinf(np.delete(run.margin, i, axis=1)).all()


@pytest.mark.slow
def test_a_loop_that_gives_way():
    """A parallelogram's pin that is too weak ends the run, and cannot be released."""
    chain, state, tau = palletiser()
    arm = chain.arms["robot"]
    level = arm.loops["level"]
    whole = hf.simulate(chain, state, constant(tau), 0.02, 2e-3)
    force = np.linalg.norm(whole.grasp_wrench[:, 0, 3:], axis=1)
    strength = float(force[3] + force[4]) / 2
    weak = replace(level, grasp=replace(level.grasp, wrench_limits=hf.WrenchLimits(force=strength)))
    limited = replace(chain, arms={"robot": replace(arm, loops={"level": weak})})
    run = hf.simulate(limited, state, constant(tau), 0.02, 2e-3)
    assert len(run) == 5 and whole.t[3] < run.t[-1] < whole.t[4] and "loop 'robot/level'" in run.stopped
    assert np.linalg.norm(run.grasp_wrench[-1, 0, 3:]) == pytest.approx(strength, abs=1e-9)
    with pytest.raises(MethodNotApplicable, match="loop 'robot/level' has limits"):
        hf.simulate(limited, state, constant(tau), 0.02, 2e-3, on_slip="release")


def test_a_function_is_called_at_stages():
    """Margins are looked at in eighths of every step, of joints and loops, with four calls of a function a step."""
    chain, state, tau = palletiser()
    arm = chain.arms["robot"]
    weak = replace(arm.loops["level"].grasp, wrench_limits=hf.WrenchLimits(force=1e4))
    limited = replace(arm, loops={"level": replace(arm.loops["level"], grasp=weak)})
    limited = replace(limited, joints=[replace(one, rate_limit=50.0) for one in arm.joints])
    calls, steps = [], 50

    def law(t, at, memory):
        calls.append(t)
        return tau * (1.0 + np.sin(100.0 * t)), memory

    run = hf.simulate(replace(chain, arms={"robot": limited}), state, law, steps * 1e-3, 1e-3)
    assert run.stopped is None and not run.occurrences
    assert len(calls) < 4 * steps + 40  # a few more to refine the lowest margins
    inside = run.lowest_margin_time[1:, 0] - run.t[:-1]
    assert ((inside > 1e-6) & (inside < 1e-3 - 1e-6)).any()


@pytest.mark.slow
def test_release_at_a_slip():
    """A grasp that slips opens if it is to be released, velocities stay, and the run goes on without it."""
    chain, p, _ = gripped(contact=hf.Friction(0.5, torsion_radius=0.02))
    run = hf.simulate(chain, p.state, constant(p.tau), 0.02, 2e-3, on_slip="release")
    kinds = [(one.kind, one.name) for one in run.occurrences]
    assert ("release", "arm2/link6") in kinds
    t = next(one.t for one in run.occurrences if one.kind == "release")
    k = int(np.searchsorted(run.t, t))
    i = run.rows.index("arm2/link6")
    assert run.holding[k, i] and not run.holding[k + 1 :, i].any()
    assert not run.grasp_wrench[k + 1 :, i].any()
    assert gap(run.qd[k + 1], run.qd[k]) == 0.0 and run.t[-1] == 0.02
    assert np.abs(run.imbalance).max() < 1e-7
