"""The object's state from the joints alone, where every grasp is rigid (2.8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.motion import ArmInputs, arm_motion
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.consistency import require_closed
from holdfast.errors import MethodNotApplicable
from holdfast.model.closed_chain import ClosedChain, require_own_bases
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import twist_shift
from holdfast.state import Inputs, State


def state_from_joints(
    chain: ClosedChain, q: ArrayLike, qd: ArrayLike, *, inputs: Inputs | None = None, check: bool = True
) -> State:
    """Return the state whose object pose and twist follow from the joints.

    V(C) = (A^T A)^-1 A^T V(0) (2.8a); the pose is the one of the first grasp's tip. O(n).

    Args:
        chain: a chain whose grasps, at least one, are all rigid.
        q: (n,) joint positions.
        qd: (n,) joint rates.
        inputs: base motion, if the bases move.
        check: refuse joints that do not close the chains.

    Raises:
        MethodNotApplicable: a grasp is not rigid, or there is none.
        StateError: the joints do not close the chains.
    """
    require_own_bases(chain, "state_from_joints")
    others = [f"'{name}' is a {grasp.kind}" for name, grasp in chain.grasps.items() if grasp.free]
    if others or not chain.grasps:
        raise MethodNotApplicable(
            f"state_from_joints: needs rigid grasps, but {'; '.join(others[:3]) or 'there is none'}; give the object's"
            " pose, or try holdfast.close"
        )
    given = (inputs or Inputs()).shaped(chain)
    start = State(q, qd, np.r_[1.0, np.zeros(6)])
    start.fits(chain)
    tips = {name: _tip(chain, start, given, name) for name in chain.grasps}
    (first, (tip, _)), *_ = tips.items()
    pose = tip @ chain.grasps[first].frame.inverse()
    A = np.concatenate([twist_shift(pose.R @ grasp.frame.p) for grasp in chain.grasps.values()])
    V = np.concatenate([twist for _, twist in tips.values()])
    state = State(q, qd, pose.wxyz_xyz, np.linalg.lstsq(A, V, rcond=None)[0])
    if check:
        require_closed(chain_motion(chain, state, np.zeros(chain.joint_count), given), state)
    return state


def _tip(chain: ClosedChain, state: State, given: Inputs, name: str) -> tuple[Pose, Array]:
    """Return pose and twist of one arm's tip."""
    assert given.base_twists is not None
    part, base = chain.joints[name], given.base_twists[chain.names.index(name)]
    none = np.zeros(chain.arms[name].joint_count)
    motion = arm_motion(ArmInputs(chain.arms[name], state.q[part], state.qd[part], none, base, np.zeros(6)))
    return motion.at.tip, motion.tip_twist
