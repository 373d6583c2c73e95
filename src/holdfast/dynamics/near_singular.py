"""The distance of a chain and its arms from singular configurations, and the directions that are lost there.

It is measured by a relative singular value s, which is 1 far from singular configurations and goes to 0 in proportion
to the distance from one. For an arm, s belongs to its weakest tip direction (`tip_directions`), described as a screw;
for the chain, it is condition^-1/2. Forward dynamics stays regular if a single arm is singular. However, a motion of
its tip along the lost direction needs joint rates that grow as 1/s, and torques that grow faster.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics, jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.constraint import length_scale, pattern, wrench_directions
from holdfast.dynamics.rank import constraint_pivots
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate
from holdfast.state import State

NEARING = 0.07  # s that runs towards a singularity pass 50 ms or more before joint rates and forces grow without bound
NEAR_SINGULAR = 0.03  # s that they pass about 20 ms before
STRENGTH_LOST = 5.0  # largest change of s per radian of a joint, or per displacement relative to the reach
LOST_BY_ARM = 1e-6  # s below which a direction is lost, at a configuration whose time is known to 1e-9 s
CONFIGURATIONS_TRIED = 4  # number of configurations with which the generic rank of an arm is determined
LOST_STRENGTH = 1e-9  # relative singular value below which a direction is lost
NEARLY_LOST = 1e-3  # relative singular value below which a direction is reported
PURE = 1e-6  # components of a unit screw below this count as zero


def arm_strength(arm: Arm, at: Kinematics, grasp: Grasp, object_rotation: Array) -> float:
    """Return s of an arm's weakest tip direction, 0 to 1.

    Directions that the arm lacks in every configuration, because it has too few joints or parallel axes, do not count.

    Args:
        arm: the arm.
        at: its configuration.
        grasp: its grasp; only directions that it transmits count.
        object_rotation: (3, 3) rotation from object axes to world axes.
    """
    K = _rows(grasp, grasp.of_kind.axes(object_rotation @ grasp.frame.R, at.tip.R))
    rank = generic_tip_rank(arm, grasp)
    return float(tip_directions(K, jacobian(arm, at)).strengths[rank - 1]) if rank else 1.0


@lru_cache(maxsize=256)
def generic_tip_rank(arm: Arm, grasp: Grasp) -> int:
    """Return the number of transmitted tip directions in which the arm can move, away from singular configurations."""
    random = np.random.default_rng(0)
    return max(_rank_somewhere(arm, grasp, random) for _ in range(CONFIGURATIONS_TRIED))


def _rank_somewhere(arm: Arm, grasp: Grasp, random: np.random.Generator) -> int:
    at = forward_kinematics(arm, random.uniform(-np.pi, np.pi, arm.joint_count))
    return int((tip_directions(_rows(grasp, at.tip.R), jacobian(arm, at)).strengths > LOST_STRENGTH).sum())


def _rows(grasp: Grasp, R: Array) -> Array:
    return np.array([rotate(R, row) for row in grasp.transmission]).reshape(-1, 6)


def chain_strength(condition: Array) -> Array:
    """Return s of the grasp constraint, condition^-1/2."""
    return 1.0 / np.sqrt(condition)


def nearly_lost(chain: ClosedChain, state: State, limit: float = NEAR_SINGULAR) -> list[str]:
    """Return descriptions of the directions with s <= limit, first those of the chain, then those of its arms."""
    motion = chain_at_rest(chain, state)
    condition = constraint_pivots(chain, state).condition
    found = []
    if chain_strength(np.array(condition)) <= limit:
        length = length_scale([c.offset for c in motion.contacts])
        directions = wrench_directions(motion, length)
        words = _load(motion, directions.columns[:, directions.rank - 1], length)
        found.append(f"{words} causes hardly any joint torque and hardly moves the object (condition {condition:.1e})")
    return found + lost_by_arms(motion, limit)


def weakest_strength(chain: ClosedChain, state: State) -> float:
    """Return the smallest s of the chain and of its arms that grasp, 0 to 1."""
    motion = chain_at_rest(chain, state)
    R, arms = state.object_frame.R, motion.arms
    of_arms = [arm_strength(chain.arms[name], arms[name].at, grasp, R) for name, grasp in chain.grasps.items()]
    return min([float(chain_strength(np.array(constraint_pivots(chain, state).condition))), *of_arms])


def lost_at(motion: ChainMotion, rank: int, generic_rank: int) -> list[str]:
    """Return descriptions of what is lost at a singular configuration, beginning with the loads without effect.

    Args:
        motion: the chain's motion at this configuration.
        rank: rank of K [J, -A].
        generic_rank: rank of K [J, -A] away from this configuration.
    """
    length = length_scale([c.offset for c in motion.contacts])
    columns = wrench_directions(motion, length).columns[:, rank:generic_rank]
    loads = [_load(motion, column, length) for column in columns.T]
    loads = [f"{load} causes no joint torque and does not move the object" for load in loads]
    return loads + lost_by_arms(motion, LOST_BY_ARM)


def lost_by_arms(motion: ChainMotion, limit: float) -> list[str]:
    """Return descriptions of the tip directions of the arms with s <= limit."""
    found = []
    for (name, grasp), c in zip(motion.chain.grasps.items(), motion.contacts, strict=True):
        arm = motion.arms[name]
        tip = tip_directions(c.K, jacobian(arm.arm, arm.at))
        rank = generic_tip_rank(motion.chain.arms[name], grasp)
        for k in reversed(range(rank)):
            if tip.strengths[k] <= limit:
                strength = float(tip.strengths[k])
                found.append(described(name, tip, c.K, tip.screws[:, k], arm.at.tip.p, strength).words)
    return found


def _load(motion: ChainMotion, wrenches: Array, length: float) -> str:
    """Return the description of a pattern of grasp wrenches of any size."""
    each = wrenches.reshape(-1, 6)
    largest = np.abs(each * np.r_[np.full(3, 1 / length), np.ones(3)]).max()
    return pattern(motion, each / largest, length)


@dataclass(frozen=True, eq=False)
class LostDirection(Frozen):
    """A direction, among those that the grasp transmits, in which an arm cannot move its tip.

    The same screw as a wrench loads the arm's structure, but none of its drives.

    Attributes:
        arm: name of the arm.
        kind: "translation" along the axis, "rotation" about it (the arm resists a pure moment without its drives), or
            "screw" (both, coupled).
        axis: (3,) unit vector, world axes.
        point: (3,) a point on the axis, world axes [m].
        strength: relative singular value; 0 if the direction is lost, 1e-3 if it is nearly lost.
        words: description of the direction.
    """

    arm: str
    kind: Literal["translation", "rotation", "screw"]
    axis: Array
    point: Array
    strength: float
    words: str


def lost_directions(name: str, c: Contact, J: Array, tip: Array) -> list[LostDirection]:
    """Return the lost and nearly lost directions of one arm's tip, the weakest first.

    The result depends neither on the units nor on the scaling of the joints (`tip_directions`).

    Args:
        name: name of the arm.
        c: its contact.
        J: (6, N) tip Jacobian, world axes.
        tip: (3,) tip point, world axes.
    """
    found = tip_directions(c.K, J)
    lost = found.strengths <= LOST_STRENGTH
    directions = [(u, 0.0) for u in _moments_apart(found.screws[:, lost])]
    nearly = np.flatnonzero(~lost & (found.strengths <= NEARLY_LOST))
    directions += [(found.screws[:, k], float(found.strengths[k])) for k in reversed(nearly)]
    return [described(name, found, c.K, u, tip, strength) for u, strength in directions]


class TipDirections(NamedTuple):
    """The directions of an arm's tip that its grasp transmits, from the strongest to the weakest.

    Attributes:
        strengths: (rows,) singular values relative to the largest.
        screws: (rows, rows) directions as columns, along the rows of K.
        length: size of the arm, by which moments are divided [m].
    """

    strengths: Array
    screws: Array
    length: float


def tip_directions(K: Array, J: Array) -> TipDirections:
    """Return the singular directions of K J, with moments divided by the arm's size and columns scaled to one.

    Args:
        K: (rows, 6) the transmitted directions, world axes.
        J: (6, N) tip Jacobian, world axes.
    """
    scaled, length = _scaled(K, J)
    U, _, _ = np.linalg.svd(scaled)
    return TipDirections(tip_strengths(K, J), U, float(length))


def tip_strengths(K: Array, J: Array) -> Array:
    """Return the strengths of `tip_directions`, (..., rows), of stacked K (..., rows, 6) and J (..., 6, N)."""
    scaled, _ = _scaled(K, J)
    s = np.linalg.svd(scaled, compute_uv=False)
    relative = np.zeros(scaled.shape[:-1])
    relative[..., : s.shape[-1]] = s / np.maximum(s.max(axis=-1, initial=0.0, keepdims=True), 1e-300)
    return relative


def _scaled(K: Array, J: Array) -> tuple[Array, Array]:
    """Return K J with moments divided by the arm's size and columns scaled to one, and that size, (...,) [m].

    Columns that are zero up to rounding, as of a joint whose axis passes through the centre of a ball, become zero.
    """
    lever = np.where(np.linalg.norm(J[..., :3, :], axis=-2) > 0.5, np.linalg.norm(J[..., 3:, :], axis=-2), 0.0)
    length = lever.max(axis=-1, initial=0.0)
    length = np.where(length > 0, length, 1.0)
    unit = np.concatenate([np.broadcast_to(length[..., None], (*length.shape, 3)), np.ones((*length.shape, 3))], -1)
    KJ = (K * unit[..., None, :]) @ J
    sizes = np.linalg.norm(KJ, axis=-2, keepdims=True)
    counts = sizes > LOST_STRENGTH * sizes.max(axis=-1, initial=0.0, keepdims=True)
    return np.where(counts, KJ / np.where(counts, sizes, 1.0), 0.0), length


def _unit(length: float) -> Array:
    return np.r_[np.full(3, length), np.ones(3)]  # twists [w length; v]


def _moments_apart(U: Array) -> list[Array]:
    """Return a basis of span(U), rows [.., force], that begins with the pure moments."""
    if not U.shape[1]:
        return []
    _, sizes, Vt = np.linalg.svd(U[-3:])
    rank = int((sizes > PURE).sum())
    return list((U @ Vt[rank:].T).T) + list((U @ Vt[:rank].T).T)


def described(arm: str, found: TipDirections, K: Array, u: Array, tip: Array, strength: float) -> LostDirection:
    """Return the description of a direction u along the rows of K as a screw; `tip` is the tip point [m]."""
    length, wrench = found.length, (K * _unit(found.length)).T @ u  # [moment; force] about the tip
    moment, force = wrench[:3], wrench[3:]
    if np.linalg.norm(force) * length > PURE * np.linalg.norm(moment):
        axis = force / np.linalg.norm(force)
        point = tip + np.cross(force, moment) / (force @ force)
        pitch = float(moment @ axis) / float(np.linalg.norm(force))  # [m]
        kind: Literal["translation", "rotation", "screw"] = "translation" if abs(pitch) <= PURE * length else "screw"
    else:
        axis, point, pitch, kind = moment / np.linalg.norm(moment), tip, 0.0, "rotation"
    action = {
        "translation": "move its tip along",
        "rotation": "turn its tip about",
        "screw": f"follow the screw of pitch {pitch:.3g} m along",
    }[kind]
    degree = "cannot" if strength <= LOST_STRENGTH else f"can hardly (relative strength {strength:.1e})"
    (ax, ay, az), (px, py, pz) = axis, point
    words = (
        f"arm '{arm}' {degree} {action} ({ax:+.3f}, {ay:+.3f}, {az:+.3f}) through"
        f" ({px:.3f}, {py:.3f}, {pz:.3f}) m, world axes; a load along it causes no joint torque"
    )
    return LostDirection(arm, kind, axis, point, strength, words)
