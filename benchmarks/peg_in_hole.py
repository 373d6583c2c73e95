"""A peg goes into a hole by an impedance law, from random starts: every one ends inserted, wedged, or off the chamfer.

    python -m benchmarks.peg_in_hole --count 200

Radius 10 mm, clearance 0.1 mm (of the radius), chamfer 2 mm, starts within 1 mm and 2 degrees. The peg is a free object
with the mass of a hand; the impedance, sampled every millisecond, pulls it down along a line through its start, in the
attitude of its start. All pegs are one rollout, with impulses of contacts in steps of 1 ms.

Printed are how they end, the deepest gap, and the largest work of contacts in a step, which a world at rest never does.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from typing import NamedTuple

import numpy as np

import holdfast as hf
from holdfast.simulation import RolloutStatus
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.world import Circle, Hole, Rod, Touching

RADIUS, CLEARANCE, CHAMFER = 0.01, 1e-4, 2e-3
HALF, EDGE = 0.03, 5e-4  # of the peg
OFFSET, TILT = 1e-3, np.radians(2.0)
SPEED, GOAL, DURATION, STEP = 0.08, 0.014, 0.3, 1e-3
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


class Insertions(NamedTuple):
    """What the runs of pegs show.

    Attributes:
        systems: the pegs at the end.
        deepest: (pegs,) lowest gap [m].
        work: (pegs,) largest work of contacts in a step [J].
    """

    systems: RolloutSystems
    deepest: Array
    work: Array


def insertions(chain: hf.ClosedChain, starts: list[hf.State]) -> Insertions:
    """Return the runs of pegs."""
    rollout, count = hf.compile_rollout(chain), len(starts)
    begin, none = np.array([start.object_pose for start in starts]), np.zeros((count, 0))
    systems = rollout.start(none, none, begin, np.zeros((count, 6)))
    deepest, work = np.zeros(count), np.full(count, -np.inf)
    for k in range(round(DURATION / STEP)):
        before, wrench = systems.object_twist.copy(), impedance(chain, systems, begin, k * STEP)
        rollout.step(systems, STEP, object_wrench=wrench)
        deepest, after = np.minimum(deepest, systems.touch_gap.min(axis=1)), systems.object_twist
        pull = np.concatenate([np.zeros(3), MASS * chain.gravity])
        impulse = (after - before) * [*[INERTIA] * 3, *[MASS] * 3] - STEP * (wrench + pull)  # of contacts
        work = np.maximum(work, 0.5 * (impulse * (before + after)).sum(axis=1))
    return Insertions(systems, deepest, work)


def impedance(chain: hf.ClosedChain, systems: RolloutSystems, begin: Array, t: float) -> Array:
    """Return the wrenches (pegs, 6) of springs and dampers from the lines and the attitudes of the starts."""
    way = min(SPEED * t, GOAL + 1e-3)
    v = np.array([0.0, 0.0, -SPEED if way == SPEED * t else 0.0])
    twist = systems.object_twist
    force = STIFFNESS * (begin[:, 4:] - [0.0, 0.0, way] - systems.object_pose[:, 4:]) + DAMPING * (v - twist[:, 3:])
    frames = [[hf.Pose.from_wxyz_xyz(x).R for x in poses] for poses in (begin, systems.object_pose)]
    turn = np.array([rotation.log(goal @ now.T) for goal, now in zip(*frames, strict=True)])
    moment = TURNING_STIFFNESS * turn - TURNING_DAMPING * twist[:, :3]
    return np.hstack([moment, force - MASS * chain.gravity])


def ending(chain: hf.ClosedChain, systems: RolloutSystems, i: int) -> str:
    """Return how a run ends: "inserted", the names of a wedge, "off the chamfer", or why none of these."""
    if systems.status[i] is not RolloutStatus.RUNNING:
        return f"stopped: {systems.status[i].value}"
    assert chain.touching is not None
    held = hf.Pose.from_wxyz_xyz(systems.object_pose[i])
    tip = held.p - HALF * held.R[:, 2]
    if -tip[2] >= INSERTED:
        return "inserted"
    force = systems.touch_force[i]
    pressing = np.flatnonzero(np.linalg.norm(force, axis=1) > PRESSING)
    if len(pressing) and np.hypot(*tip[:2]) > CHAMFER and tip[2] > -CHAMFER:
        return "off the chamfer"
    for rim in pressing:
        for edge in pressing:
            names, opposed = (chain.touching.names[rim], chain.touching.names[edge]), force[rim, :2] @ force[edge, :2]
            if names[0].startswith("rim") and names[1].startswith("edge") and opposed < 0.0:
                return f"jammed: two-point wedge of {names[0]} and {names[1]}"
    return f"none: {1e3 * -tip[2]:.2f} mm deep, {len(pressing)} contacts"


def main() -> None:
    """Run pegs from random starts, and count how they end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--friction", type=float, default=0.2)
    given = parser.parse_args()
    chain, start = peg_and_hole(given.friction), time.perf_counter()
    dice = (np.random.default_rng([given.seed, i]) for i in range(given.count))
    found = insertions(chain, [start_of(one) for one in dice])
    ends = [ending(chain, found.systems, i) for i in range(given.count)]
    for i, how in enumerate(ends):
        if how != "inserted":
            print(f"start {i}: {how}")
    print(f"{given.count} pegs, friction {given.friction:g}: {dict(Counter(ends))}")
    print(f"deepest gap {found.deepest.min():.1e} m, largest work of contacts in a step {found.work.max():.1e} J")
    print(f"{(time.perf_counter() - start) / given.count:.2f} s a peg, with machine code")


if __name__ == "__main__":
    main()
