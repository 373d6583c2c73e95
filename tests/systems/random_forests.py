"""Random forests in ten families and six variants, in states that satisfy their closures and couplings.

Frames of closures are put where they coincide, so that every posture closes; rates are projected on those that closures
and couplings allow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.tree.forest_motion import forest_motion
from holdfast.dynamics.tree.forest_rows import forest_rows
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from holdfast.model.grasp import Grasp
from holdfast.model.link import Link
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose

VARIANTS = ("generic", "right_angles", "right_angles_at_rest", "light", "heavy", "generic_again")
SIMPLE = ("rigid", "hinge", "softfinger", "ball")
EVERY = (*SIMPLE, "universal", "slider", "cylinder", "screw", "planar")
JOINTS = ("revolute", "prismatic", "screw", "cylindrical", "planar", "spherical")
LIGHT, HEAVY = 1e-6, 1e4


class ForestProblem(NamedTuple):
    """A forest and what acts on it, as arguments of `forest_dynamics`."""

    name: str
    forest: Forest
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    wrenches: np.ndarray


@dataclass
class Grower:
    """A forest that grows.

    Attributes:
        random: source of numbers.
        variant: the variant.
    """

    random: np.random.Generator
    variant: str
    bodies: list[ForestBody] = field(default_factory=list)
    q: list[np.ndarray] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)
    couplings: list[JointCoupling] = field(default_factory=list)

    @property
    def right(self) -> bool:
        """Whether the geometry has right angles."""
        return self.variant.startswith("right")

    def integer(self, least: int, below: int) -> int:
        """Return a random integer."""
        return int(self.random.integers(least, below))

    def turn(self) -> np.ndarray:
        """Return a random rotation."""
        if not self.right:
            return rotation.exp(self.random.normal(size=3))
        signs = np.diag(self.random.choice([-1.0, 1.0], 3))
        R = np.eye(3)[self.random.permutation(3)] @ signs
        return R * np.linalg.det(R)

    def shift(self, size: float = 0.4) -> np.ndarray:
        """Return a random vector [m]."""
        if not self.right:
            return size * self.random.normal(size=3)
        return size * np.round(2.0 * self.random.normal(size=3)) / 2.0

    def angle(self) -> float:
        """Return a random position."""
        return float(self.random.integers(-2, 3)) * np.pi / 2 if self.variant.endswith("rest") else self.random.normal()

    def add(
        self, parent: int | None, kind: Any = "", *, axis: np.ndarray | None = None, placement: Pose | None = None
    ) -> int:
        """Add a body on a joint, by default one that turns or, less often, slides; return its index."""
        random = self.random
        kind = kind or random.choice(["revolute", "prismatic"], p=[0.8, 0.2])
        frame = np.eye(3) if kind == "free" else self.turn()
        given: dict = {"pitch": 0.3} if kind == "screw" else {}
        given |= {"across": frame[1]} if kind == "planar" else {}
        place = (
            Pose.identity() if kind == "free" else Pose(self.turn(), self.shift()) if placement is None else placement
        )
        if kind != "free":
            given |= {"armature": random.uniform(0.0, 0.1), "damping": random.uniform(0.0, 0.5)}
        joint = BodyJoint(kind, place, frame[0] if axis is None else axis, **given)
        body = ForestBody(self.link(), joint, parent)
        self.bodies.append(body)
        q = np.array([self.angle() for _ in joint.of_kind.turning])
        if joint.of_kind.pose:
            q = np.concatenate([rotation.to_quaternion(self.turn()), self.shift() if kind == "free" else []])
        elif kind in ("prismatic", "cylindrical", "planar"):
            q = np.where(joint.of_kind.turning, q, 0.2 * q)
        self.q.append(q)
        return len(self.bodies) - 1

    def link(self) -> Link:
        """Return a random link."""
        points = self.random.normal(size=(6, 3)) * 0.1
        mass = self.random.uniform(0.5, 4.0)
        com = points.mean(axis=0)
        spread = points - com
        inertia = mass / 6 * (np.sum(spread * spread) * np.eye(3) - spread.T @ spread)
        return Link(mass, com, inertia)

    def serial(self, parent: int | None, count: int) -> int:
        """Add joints one after the other; return the last body."""
        for _ in range(count):
            parent = self.add(parent)
        assert parent is not None
        return parent

    def pose(self, body: int | None) -> Pose:
        """Return the pose of a body in the world."""
        if body is None:
            return Pose.identity()
        forest = Forest(self.bodies)
        n = forest.velocity_count
        none = np.zeros((len(self.bodies), 6))
        return forest_motion(forest, np.concatenate(self.q), np.zeros(n), np.zeros(n), none).bodies[body].at.frame

    def close(self, a: int | None, b: int, kind: Any = "", frame: Pose | None = None) -> None:
        """Add a closure between two bodies as they are."""
        kind = kind or self.random.choice(SIMPLE)
        frame = Pose(self.turn(), self.shift(0.2)) if frame is None else frame
        tip = self.pose(a).inverse() @ self.pose(b) @ frame
        self.closures.append(Closure(a, b, Grasp(kind, frame, pitch=0.2 if kind == "screw" else None), tip))

    def couple(self, *bodies: int) -> None:
        """Couple the first components of joints."""
        self.couplings.append(JointCoupling([(k, 0, self.random.uniform(0.5, 2.0)) for k in bodies]))

    def four_bar(self, parent: int | None) -> int:
        """Add a planar loop of hinges, and return its coupler."""
        across = self.turn()  # its first column is the hinges' axis
        axis = across[:, 0]
        places = [Pose(np.eye(3), across[:, 1:] @ self.shift(0.5)[:2]) for _ in range(3)]
        crank = self.add(parent, "revolute", axis=axis, placement=Pose(self.turn(), self.shift()))
        rocker = self.add(parent, "revolute", axis=axis, placement=self.bodies[crank].joint.placement @ places[0])
        coupler = self.add(crank, "revolute", axis=axis, placement=places[1])
        self.close(coupler, rocker, "hinge", Pose(across, places[2].p))
        return coupler

    def grown(self, name: str) -> ForestProblem:
        """Return the forest in a state, with everything that acts on it."""
        random, carriers = self.random, {body.parent for body in self.bodies}
        factor = {"light": LIGHT, "heavy": HEAVY}.get(self.variant, 1.0)
        bodies = [
            replace(b, link=Link(factor * b.link.mass, b.link.com, factor * b.link.inertia))
            if b.joint.kind == "free" and k not in carriers
            else b
            for k, b in enumerate(self.bodies)
        ]
        forest, q = Forest(bodies, self.closures, self.couplings, random.normal(size=3) * 5), np.concatenate(self.q)
        n, count = forest.velocity_count, len(bodies)
        qd, none = random.normal(size=n), np.zeros((count, 6))
        G = forest_rows(forest_motion(forest, q, 0 * qd, 0 * qd, none)).G
        qd = qd - np.linalg.pinv(G, rcond=1e-9) @ (G @ qd)
        qd = _of_frames(forest, q, 0.0 * qd if self.variant.endswith("rest") else qd)
        wrenches = random.normal(size=(count, 6)) * random.choice([0.0, 5.0], (count, 1))
        return ForestProblem(name, forest, q, qd, random.normal(size=n) * 5, wrenches)


def _of_frames(forest: Forest, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Return rates in which those of free bodies are not those of their mass centres but of their frames."""
    qd = qd.copy()
    for body, at_q, at_v in zip(forest.bodies, forest.positions, forest.velocities, strict=True):
        if body.joint.kind == "free":
            R = Pose.unchecked_seven(q[at_q]).R
            qd[at_v.start + 3 : at_v.stop] -= np.cross(qd[at_v][:3], R @ body.link.com)
    return qd


def one_object(g: Grower) -> None:
    """Arms in the world on one object."""
    held = g.add(None, "free")
    for _ in range(g.integer(2, 5)):
        g.close(g.serial(None, g.integer(2, 8)), held)


def trunk_hands(g: Grower) -> None:
    """Hands with fingers on arms on a torso; over-constrained more often than not."""
    held, torso = g.add(None, "free"), g.serial(None, g.integer(1, 3))
    for _ in range(2):
        palm = g.serial(torso, g.integer(2, 4))
        for _ in range(g.integer(2, 4)):
            g.close(g.serial(palm, g.integer(1, 4)), held)


def inner_loops(g: Grower) -> None:
    """Arms with four-bar loops in them."""
    held = g.add(None, "free")
    for _ in range(g.integer(2, 4)):
        arm = g.four_bar(g.serial(None, g.integer(1, 3)))
        g.close(g.serial(arm, g.integer(1, 3)), held)


def delta_like(g: Grower) -> None:
    """Legs with a spherical joint below a platform."""
    held = g.add(None, "free")
    for _ in range(g.integer(3, 6)):
        g.close(g.add(g.add(None, "spherical"), "prismatic"), held, "ball")


def grippers(g: Grower) -> None:
    """Arms with two coupled fingers each."""
    held = g.add(None, "free")
    for _ in range(2):
        palm = g.serial(None, g.integer(3, 6))
        fingers = [g.add(palm), g.add(palm)]
        g.couple(*fingers)
        for finger in fingers:
            g.close(finger, held)


def handover(g: Grower) -> None:
    """Floating torsos with two arms each that pass objects on."""
    before = None
    for _ in range(g.integer(2, 4)):
        torso = g.add(None, "free")
        arms = [g.serial(torso, g.integer(3, 6)) for _ in range(2)]
        if before is not None:
            g.close(arms[0], before)
        before = g.add(None, "free")
        g.close(arms[1], before)


def stack(g: Grower) -> None:
    """Objects on each other, the lowest and the highest held by arms."""
    bodies = [g.add(None, "free") for _ in range(g.integer(2, 4))]
    for a, b in pairwise(bodies):
        g.close(a, b, g.random.choice(["ball", "softfinger"]))
    for held in (bodies[0], bodies[-1]):
        for _ in range(g.integer(1, 3)):
            g.close(g.serial(None, g.integer(3, 6)), held)


def feet_box(g: Grower) -> None:
    """A humanoid with both feet on the ground and a box in its hands."""
    pelvis, box = g.add(None, "free"), g.add(None, "free")
    chest = g.serial(pelvis, g.integer(1, 3))
    for _ in range(2):
        g.close(None, g.serial(pelvis, g.integer(4, 7)))
        g.close(g.serial(chest, g.integer(4, 7)), box)


def ring(g: Grower) -> None:
    """Torsos in a ring, each with two arms, and an object between every two."""
    count = g.integer(3, 5)
    objects = [g.add(None, "free") for _ in range(count)]
    for i in range(count):
        torso = g.add(None, "free") if g.random.random() < 0.5 else g.serial(None, 2)
        for held in (objects[i], objects[(i + 1) % count]):
            g.close(g.serial(torso, g.integer(1, 4)), held)


def anything(g: Grower) -> None:
    """A random tree of all kinds of joints with random closures of every kind, and couplings."""
    free = g.add(None, "free") if g.random.random() < 0.6 else None
    for k in range(g.integer(6, 11)):
        parent = free if k == 0 else g.integer(0, len(g.bodies))
        g.add(None if g.random.random() < 0.15 else parent, str(g.random.choice(JOINTS)))
    for _ in range(g.integer(1, 4)):
        a, b = (int(x) for x in g.random.choice(len(g.bodies), 2, replace=False))
        g.close(None if g.random.random() < 0.3 else a, b, str(g.random.choice(EVERY)))
    jointed = [k for k, body in enumerate(g.bodies) if body.joint.kind != "free"]
    for _ in range(g.integer(0, 3)):
        g.couple(*(int(k) for k in g.random.choice(jointed, g.integer(1, 4), replace=False)))


FAMILIES: dict[str, Callable[[Grower], None]] = {
    f.__name__: f
    for f in (
        one_object,
        trunk_hands,
        inner_loops,
        delta_like,
        grippers,
        handover,
        stack,
        feet_box,
        ring,
        anything,
    )
}


def random_forest(seed: int) -> ForestProblem:
    """Return a random forest; families and variants take turns."""
    family, variant = list(FAMILIES)[seed % len(FAMILIES)], VARIANTS[seed // len(FAMILIES) % len(VARIANTS)]
    grower = Grower(np.random.default_rng(seed), variant)
    FAMILIES[family](grower)
    return grower.grown(f"{family}_{variant}_{seed}")
