"""A measure of the distance of a chain and its arms from singular configurations, and the directions concerned.

The measure is a relative singular value s, which is 1 far from singular configurations and goes to 0 in proportion to
the distance from one. For an arm, s belongs to its weakest tip direction (`tip_directions`); for the chain, it is
condition^-1/2. Forward dynamics stays regular if a single arm is singular. However, a motion of its tip along the lost
direction needs joint rates that grow as 1/s, and torques that grow faster.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.indeterminate import pattern, wrench_directions
from holdfast.dynamics.lost_direction import LOST, described, tip_directions
from holdfast.dynamics.rank import constraint_pivots
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate
from holdfast.state import State

NEARING = 0.07  # s that runs towards a singularity pass 50 ms or more before joint rates and forces grow without bound
NEAR = 0.03  # s that they pass about 20 ms before
STRENGTH_LOST = 5.0  # largest change of s per radian of a joint, or per displacement relative to the reach
LOST_BY_ARM = 1e-6  # s below which a direction is lost, at a configuration whose time is known to 1e-9 s
CONFIGURATIONS_TRIED = 4  # number of configurations with which the generic rank of an arm is determined


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
    return int((tip_directions(_rows(grasp, at.tip.R), jacobian(arm, at)).strengths > LOST).sum())


def _rows(grasp: Grasp, R: Array) -> Array:
    return np.array([rotate(R, row) for row in grasp.transmission]).reshape(-1, 6)


def chain_strength(condition: Array) -> Array:
    """Return s of the grasp constraint, condition^-1/2."""
    return 1.0 / np.sqrt(condition)


def nearly_lost(chain: ClosedChain, state: State, limit: float = NEAR) -> list[str]:
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
