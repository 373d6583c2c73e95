"""How near a chain and its arms are to a singular configuration, on one scale, and along what.

The scale is that of a relative singular value s: 1 far away, 0 at a singular configuration, going to zero as the
distance does. For an arm s is that of its weakest tip direction (`tip_directions`); for the chain it is
condition^-1/2. An arm alone at a singularity leaves forward dynamics regular, but whoever asks its tip to move along
the lost direction asks for joint rates that grow as 1/s and torques that grow faster.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.indeterminate import felt_wrenches, pattern
from holdfast.dynamics.lost_direction import LOST, described, tip_directions
from holdfast.dynamics.rank import constraint_pivots
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate
from holdfast.state import State

NEARING = 0.07  # s: runs into a singularity pass it 50 ms or more before joint rates and forces explode
NEAR = 0.03  # s: about 20 ms before
STRENGTH_LOST = 5.0  # s at most, per radian that a joint turns, or part of the reach that it slides
LOST_BY_ARM = 1e-6  # s: lost, at a configuration that is known to 1e-9 s
CONFIGURATIONS_TRIED = 4  # for an arm's generic rank


def arm_strength(arm: Arm, at: Kinematics, grasp: Grasp, object_rotation: Array) -> float:
    """Return s of an arm's weakest tip direction, 0 to 1.

    Directions that the arm lacks in every configuration, having too few joints or parallel axes, do not count.

    Args:
        arm: the arm.
        at: its configuration.
        grasp: its grasp; only directions that it transmits count.
        object_rotation: (3, 3) object axes to world axes.
    """
    K = _rows(grasp, grasp.of_kind.axes(object_rotation @ grasp.frame.R, at.tip.R))
    rank = generic_tip_rank(arm, grasp)
    return float(tip_directions(K, jacobian(arm, at)).strengths[rank - 1]) if rank else 1.0


@lru_cache(maxsize=256)
def generic_tip_rank(arm: Arm, grasp: Grasp) -> int:
    """Return how many transmitted tip directions the arm can move along, away from singular configurations."""
    random = np.random.default_rng(0)
    return max(_rank_somewhere(arm, grasp, random) for _ in range(CONFIGURATIONS_TRIED))


def _rank_somewhere(arm: Arm, grasp: Grasp, random: np.random.Generator) -> int:
    at = forward_kinematics(arm, random.uniform(-np.pi, np.pi, arm.joint_count))
    return int((tip_directions(_rows(grasp, at.tip.R), jacobian(arm, at)).strengths > LOST).sum())


def _rows(grasp: Grasp, R: Array) -> Array:
    return np.array([rotate(R, row) for row in grasp.transmission]).reshape(-1, 6)


def chain_strength(condition: Array) -> Array:
    """Return s of the grasp constraint, condition^-1/2."""
    return 1.0 / np.sqrt(condition)


def nearly_lost(chain: ClosedChain, state: State, limit: float = NEAR) -> list[str]:
    """Return in words what a chain and its arms have nearly lost: all with s <= limit, the chain's first."""
    motion = chain_at_rest(chain, state)
    condition = constraint_pivots(chain, state).condition
    found = []
    if chain_strength(np.array(condition)) <= limit:
        length = length_scale([c.offset for c in motion.contacts])
        felt = felt_wrenches(motion, length)
        words = _felt(motion, felt.columns[:, felt.rank - 1], length)
        found.append(f"{words} is hardly felt by any joint or the object (condition {condition:.1e})")
    return found + lost_by_arms(motion, limit)


def lost_at(motion: ChainMotion, rank: int, generic_rank: int) -> list[str]:
    """Return in words what is lost at a singular configuration, the loads first that nothing feels there.

    Args:
        motion: the chain there.
        rank: of K [J, -A].
        generic_rank: of the same, away from there.
    """
    length = length_scale([c.offset for c in motion.contacts])
    columns = felt_wrenches(motion, length).columns[:, rank:generic_rank]
    loads = [f"{_felt(motion, column, length)} is felt by no joint and not by the object" for column in columns.T]
    return loads + lost_by_arms(motion, LOST_BY_ARM)


def lost_by_arms(motion: ChainMotion, limit: float) -> list[str]:
    """Return in words the tip directions that arms have nearly lost, those with s <= limit."""
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


def _felt(motion: ChainMotion, wrenches: Array, length: float) -> str:
    """Return a pattern of grasp wrenches in words, whatever its size."""
    each = wrenches.reshape(-1, 6)
    largest = np.abs(each * np.r_[np.full(3, 1 / length), np.ones(3)]).max()
    return pattern(motion, each / largest, length)
