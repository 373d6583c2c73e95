"""Random runs of objects that touch the world: no contact makes energy, no gap opens downwards, no run ends in silence.

    python -m benchmarks.random_touches --count 1000 [--contacts steps] [--first 0] [--seed 17]

Boxes, balls, pegs (two spheres) and cylinders (rims of four points), free or held by one or two arms, fall, slide and
tumble on slopes, beside walls, and on balls, cylinders and boxes that are fixed; with friction and restitution. Each
run is a pure function of its number. Printed are all endings but the sound one, and the worst of three bars:

* gaps, >= -1e-12 m;
* energy that contacts make in a step, relative to the kinetic energy: by impacts, and by the power of their forces at
  either end (a stop is located to 1e-13 s and 1e-13 m/s, and friction has the power of that slip just past it);
* by steps, the largest gain of the whole energy in a step that no arm drives, divided by h^3 and by what the midpoint
  rule may make: kinetic energy times the cube of the largest rate of the object.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial import rotation
from holdfast.world import Ball, Box, Cylinder, HalfSpace, Sphere, Touching, corners

DURATION, STEP = 0.25, 1e-2
BODIES = ("box", "ball", "peg", "cylinder")
HOLDERS = ("free", "free", "one gantry", "two gantries", "one arm")
FIXTURES = ("none", "wall", "corner", "ball", "cylinder", "box")
GAP_BAR, ENERGY_BAR = -1e-12, 1e-12


class Scene(NamedTuple):
    """A random scene.

    Attributes:
        words: what was drawn.
        chain: the chain.
        state: at the start, above the slope.
        law: the torques.
    """

    words: str
    chain: hf.ClosedChain
    state: hf.State
    law: Any


def random_scene(number: int) -> Scene:
    """Return the scene of a number."""
    dice = np.random.default_rng([44, number])
    kind, holder, fixture = (str(dice.choice(one)) for one in (BODIES, HOLDERS, FIXTURES))
    body, points, size = _body(dice, kind)
    of_all: dict[str, Any] = {
        "friction": float(dice.choice([0.0, dice.uniform(0.05, 0.9)], p=[0.15, 0.85])),
        "restitution": float(dice.choice([0.0, dice.uniform(0.1, 0.9)])),
    }
    world, words = _world(dice, fixture, of_all), f"{kind}, {holder}, {fixture}"
    q, place = dice.normal(size=4), np.array([0.0, 0.0, 0.4])
    pose = hf.Pose.from_wxyz_xyz(np.concatenate([q / np.linalg.norm(q), place]))
    twist = dice.normal(size=6) * [2.0, 2.0, 2.0, 0.7, 0.7, 0.7]
    touching = Touching(points, world)
    gap = contact_rows(touching, pose, np.zeros(6)).gap
    pose = hf.Pose(pose.R, place - [0.0, 0.0, max(0.0, float(gap.min()) - dice.uniform(0.0, 0.03))])
    gap = contact_rows(touching, pose, np.zeros(6)).gap
    while gap.min() < 0.0:  # it begins within a fixture
        pose = hf.Pose(
            pose.R, pose.p + dice.uniform(0.0, 0.2) * world["slope"].normal + [*dice.normal(size=2) * 0.1, 0.0]
        )
        gap = contact_rows(touching, pose, np.zeros(6)).gap
    arms, grasps = {}, {}
    for i in range({"free": 0, "one gantry": 1, "one arm": 1, "two gantries": 2}[holder]):
        side = np.array([1.0, 0.0, 0.0]) * (1 - 2 * i)
        frame = hf.contact_frame(0.3 * size * side, into=-side)
        grasps[f"arm{i}"] = hf.Grasp("rigid" if holder == "one arm" else "ball", frame)
        arms[f"arm{i}"] = (_six_joints if holder == "one arm" else _gantry)(dice, pose @ frame)
    chain = hf.ClosedChain(arms, body, grasps, touching=touching)
    n = chain.joint_count
    state = hf.State(np.zeros(n), np.zeros(n), pose, twist if not arms else np.zeros(6))
    if arms:
        state = hf.dynamics.project_velocity(chain, state)
    size = np.array([1.0 if joint.kind == "prismatic" else 0.01 for joint in chain.all_joints])
    push = dice.normal(size=n) * 5.0 * size

    def law(t: float, now: hf.State, memory: object) -> tuple[np.ndarray, object]:
        return push - 2.0 * size * now.qd, memory

    return Scene(f"{words}, friction {of_all['friction']:.2f}, e {of_all['restitution']:.2f}", chain, state, law)


def _body(dice: np.random.Generator, kind: str) -> tuple[hf.HeldObject, dict[str, Any], float]:
    """Return a body, what of it may touch, and its size [m]."""
    mass, r, l = dice.uniform(0.3, 3.0), dice.uniform(0.02, 0.08), dice.uniform(0.05, 0.15)
    if kind == "box":
        edges = dice.uniform(0.05, 0.3, 3)
        return hf.HeldObject.box(mass, *edges), corners(*edges), float(edges.min())
    if kind == "ball":
        return hf.HeldObject.sphere(mass, r), {"ball": Sphere(np.zeros(3), r)}, r
    inertia = mass * np.diag([(3 * r * r + 4 * l * l) / 12.0] * 2 + [r * r / 2.0])
    if kind == "peg":
        points: dict[str, Any] = {n: Sphere([0.0, 0.0, s * l], r) for n, s in (("top", 1.0), ("tip", -1.0))}
    else:
        about = [(np.cos(a), np.sin(a)) for a in 0.5 * np.pi * np.arange(4)]
        points = {
            f"{n}{i}": [r * x, r * y, s * l] for n, s in (("top", 1), ("end", -1)) for i, (x, y) in enumerate(about)
        }
    return hf.HeldObject(mass, inertia), points, r


def _world(dice: np.random.Generator, fixture: str, of_all: dict[str, Any]) -> dict[str, Any]:
    """Return a slope and what is fixed beside it."""
    slope, about = dice.uniform(0.0, 0.5), dice.uniform(0.0, 2.0 * np.pi)
    up = rotation.exp(slope * np.array([np.cos(about), np.sin(about), 0.0]))
    world: dict[str, Any] = {"slope": HalfSpace(normal=up[:, 2], **of_all)}
    far = dice.uniform(0.1, 0.4)
    if fixture in ("wall", "corner"):
        world["wall"] = HalfSpace(normal=up[:, 0], offset=-far, **of_all)
    if fixture == "corner":
        world["side"] = HalfSpace(normal=up[:, 1], offset=-dice.uniform(0.1, 0.4), **of_all)
    pose = hf.Pose(up, far * up[:, 0])
    if fixture == "ball":
        world["knob"] = Ball(radius=dice.uniform(0.05, 0.15), pose=pose, **of_all)
    if fixture == "cylinder":
        lying = hf.Pose(up @ rotation.exp(np.array([0.5 * np.pi, 0.0, 0.0])), pose.p)
        world["bar"] = Cylinder(radius=dice.uniform(0.05, 0.15), pose=lying, **of_all)
    if fixture == "box":
        world["block"] = Box(half=dice.uniform(0.05, 0.15, 3), edge=0.005, pose=pose, **of_all)
    return world


def _gantry(dice: np.random.Generator, tip: hf.Pose) -> hf.Arm:
    """Return three slides along x, y, z whose tip is at a pose."""
    joints = [hf.Joint("prismatic", axis, name=name) for name, axis in zip("xyz", np.eye(3), strict=True)]
    links = [hf.Link(m, np.zeros(3), 1e-3 * np.eye(3)) for m in dice.uniform(0.1, 1.0, 3)]
    return hf.Arm(joints, links, tip=hf.Pose(tip.R, np.zeros(3)), base=hf.Pose(np.eye(3), tip.p))


def _six_joints(dice: np.random.Generator, tip: hf.Pose) -> hf.Arm:
    """Return a slide in each direction and a wrist of three axes whose tip is at a pose."""
    slides = [hf.Joint("prismatic", axis, name=name) for name, axis in zip("xyz", np.eye(3), strict=True)]
    wrist = [hf.Joint("revolute", axis, name=name) for name, axis in zip("abc", np.eye(3), strict=True)]
    links = [hf.Link(m, dice.uniform(-0.03, 0.03, 3), 1e-3 * np.eye(3)) for m in dice.uniform(0.1, 1.0, 6)]
    return hf.Arm([*slides, *wrist], links, tip=hf.Pose(tip.R, np.zeros(3)), base=hf.Pose(np.eye(3), tip.p))


class Outcome(NamedTuple):
    """What a run shows.

    Attributes:
        ending: "sound", the reason why it stopped, or the bar that it misses.
        gap: the lowest [m].
        gain: largest energy that contacts make, relative.
        smooth: by steps, the largest gain of a step of a free object over h^3 and the scale of the midpoint rule.
        events: entries of the log.
    """

    ending: str
    gap: float
    gain: float
    smooth: float
    events: int


def outcome(scene: Scene, contacts: str, step: float = STEP) -> tuple[Outcome, Trajectory | None]:
    """Return what the run of a scene shows, and the run."""
    try:
        run = hf.simulate(scene.chain, scene.state, scene.law, DURATION, step, contacts=contacts)
    except hf.HoldfastError as cause:
        return Outcome(f"{type(cause).__name__}: {cause}", 0.0, 0.0, 0.0, 0), None
    scale = float(run.kinetic.max()) + 1e-12
    gain = float(np.diff(run.impact, prepend=0.0).max()) / scale
    smooth = 0.0
    if contacts == "events":
        gain = max(gain, _largest_work(scene, run) / scale)
    elif not scene.chain.arms and len(run.t) > 1:
        energy = run.kinetic + run.potential
        rate = float(np.abs(run.object_twist[:, :3]).max()) + 1.0
        smooth = float(np.diff(energy).max()) / (scale * (rate * step) ** 3)
    gap, ending = float(run.touch_gap.min()), "sound"
    if run.stopped is not None:
        ending = f"stopped: {run.stopped}"
    elif gap < GAP_BAR:
        ending = f"gap {gap:.1e} m"
    elif gain > ENERGY_BAR:
        ending = f"energy gained {gain:.1e}"
    elif smooth > 1.0:
        ending = f"energy of a step {smooth:.1e}"
    elif not np.isfinite(run.kinetic).all():
        ending = "not finite"
    return Outcome(ending, gap, gain, smooth, len(run.occurrences)), run


def _largest_work(scene: Scene, run: Trajectory) -> float:
    """Return the most that the forces of a contact could add in a step with their power at an end [J].

    Sticking contacts and sliding ones add none.
    """
    largest, steps = 0.0, np.diff(run.t, prepend=run.t[0], append=run.t[-1])
    assert scene.chain.touching is not None
    for k in range(len(run.t)):
        if not run.touch_force[k].any():
            continue
        rows = contact_rows(scene.chain.touching, hf.Pose.from_wxyz_xyz(run.object_pose[k]), run.object_twist[k])
        force = np.einsum("kia,ka->ki", rows.axes, run.touch_force[k])
        power = float((force * rows.velocity(run.object_twist[k])).sum(axis=1).max())
        largest = max(largest, power * float(steps[k : k + 2].max()))
    return largest


def main() -> None:
    """Run many scenes, and print how they end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--contacts", choices=["events", "steps"], default="events")
    parser.add_argument("--step", type=float, default=STEP)
    given = parser.parse_args()
    ends: Counter[str] = Counter()
    gap, gain, smooth, events, begin = 0.0, 0.0, 0.0, 0, time.perf_counter()
    for number in range(given.first, given.first + given.count):
        scene = random_scene(number)
        start = time.perf_counter()
        found, _ = outcome(scene, given.contacts, given.step)
        ends[kind := found.ending.split(":")[0].split(" after")[0][:40]] += 1
        gap, gain = min(gap, found.gap), max(gain, found.gain)
        smooth, events = max(smooth, found.smooth), events + found.events
        spent = time.perf_counter() - start
        if kind != "sound" or spent > 60.0:
            print(f"{number} ({scene.words}; {spent:.0f} s): {found.ending}", flush=True)
        if (number + 1 - given.first) % 50 == 0:
            print(f"{number + 1 - given.first} runs: {dict(ends)}", flush=True)
    print(f"{given.count} runs by {given.contacts}, {events} changes of modes: {dict(ends)}")
    print(f"lowest gap {gap:.1e} m, largest relative gain of energy {gain:.1e}", end="")
    print(f", gain of a step / (kinetic energy (rate h)^3) {smooth:.2g}" if given.contacts == "steps" else "")
    print(f"{(time.perf_counter() - begin) / max(given.count, 1):.1f} s a run")


if __name__ == "__main__":
    main()
