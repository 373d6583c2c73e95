"""Chains as people build them: everything at right angles, or nearly, and random in everything else.

Joint axes, placements, bases, contacts and the object lie along the axes of one frame, and revolute
joints stand at multiples of a right angle. Rows that cannot move are then zero but for rounding,
which is where a computation has to tell rounding from a number.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

import holdfast
from holdfast import Arm, ClosedChain, Grasp, HeldObject, Inputs, Joint, Link, Pose, State
from holdfast.robots import gen3, iiwa14, panda, ur5e
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem, mounted

ROBOTS = {"ur5e": ur5e, "gen3": gen3, "panda": panda, "iiwa14": iiwa14}
KINDS = ("rigid", "hinge", "softfinger", "ball")
RIGHT_ANGLES = [
    np.array(signs)[:, None] * np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((-1.0, 1.0), repeat=3)
    if np.linalg.det(np.array(signs)[:, None] * np.eye(3)[list(order)]) > 0
]


def right_angle_system(seed: object, tilt: float = 0.0) -> Problem:
    """Return a chain at right angles in a consistent state, with random torques and velocities.

    Args:
        seed: of the random numbers.
        tilt: every right angle between joints is off by up to so much [rad].
    """
    random = np.random.default_rng(seed)  # type: ignore[arg-type]
    count = int(random.choice([1, 2, 2, 2, 3, 3, 4]))
    names = [f"arm{k}" for k in range(count)]
    arms = {name: _arm(random, tilt) for name in names}
    held = _object(random)
    at = Pose(_turn(random), 0.5 * _along(random))
    contacts = _contacts(random, count)
    kinds = random.choice(KINDS, size=count, p=[0.4, 0.2, 0.2, 0.2])
    grasps = {
        name: Grasp(str(kind), Pose(_turn(random), p)) for name, kind, p in zip(names, kinds, contacts, strict=True)
    }
    q = np.concatenate([_angles(random, arm, tilt) for arm in arms.values()])
    chain = mounted(ClosedChain(arms, held, grasps, [0.0, 0.0, -9.81]), q, at)
    still = State(q, np.zeros(len(q)), at.wxyz_xyz)
    moving = State(q, random.normal(size=len(q)), at.wxyz_xyz, random.normal(size=6))
    state = holdfast.dynamics.project_velocity(chain, moving) if random.random() < 0.5 else still
    return Problem(chain, state, 5.0 * random.normal(size=len(q)), Inputs())


def _turn(random: np.random.Generator) -> np.ndarray:
    return RIGHT_ANGLES[random.integers(24)]


def _along(random: np.random.Generator) -> np.ndarray:
    """Return a random length along a random axis."""
    return random.choice([-1.0, 1.0]) * np.eye(3)[random.integers(3)] * random.uniform(0.1, 0.6)


def _arm(random: np.random.Generator, tilt: float) -> Arm:
    """Return one of the library's robots, or a random arm at right angles."""
    if random.random() < 0.5:
        return ROBOTS[str(random.choice(list(ROBOTS)))]()
    joints, links = [], []
    for _ in range(int(random.integers(3, 8))):
        small = rotation.exp(tilt * random.uniform(-1, 1, size=3))
        kind = "prismatic" if random.random() < 0.2 else "revolute"
        p = _along(random) if random.random() < 0.8 else np.zeros(3)
        joints.append(Joint(kind, np.eye(3)[random.integers(3)], Pose(_turn(random) @ small, p)))
        mass, sizes = random.uniform(0.5, 4.0), random.uniform(0.05, 0.3, size=3)
        com = 0.3 * _along(random) if random.random() < 0.7 else np.zeros(3)
        links.append(Link(mass, com, np.diag(mass / 12 * (np.sum(sizes**2) - sizes**2))))
    return Arm(joints, links, Pose(_turn(random), _along(random)))


def _angles(random: np.random.Generator, arm: Arm, tilt: float) -> np.ndarray:
    """Return revolute joints at multiples of a right angle, prismatic ones anywhere."""
    q = 0.5 * np.pi * random.integers(-2, 3, size=arm.joint_count) + tilt * random.uniform(-1, 1, arm.joint_count)
    slides = np.array([joint.kind == "prismatic" for joint in arm.joints])
    return np.where(slides, random.uniform(-0.3, 0.3, arm.joint_count), q)


def _object(random: np.random.Generator) -> HeldObject:
    """Return a box, a cube, or a point mass on a frame."""
    mass = random.uniform(0.5, 10.0)
    sizes = np.full(3, 0.2) if random.random() < 0.3 else random.uniform(0.05, 0.5, size=3)
    inertia = np.diag(mass / 12 * (np.sum(sizes**2) - sizes**2))
    if random.random() < 0.15:
        inertia = 10.0 ** random.uniform(-16, -6) * np.eye(3)
    com = 0.3 * _along(random) if random.random() < 0.4 else np.zeros(3)
    return HeldObject(mass, inertia, com, physical=False)


def _contacts(random: np.random.Generator, count: int) -> list[np.ndarray]:
    """Return contacts on a line, in a plane, or on the axes [m]."""
    way = random.integers(3)
    axis, other = np.eye(3)[random.permutation(3)[:2]]
    if way == 0:
        return [axis * random.uniform(-0.5, 0.5) for _ in range(count)]
    if way == 1:
        return [axis * random.uniform(-0.5, 0.5) + other * random.uniform(-0.5, 0.5) for _ in range(count)]
    return [_along(random) for _ in range(count)]
