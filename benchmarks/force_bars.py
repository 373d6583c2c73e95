"""Forces under limits on whole tasks, each number beside what is required of it.

    python -m benchmarks.force_bars [rest hand ...]         by default all of these, ten minutes of processor time

rest    accelerations of redundant joints of objects that stand still
hand    the Allegro hand holds a ball while its palm turns over (`make robots` fetches its description)
palm    steps of the torques while a hand turns over
bends   torques beside their limits while an elbow is straightened
tray    a mobile manipulator carries a tray 0.3 m
tape    gradients through a rollout whose law keeps friction and torques within limits, beside differences
paths   fastest timings of paths beside a joint programme (needs Clarabel)
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tests.control.test_timed_path import two_ur5e
from tests.control.three_pandas import three_pandas
from tests.control.two_pandas import rubber_pandas, two_pandas
from tests.systems.as_chain import as_chain
from tests.systems.special_systems import one_straight_arm_of_three

import holdfast as hf
from benchmarks import timed_paths
from benchmarks.timed_paths import wheeled
from holdfast.control.paths import pose_error
from holdfast.forces import Distribution, ForceCost, ForceLimits, distribute, lift_margin
from holdfast.spatial.scalar import Array

ROBOTS = Path(os.environ.get("HOLDFAST_ROBOTS", "results/robots"))
RADIUS = 0.03  # m
BALL = hf.HeldObject.sphere(0.15, RADIUS)
FINGERTIP = hf.Friction(mu=0.8, torsion_radius=0.005)
FINGERS = {"index": "link_3.0_tip", "middle": "link_7.0_tip", "ring": "link_11.0_tip", "thumb": "link_15.0_tip"}
OUTWARD = {  # from the centre of the ball to each fingertip, axes of the palm
    "index": (0.21, -0.19, 0.96),
    "middle": (0.22, -0.55, 0.81),
    "ring": (0.17, -0.77, 0.61),
    "thumb": (-0.21, 0.53, -0.82),
}
BALL_AT = hf.Pose.translation(0.088, 0.018, 0.016)  # in the palm's frame
BENDS = (1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
WANTED = np.array([3.0, -2.0, 1.0, 5.0, 8.0, -4.0])  # rad/s^2 and m/s^2
EFFORT = 25.0  # N m, of the arms that are straightened
WAY, TIME, SAMPLE = 0.3, 3.0, 0.01  # m, s, s
STEPS, STEP = 200, 0.002  # s


class Bar(NamedTuple):
    """A number and what is required of it.

    Attributes:
        what: the number in words, with its unit.
        value: the number.
        bound: what it must reach, or not exceed.
        at_most: whether the bound is an upper one.
    """

    what: str
    value: float
    bound: float
    at_most: bool = True

    @property
    def met(self) -> bool:
        """Whether it is as required."""
        return self.value <= self.bound if self.at_most else self.value >= self.bound

    def __str__(self) -> str:
        """Return the number, its bound, and whether it is met."""
        sign = "<=" if self.at_most else ">="
        return f"{self.what:75}{self.value:12.4g} {sign} {self.bound:<10g}{'met' if self.met else 'MISSED'}"


def efforts(chain: hf.ClosedChain) -> Array:
    """Return the effort limits of all joints."""
    return np.array([joint.effort_limit for joint in chain.all_joints])


def turned_over(chain: hf.ClosedChain, degrees: float) -> hf.ClosedChain:
    """Return the chain when everything has been turned about the world's y axis, as a turned gravity."""
    R = hf.Pose.from_rpy(0.0, np.radians(degrees), 0.0).R
    return replace(chain, gravity=R.T @ chain.gravity)


def touched(out: Array) -> hf.Grasp:
    """Return the grasp of a fingertip that touches the ball in the direction of a unit vector."""
    return hf.Grasp("softfinger", hf.contact_frame(RADIUS * out, into=-out), contact=FINGERTIP)


def allegro() -> tuple[hf.ClosedChain, hf.State] | None:
    """Return the Allegro hand with a ball on four fingertips; None if its description is not there."""
    files = sorted(ROBOTS.rglob("allegro_right_hand.urdf"))
    if not files:
        return None
    # some of the file's inertias are those of no body
    arms = hf.load_urdf_arms(files[0], {name: ("palm_link", tip) for name, tip in FINGERS.items()}, physical=False)
    grasps = {name: touched(np.array(out) / np.linalg.norm(out)) for name, out in OUTWARD.items()}
    chain, state = hf.assemble(arms, BALL, grasps, object_pose=BALL_AT)
    return chain, state


def hand() -> Iterator[Bar]:
    """Yield the least margin of the Allegro hand over 37 tilts of its palm, as forward dynamics returns it."""
    if (made := allegro()) is None:
        print(f"no Allegro hand in {ROBOTS}: make robots")
        return
    (chain, state), limits = made, ForceLimits(most_normal=5.0)
    margins, normals = [], []
    for tilt in range(0, 181, 5):
        tilted = turned_over(chain, tilt)
        found = distribute(tilted, state, limits=limits, form="margin")
        back = hf.forward_dynamics(tilted, state, found.tau)
        margins.append(hf.forces.grasp_margins(tilted, state, back.grasp_wrench).min())
        for name, grasp in chain.grasps.items():
            normals.append(back[name].grasp_wrench[3:] @ (state.object_frame.R @ grasp.frame.R)[:, 2])
    yield Bar("hand: least margin over 37 tilts [N]", min(margins), 0.6, at_most=False)
    yield Bar("hand: largest normal force [N]", max(normals), 5.0)


def turning(chain: hf.ClosedChain, state: hf.State, step: int = 3, **asked: Any) -> tuple[float, float]:
    """Return the largest step of a torque, relative to its limit, and the least margin, over half a turn."""
    found = [distribute(turned_over(chain, degrees), state, **asked) for degrees in range(0, 181, step)]
    steps = np.diff([one.tau for one in found], axis=0) / efforts(chain)
    return float(np.abs(steps).max()), min(one.margin for one in found)


def palm() -> Iterator[Bar]:
    """Yield how far torques step while three arms with a ball turn over, 3 degrees at a time."""
    chain, state = three_pandas()
    limits, free = ForceLimits(least_margin=0.5), ForceCost(acceleration=0.01)  # least effort, whatever moves
    step, margin = turning(chain, state, limits=limits, cost=free)
    yield Bar("palm: largest step of a torque, least effort at 0.5 N margin [limits]", step, 0.02)
    yield Bar("palm: least margin [N]", margin, 0.5 - 1e-6, at_most=False)
    held = [hf.holding_torques(turned_over(chain, degrees), state) for degrees in range(0, 181, 3)]
    gravity = np.abs(np.diff(held, axis=0) / efforts(chain)).max()
    usual, largest = turning(chain, state, limits=limits)[0], turning(chain, state, form="margin")[0]
    print(
        f"      (steps by the usual cost {usual:.3f}, of the torques that only hold {gravity:.3f}, of the largest"
        f" margin {largest:.2f})"
    )


def nearly_straight(bend: float) -> tuple[hf.ClosedChain, hf.State]:
    """Return three 6R arms with a part at rest; the elbows of two of them are bent by this angle [rad]."""
    made = as_chain(one_straight_arm_of_three(bend, which=(0, 1)))
    arms = {
        name: replace(arm, joints=[replace(joint, effort_limit=EFFORT) for joint in arm.joints])
        for name, arm in made.chain.arms.items()
    }
    return replace(made.chain, arms=arms), made.state.at_rest()


def excess(chain: hf.ClosedChain, found: Distribution) -> float:
    """Return by how much the torques pass their limits, relative to them; negative if they do not."""
    return float((np.abs(found.tau) / efforts(chain)).max()) - 1.0


def rest() -> Iterator[Bar]:
    """Yield how fast redundant joints accelerate where the object stands still, by the usual cost."""
    grip, plain = ForceLimits(0.8, least_margin=2.0), ForceLimits(0.8)
    chains = {
        "two arms, soft fingers": (*rubber_pandas(0.8), grip),
        "two arms, rigid": (*two_pandas(), plain),
        "three arms": (*three_pandas(), grip),
        "two 6-joint arms": (*two_ur5e(), grip),
        "two arms on a platform": (*wheeled(), plain),
    }
    for name, (chain, state, limits) in chains.items():
        state = state.at_rest()
        found, free = (
            distribute(chain, state, limits=limits, cost=ForceCost(acceleration=weight)) for weight in (1.0, 0.01)
        )
        used = [np.linalg.norm(one.tau / efforts(chain)) for one in (found, free)]
        yield Bar(f"rest: {name}: largest joint acceleration [rad/s^2]", float(np.abs(found.qdd).max()), 0.05)
        print(
            f"      (with a weight of 0.01: {np.abs(free.qdd).max():.2g} rad/s^2; effort {used[0]:.3f}, {used[1]:.3f})"
        )


def bends() -> Iterator[Bar]:
    """Yield by how much torques pass their limits near singular postures, for the nearest acceleration and a share."""
    yielding, shares, missed, quick = [], [], [], []
    for bend in BENDS:
        chain, state = nearly_straight(bend)
        nearest = distribute(chain, state, WANTED, cost=ForceCost(task=100.0))
        share = lift_margin(chain, state, WANTED)
        code = hf.compile(chain, parameters=["task_weight"]).distribute
        found = code(state.q, state.qd, state.object_pose, state.object_twist, WANTED, task_weight=100.0)
        quick.append(float((np.abs(found.tau) / efforts(chain)).max()) - 1.0)
        yielding.append(excess(chain, nearest))
        shares.append(excess(chain, share))
        back = hf.forward_dynamics(chain, state, nearest.tau).object_acceleration
        missed.append(float(np.abs(back - nearest.object_acceleration).max()))
        distance = np.linalg.norm(nearest.object_acceleration - WANTED) / np.linalg.norm(WANTED)
        exact = excess(chain, distribute(chain, state, WANTED)) + 1.0
        print(
            f"      (bend {bend:g}: exact {exact:.3g} limits, nearest off by {distance:.2g}, share {share.value:.2g})"
        )
    yield Bar("bends: torques of the nearest acceleration beyond their limits [limits]", max(yielding), 1e-9)
    yield Bar("bends: the same in machine code [limits]", max(quick), 1e-9)
    yield Bar("bends: torques of the largest share beyond their limits [limits]", max(shares), 1e-9)
    yield Bar("bends: forward dynamics misses the nearest acceleration by [m/s^2]", max(missed), 1e-10)


def carried(time: float = TIME) -> tuple[hf.ClosedChain, hf.simulation.Trajectory]:
    """Return a mobile manipulator that carries its tray forwards, and what it did."""
    chain, state = wheeled()
    trunk = chain.trunk
    assert trunk is not None
    path = hf.control.RestToRest(state.object_frame, [WAY, 0, 0], duration=TIME)
    kept, arms = ForceLimits(sample_time=SAMPLE), np.arange(chain.joint_count) >= len(trunk.joints)

    def law(t: float, now: hf.State, memory: Any) -> tuple[Array, Any]:
        goal = path.at(t)
        error = pose_error(goal.pose, now.object_frame)
        wanted = goal.acceleration + 20.0 * (goal.twist - now.object_twist) + 100.0 * error
        posture = np.where(arms, 25.0 * (state.q - now.q) - 10.0 * now.qd, -now.qd)
        cost = ForceCost(acceleration=10.0, joint_acceleration=posture)
        return distribute(chain, now, wanted, limits=kept, cost=cost).tau, memory

    return chain, hf.simulate(chain, state, law, time, SAMPLE, sample_time=SAMPLE)


def tray() -> Iterator[Bar]:
    """Yield what a mobile manipulator does that carries a tray: forces by `distribute`, its arms drawn to a posture."""
    chain, run = carried()
    low, high = np.array([joint.position_limits for joint in chain.all_joints]).T
    rates = np.array([joint.rate_limit for joint in chain.all_joints])
    elbows = [j for j, name in enumerate(chain.joint_names()) if name.endswith("/joint4")]
    yield Bar("tray: way of the base [mm]", 1e3 * float(run.q[-1, 0] - run.q[0, 0]), 200.0, at_most=False)
    bent = float(np.degrees(np.abs(run.q[:, elbows]).min()))
    yield Bar("tray: smallest angle from a straight elbow [degrees]", bent, 5.0, at_most=False)
    way = float(run.object_pose[-1, 4] - run.object_pose[0, 4])
    yield Bar("tray: miss of its 300 mm at the end [mm]", 1e3 * abs(way - WAY), 1.0)
    yield Bar("tray: torques [limits]", float((np.abs(run.tau) / efforts(chain)).max()), 1.0)
    yield Bar("tray: joint rates [limits]", float((np.abs(run.qd) / rates).max()), 1.0)
    yield Bar(
        "tray: joint positions beyond their limits [rad]", float(np.maximum(low - run.q, run.q - high).max()), 0.0
    )


def tape() -> Iterator[Bar]:
    """Yield how far the gradient through 200 steps of a lift by friction is from differences, at a barrier of 1e-5.

    The elbows reach the torque that is allowed on the way.
    """
    chain, state = rubber_pandas(0.8)
    lift = hf.control.RestToRest(state.object_frame, [0, 0, 0.1], duration=STEPS * STEP)
    motion = hf.control.ObjectImpedance(lift, [20.0] * 3 + [300.0] * 3, [8.0] * 3 + [60.0] * 3)
    limits, cost = ForceLimits(0.335, least_margin=2.0), ForceCost(barrier=1e-5)
    rollout = hf.compile_rollout(chain, hf.control.cooperative_law(chain, motion, limits=limits, cost=cost))
    random = np.random.default_rng(0)
    bar, begin = random.normal(size=chain.joint_count), np.repeat([0.05, 0.02], 3) * random.normal(size=6)

    def rolled(twist: Array) -> tuple[Any, float]:
        systems = rollout.start(state.q, state.qd, state.object_pose, twist)
        taken = rollout.tape(systems, STEP, steps=STEPS, record=["q", "tau", "margin"])
        return taken, float(taken.records["q"][-1, 0] @ bar + 1e-3 * taken.records["tau"].sum())

    found, _ = rolled(begin)
    used = float((np.abs(found.records["tau"]) / efforts(chain)).max())
    yield Bar("tape: largest torque, in parts of what is allowed", used / 0.335, 1.0 - 1e-3, at_most=False)
    yield Bar("tape: least margin [N]", float(found.records["margin"].min()), 2.0, at_most=False)
    along = {"tau": np.full((STEPS, 1, chain.joint_count), 1e-3)}
    slopes = found.vjp({"q": bar[None]}, along, by=["object_twist"]).object_twist[0]
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    ways = 1e-4 * np.eye(6)
    measured = [
        sum(w * (rolled(begin + k * way)[1] - rolled(begin - k * way)[1]) for k, w in weights.items()) / 1e-4
        for way in ways
    ]
    yield Bar(
        "tape: gradient through 200 steps beside differences, relative",
        float(np.abs(slopes - measured).max() / np.abs(measured).max()),
        1e-6,
    )


def paths() -> Iterator[Bar]:
    """Yield how much longer fastest timings take than a fine joint programme, and how far they pass limits."""
    for case in timed_paths.cases():
        one = timed_paths.measured(case)
        yield Bar(f"paths: {case.name}: time beyond a joint programme [%]", 100.0 * one.over, 1.0)
        yield Bar(f"paths: {case.name}: limits passed between nodes [N]", one.passed, 1e-3)
        print(f"      ({one.nodes} nodes, {one.seconds:.1f} s of processor time)")


TASKS = {task.__name__: task for task in (rest, hand, palm, bends, tray, tape, paths)}


def main() -> int:
    """Print every number beside its bound; return 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", choices=[*TASKS, []], metavar="task", help="by default all")
    missed = 0
    for name in parser.parse_args().tasks or TASKS:
        for bar in TASKS[name]():
            print(bar, flush=True)
            missed += not bar.met
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
