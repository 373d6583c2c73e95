"""Chains with a trunk: two Pandas that hold a box, on three joints or on a floating base.

Entries of this library and Pinocchio are timed in the same rounds as ours without a trunk.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import holdfast
from benchmarks.bench import entries, pinocchio_peer
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.measure import record_of, reference
from benchmarks.bench.systems import STATES, System, follow, serial_arm
from holdfast import ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State, Trunk, contact_frame
from holdfast.dynamics import project_velocity, tip_pose
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.model.trunk import BASE
from holdfast.robots import HOME
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array

TORSO = "trunk of 3, 2 x 7"
FLOATING = "floating base, 2 x 7"
TRUNKS = {
    TORSO: Trunk(
        [Joint("revolute", axis, Pose.translation(0.0, 0.0, 0.25)) for axis in np.eye(3)[[2, 1, 0]]],
        [Link(12.0, [0.0, 0.0, 0.1], np.diag([0.4, 0.3, 0.2])) for _ in range(3)],
    ),
    FLOATING: Trunk(floating=Link(200.0, inertia=np.diag([30.0, 30.0, 20.0]))),
}
BOX = Pose.translation(0.5, 0.0, 0.4)  # in the axes of the body that carries the arms
HANDS = {
    "left": contact_frame([0.0, 0.15, 0.0], into=[0, -1, 0]),
    "right": contact_frame([0.0, -0.15, 0.0], into=[0, 1, 0]),
}


def make_trunk_system(name: str, states: int = STATES, seed: int = 0) -> System:
    """Return one of `TRUNKS` with two Pandas in random closed states with consistent velocities.

    The first state is closed by the choice of the arms' base poses. In the others, trunk and box are displaced
    slightly, and the arms follow by inverse kinematics.

    Args:
        name: name of the trunk.
        states: number of states.
        seed: seed of the random numbers.
    """
    random, trunk, arm = np.random.default_rng(seed), TRUNKS[name], serial_arm(7)
    home = {hand: np.array(HOME["panda"]) + random.uniform(-0.3, 0.3, 7) for hand in HANDS}
    arms = {hand: arm.at(BOX @ HANDS[hand] @ tip_pose(arm, q).inverse()) for hand, q in home.items()}
    grasps = {hand: Grasp("rigid", frame) for hand, frame in HANDS.items()}
    last = BASE if trunk.floating is not None else trunk.joint_count - 1
    chain = ClosedChain(arms, HeldObject.box(3.0, 0.4, 0.3, 0.2), grasps, trunk=trunk, mounts=dict.fromkeys(arms, last))
    found = [_state(chain, home, random) for _ in range(states)]
    q, qd, pose, twist = (
        np.array([getattr(s, part) for s in found]) for part in ("q", "qd", "object_pose", "object_twist")
    )
    base = [np.array([getattr(s, part) for s in found]) for part in ("base_pose", "base_twist")] if chain.floats else []
    return System(name, chain, q, qd, random.uniform(-10.0, 10.0, q.shape), pose, twist, *base)


def _state(chain: ClosedChain, home: dict[str, Array], random: np.random.Generator) -> State:
    """Return a closed state."""
    assert chain.trunk is not None
    of_trunk = random.uniform(-0.3, 0.3, chain.trunk.joint_count)
    base = {"base_pose": _near(random, 1.0), "base_twist": random.uniform(-0.5, 0.5, 6)} if chain.floats else {}
    guess = State(np.concatenate([of_trunk, *home.values()]), np.zeros(chain.joint_count), Pose.identity(), **base)
    placed = trunk_at_rest(chain, guess)
    assert placed is not None
    frame = placed.bodies[-1].frame @ BOX @ _near(random, 0.05)
    arms = [
        follow(arm.at(placed.mounts[hand].frame), home[hand], frame @ chain.grasps[hand].frame)
        for hand, arm in chain.arms.items()
    ]
    rates = random.uniform(-0.5, 0.5, chain.joint_count)
    state = State(np.concatenate([of_trunk, *arms]), rates, frame, random.uniform(-0.5, 0.5, 6), **base)
    return project_velocity(chain, state)


def _near(random: np.random.Generator, shift: float) -> Pose:
    """Return a pose rotated by up to 0.15 rad about each axis and displaced by up to a length along it."""
    return Pose(rotation.exp(random.uniform(-0.15, 0.15, 3)), random.uniform(-shift, shift, 3))


BATCH = 4096  # states in one call
WAYS: tuple[str, ...] = ("call", "bound", "batch")


def compare(name: str, plain: tuple[System, Any], effort: Effort, *, pinocchio: bool) -> dict[str, Any]:
    """Return the record of a system with a trunk.

    Args:
        name: name of the system.
        plain: two arms of seven joints without a trunk, and their machine code.
        effort: duration of the measurement.
        pinocchio: whether Pinocchio is installed.
    """
    system = make_trunk_system(name)
    fast = holdfast.compile(system.chain)
    own, others = (
        [entries.public(*one), entries.bind(*one), entries.batch(*one, BATCH)] for one in ((system, fast), plain)
    )
    peers = [pinocchio_peer.cholesky(system, "free", None)] if pinocchio else []
    truth = peers[0].answers() if peers else reference(system)
    seconds = timed([*own, *others, *peers], effort).T
    ours = dict(zip(WAYS, seconds, strict=False))
    pairs, theirs = zip(WAYS, own, seconds[len(own) :], strict=False), seconds[2 * len(own) :]
    return {
        "name": name,
        "operations": int(fast.operation_count),
        **{way: _record(entry, truth, ours[way], {"2 x 7": plainly}) for way, entry, plainly in pairs},
        "peers": [_record(peer, truth, taken, ours) for peer, taken in zip(peers, theirs, strict=True)],
    }


def _record(*measured: Any) -> dict[str, Any]:
    """Return an entry's record without the marks that only comparisons of peers need."""
    return {key: x for key, x in record_of(*measured).items() if key not in ("floor", "accurate")}
