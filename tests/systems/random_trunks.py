"""Random chains on a trunk with everything on: every joint, every kind of grasp, springs, wrenches, driven bases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import Arm, Grasp, Pose
from holdfast.dynamics import project_velocity, tip_pose
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem, as_chain
from tests.systems.lower_pairs import MOTIONS
from tests.systems.random_systems import random_system
from tests.systems.trunk_problems import on_trunk, random_pose

KINDS = tuple(name for name, row in GRASP_KINDS.items() if not row.compliant and name != "sole")  # moves as "rigid"
LONGEST = 20  # joints of a trunk
FEW = 0.25  # share of systems whose arms have so few joints that forces may not be unique
FREE = 0.12  # share of arms that hold nothing
SWAYING = 0.4  # share of systems whose arms in the world stand on bases that move


def random_trunk_system(seed: int, **options) -> Problem:
    """Return a random chain on a random trunk; it may be singular, or have no motion that keeps its grasps.

    The trunk has 1 to 20 joints, or a floating base and 0 to 20; there are 1 to 8 arms, some in the world, some free.

    Args:
        seed: of the random numbers.
        **options: of `random_system`, in place of what is drawn.
    """
    random = np.random.default_rng([seed, 1])
    floating = bool(random.random() < 0.5)
    trunk_joints = int(random.integers(0 if floating else 1, LONGEST + 1))
    count = int(random.integers(1, 9))
    fewest, most = (1, 4) if random.random() < FEW else (3, 10)
    drawn = {
        "joints": random.integers(fewest, most, count).tolist(),
        "grasps": [None if k and random.random() < FREE else "rigid" for k in range(count)],
    }
    p = as_chain(random_system(seed, moving_base=False, **drawn | options))
    p = on_trunk(p, seed, trunk_joints, floating=floating, in_world=0.25)
    p = held_anyhow(sprung(p, random), random)
    return swaying(p, random) if random.random() < SWAYING else settled(p)


def sprung(p: Problem, random) -> Problem:
    """Return the problem with springs in the joints of its arms."""

    def with_springs(arm: Arm) -> Arm:
        joints = [replace(j, stiffness=random.uniform(0, 20), rest=random.normal()) for j in arm.joints]
        return replace(arm, joints=joints)

    return replace(p, chain=replace(p.chain, arms={name: with_springs(arm) for name, arm in p.chain.arms.items()}))


def held_anyhow(p: Problem, random) -> Problem:
    """Return the problem with grasps of all kinds where its tips are, turned and slid as far as a kind lets them.

    Tips get attitudes of their own.
    """
    arms = {name: arm.with_tip(Pose(random_pose(random).R, arm.tip.p)) for name, arm in p.chain.arms.items()}
    p = replace(p, chain=replace(p.chain, arms=arms))
    grasps, back = {}, p.state.object_frame.inverse()
    for name in p.chain.grasps:
        kind = str(random.choice(KINDS))
        given = {}
        if kind == "screw":
            given["pitch"] = float(random.choice([-1, 1]) * random.uniform(0.02, 0.2))
        if kind == "subspace":
            given["motion"] = MOTIONS[str(random.choice(list(MOTIONS)))]
        contact = back @ tip_in_world(p, name) @ freely_moved(kind, given, random)
        grasps[name] = Grasp(kind, contact, **given)  # type: ignore[arg-type]
    return replace(p, chain=replace(p.chain, grasps=grasps))


def freely_moved(kind: str, given: dict, random) -> Pose:
    """Return a pose of a closed contact frame seen from the tip."""
    turn, slide = 0.4 * random.normal(size=3), 0.1 * random.normal(size=3)
    X, Y, Z = np.eye(3)
    if kind in ("ball", "softfinger"):
        return Pose(rotation.exp(turn), np.zeros(3))
    if kind == "universal":
        return Pose(rotation.exp(turn[0] * X) @ rotation.exp(turn[1] * Y), np.zeros(3))
    if kind == "subspace":  # a slide that all of them have, and one that belongs to a turn
        return Pose(np.eye(3), slide[1] * Y if given["motion"][4].any() else slide[0] * X)
    turned = {"hinge": turn[0] * X, "cylinder": turn[0] * X, "screw": turn[0] * X, "planar": turn[2] * Z}
    slid = {"slider": slide[0] * X, "cylinder": slide[0] * X, "planar": slide[0] * X + slide[1] * Y}
    if kind == "screw":
        slid["screw"] = given["pitch"] * turn[0] * X
    none = np.zeros(3)
    return Pose(rotation.exp(turned.get(kind, none)), slid.get(kind, none))


def tip_in_world(p: Problem, name: str) -> Pose:
    """Return the pose of an arm's tip, on the trunk or not."""
    arm, placed = p.chain.arms[name], trunk_at_rest(p.chain, p.state)
    if name in p.chain.mounts:
        arm = arm.at(placed.mounts[name].frame)
    return tip_pose(arm, p.state.q[p.chain.joints[name]])


def swaying(p: Problem, random) -> Problem:
    """Return the problem with the arms in the world on bases that are driven."""
    driven = np.array([[name not in p.chain.mounts] for name in p.chain.arms])
    twists, accelerations = driven * random.normal(size=(2, len(driven), 6))
    return settled(replace(p, inputs=replace(p.inputs, base_twists=twists, base_accelerations=accelerations)))


def settled(p: Problem) -> Problem:
    """Return the problem with velocities that keep its grasps, near those that it has."""
    return replace(p, state=project_velocity(p.chain, p.state, inputs=p.inputs))


def scaled_object(p: Problem, scale: float) -> Problem:
    """Return the problem with an object of a multiple of its mass and inertia."""
    body = p.chain.held_object
    light = replace(body, mass=scale * body.mass, inertia=scale * body.inertia)
    return replace(p, chain=replace(p.chain, held_object=light))
