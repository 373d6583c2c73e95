"""A peg goes into a hole by an impedance law, from random starts: every one ends inserted, wedged, or off the chamfer.

    python -m benchmarks.peg_in_hole --count 200

Radius 10 mm, clearance 0.1 mm (of the radius), chamfer 2 mm, starts within 1 mm and 2 degrees. The peg is a free object
with the mass of a hand; the impedance pulls it down along a line through its start, in the attitude of its start. The
run is followed by impulses over steps of 4 ms.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np

import holdfast as hf
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial import rotation
from holdfast.world import Circle, Hole, Rod, Touching

RADIUS, CLEARANCE, CHAMFER = 0.01, 1e-4, 2e-3
HALF, EDGE = 0.03, 5e-4  # of the peg
OFFSET, TILT = 1e-3, np.radians(2.0)
SPEED, GOAL, DURATION, STEP = 0.08, 0.014, 0.3, 4e-3
MASS, INERTIA = 2.0, 5e-3
STIFFNESS, DAMPING = 2000.0, 126.0
TURNING_STIFFNESS, TURNING_DAMPING = 20.0, 0.6
INSERTED = 0.01  # depth of the tip from which it is inserted, five chamfers
PRESSING = 1e-6  # N


def peg_and_hole(friction: float) -> hf.ClosedChain:
    """Return the peg, whose rim meets the hole and whose side meets the hole's edge."""
    hole = Hole(radius=RADIUS + CLEARANCE, chamfer=CHAMFER, edge=1e-4, friction=friction)
    neck = hole.sides[-1].foot  # where the chamfer becomes the wall
    touching = Touching(
        {"rim": Circle([0, 0, EDGE - HALF], [0, 0, 1], RADIUS - EDGE, EDGE)},
        {"hole": hole},
        solids={"peg": Rod(radius=RADIUS, half_length=HALF, edge=EDGE, friction=friction)},
        edges={"edge": Circle([0, 0, neck[1]], [0, 0, 1], neck[0], hole.edge)},
    )
    return hf.ClosedChain({}, hf.HeldObject(MASS, INERTIA * np.eye(3)), {}, touching=touching)


def start_of(dice: np.random.Generator) -> hf.State:
    """Return a start within 1 mm and 2 degrees, the tip 1 mm above the plate."""
    out, along = OFFSET * np.sqrt(dice.uniform()), dice.uniform(0.0, 2.0 * np.pi)
    tilt, about = TILT * np.sqrt(dice.uniform()), dice.uniform(0.0, 2.0 * np.pi)
    R = rotation.exp(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
    tip = np.array([out * np.cos(along), out * np.sin(along), 1e-3])
    return hf.State([], [], hf.Pose(R, tip + HALF * R[:, 2]))


def insertion(chain: hf.ClosedChain, start: hf.State) -> Trajectory:
    """Return the run of one peg."""
    R, p = start.object_frame.R, start.object_frame.p

    def impedance(t: float, state: hf.State) -> hf.Inputs:
        """Return the wrench of springs and dampers from the line and the attitude of the start."""
        way = min(SPEED * t, GOAL + 1e-3)
        v = np.array([0.0, 0.0, -SPEED if way == SPEED * t else 0.0])
        now = state.object_frame
        force = STIFFNESS * (p - [0.0, 0.0, way] - now.p) + DAMPING * (v - state.object_twist[3:])
        moment = TURNING_STIFFNESS * rotation.log(R @ now.R.T) - TURNING_DAMPING * state.object_twist[:3]
        return hf.Inputs(object_wrench=np.concatenate([moment, force - MASS * chain.gravity]))

    def no_torque(t: float, state: hf.State, memory: object) -> tuple[np.ndarray, object]:
        return np.zeros(0), memory

    return hf.simulate(chain, start, no_torque, DURATION, STEP, inputs=impedance, contacts="steps")


def ending(run: Trajectory) -> str:
    """Return how a run ends: "inserted", the names of a wedge, "off the chamfer", or why none of these."""
    if run.stopped is not None:
        return f"stopped: {run.stopped}"
    assert run.setting is not None and run.setting.chain.touching is not None
    touching, held = run.setting.chain.touching, hf.Pose.from_wxyz_xyz(run.object_pose[-1])
    tip = held.p - HALF * held.R[:, 2]
    if -tip[2] >= INSERTED:
        return "inserted"
    force = run.touch_force[-1]
    size = np.linalg.norm(force, axis=1)
    pressing = np.flatnonzero(size > PRESSING)
    if len(pressing) and np.hypot(*tip[:2]) > RADIUS + CHAMFER:
        return "off the chamfer"
    for i in pressing:
        for j in pressing:
            rim, edge = touching.names[i], touching.names[j]
            if rim.startswith("rim") and edge.startswith("edge") and force[i, :2] @ force[j, :2] < 0.0:
                return "two-point wedge of the peg's rim and the hole's edge"
    return f"none: {1e3 * -tip[2]:.2f} mm deep, {len(pressing)} contacts"


def main() -> None:
    """Run pegs from random starts, and count how they end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--friction", type=float, default=0.2)
    given = parser.parse_args()
    chain, ends, deepest, begin = peg_and_hole(given.friction), Counter(), 0.0, time.perf_counter()
    for i in range(given.count):
        run = insertion(chain, start_of(np.random.default_rng([given.seed, i])))
        ends[how := ending(run)] += 1
        deepest = min(deepest, float(run.touch_gap.min()))
        if not how.startswith("inserted"):
            print(f"start {i}: {how}", flush=True)
        if (i + 1) % 10 == 0 or i + 1 == given.count:
            print(f"{i + 1} pegs, friction {given.friction:g}: {dict(ends)}; deepest gap {deepest:.1e} m", flush=True)
    print(f"{(time.perf_counter() - begin) / max(given.count, 1):.1f} s a peg")


if __name__ == "__main__":
    main()
