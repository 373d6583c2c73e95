"""Stiff damping: stock URDF files of hands, steps of a millisecond and a microsecond, and a thousand damped chains."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import tip_pose
from tests.acceptance.test_real_robots import FOLDER
from tests.control.two_pandas import two_pandas
from tests.simulation.damped import outcome, problem

pytestmark = pytest.mark.long
STEP, THOUSAND = 1e-3, 1000
FINGERS = {
    "index": ("link_3.0_tip", [0.0, 0.7, 0.6, 0.5]),
    "middle": ("link_7.0_tip", [0.0, 0.7, 0.6, 0.5]),
    "thumb": ("link_15.0_tip", [1.2, 0.5, 0.5, 0.6]),
}


def allegro(friction: bool) -> tuple[hf.ClosedChain, hf.State]:
    """Return three fingers of the hand with a ball of 0.2 kg between them, joints as in the file."""
    (file,) = FOLDER.rglob("allegro_right_hand.urdf")
    ends = {name: ("palm_link", tip) for name, (tip, _) in FINGERS.items()}
    arms = hf.load_urdf_arms(file, ends, lock_others=True, physical=False)
    assert all(3.0 <= joint.damping <= 10.0 and joint.armature == 0.0 for arm in arms.values() for joint in arm.joints)
    if not friction:
        arms = {
            name: replace(arm, joints=[replace(joint, friction=0.0) for joint in arm.joints])
            for name, arm in arms.items()
        }
    tips = {name: tip_pose(arm, FINGERS[name][1]) for name, arm in arms.items()}
    centre = np.mean([tip.p for tip in tips.values()], axis=0)
    rubber = hf.Friction(2.0)
    grasps = {
        name: hf.Grasp("ball", hf.contact_frame(tip.p - centre, centre - tip.p), rubber) for name, tip in tips.items()
    }
    chain = hf.ClosedChain(arms, hf.HeldObject.sphere(0.2, 0.03), grasps)
    q = np.concatenate([FINGERS[name][1] for name in arms])
    return chain, hf.close(chain, hf.State(q, np.zeros(12), hf.Pose.translation(*centre)), hold_object=True)


def pandas() -> tuple[hf.ClosedChain, hf.State]:
    """Return two Pandas without drives' inertias, damped by 20 N m s/rad."""
    chain, state = two_pandas()
    arms = {
        name: replace(arm, joints=[replace(joint, damping=20.0, armature=0.0) for joint in arm.joints])
        for name, arm in chain.arms.items()
    }
    return replace(chain, arms=arms), state


HANDS = {"hand": lambda: allegro(True), "hand without friction": lambda: allegro(False), "pandas": pandas}


@pytest.mark.parametrize("name", HANDS)
def test_a_thousandth_of_the_step(name):
    """To the end, without a false slip, within 1e-4 rad of steps of a microsecond; second order.

    The order is measured by the differences between the results of one step length and the next, whose ratio is
    2^order. The errors themselves contain what a jump of the torques at the start leaves, about 1e-10 rad for the hand
    with its dry friction, which does not depend on the step.
    """
    if "hand" in name and not any(FOLDER.rglob("allegro_right_hand.urdf")):
        pytest.skip("no robots fetched: make robots")
    chain, state = HANDS[name]()
    hold = hf.holding_torques(chain, state, internal_force=5.0)
    push = 0.5 * np.random.default_rng(0).normal(size=len(hold))
    law = hf.ControlLaw(lambda t, s, memory, given: (hold + push * (1 + 20 * t), memory))
    duration = 0.048
    run = hf.simulate(chain, state, law, duration, STEP)
    assert run.stopped is None
    assert {one.kind for one in run.occurrences} <= {"stiff"}
    rollout, implicit = hf.compile_rollout(chain, law), hf.compile_rollout(chain, law, scheme="imex")
    found = []
    given = state.q, state.qd, state.object_pose, state.object_twist
    true = rollout.start(*given)
    rollout.step(true, STEP / THOUSAND, steps=round(duration / STEP * THOUSAND))
    assert true.running.all()
    for step in (4e-3, 2e-3, 1e-3, 0.5e-3, 0.25e-3):
        systems = implicit.start(*given)
        implicit.step(systems, step, steps=round(duration / step))
        found.append(systems.q)
    errors = [np.abs(q - true.q).max() for q in found]
    changes = np.array([np.abs(more - less).max() for more, less in pairwise(found)])
    orders = np.log2(changes[:-1] / changes[1:])
    assert np.abs(run.q[-1] - true.q[0]).max() < 1e-4
    assert orders.min() > 1.95
    assert max(errors[2:]) < 1e-7
    moved = np.abs(true.q[0] - state.q).max()
    said = [one.text for one in run.occurrences]
    print(f"{name}: {said}; moved by {moved:.2g} rad, off by "
          + ", ".join(f"{error:.1e}" for error in errors) + " rad at 4, 2, 1, 0.5, 0.25 ms, orders "
          + ", ".join(f"{order:.2f}" for order in orders))  # fmt: skip


FAMILIES = 20
BATCH = 250


@pytest.mark.parametrize("batch", range(4))
def test_a_thousand_damped_chains(batch):
    """One or two arms of three to seven joints, all grasps, by rk4 and midpoint, against dop853 or finer steps."""
    begin = time.perf_counter()
    seeds = range(batch * BATCH, (batch + 1) * BATCH)
    found = [outcome(problem(seed, FAMILIES), "midpoint" if seed // FAMILIES % 5 == 0 else "rk4") for seed in seeds]
    stopped = [one.stopped for one in found if one.stopped is not None]
    sides = [[one for one in found if one.implicit is implicit] for implicit in (False, True)]
    worst = np.array([[max(getattr(one, name) for one in side) for name in ("position", "velocity")] for side in sides])
    explicit, implicit = (f"{len(side)}, right to {x:.1e} rad or m, {v:.1e} of velocities" for side, (x, v) in
                          zip(sides, worst, strict=True))  # fmt: skip
    ratios = [one.ratio for one in found]
    print(
        f"\n{len(found)} damped chains, h lambda {min(ratios):.2g} to {max(ratios):.2g}: by explicit steps {explicit};"
        f" by implicit ones {implicit}; {len(stopped)} stopped; {time.perf_counter() - begin:.0f} s",
        end="",
    )
    assert not stopped, stopped[:3]
    assert worst.max() <= 1e-3
    assert max(one.ratio for one in sides[0]) <= 0.9 * 2.7853
    assert min(one.ratio for one in sides[1]) > 1.8
