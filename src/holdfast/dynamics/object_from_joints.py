"""The object's state computed from the joints, for chains with rigid grasps (2.8)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.consistency import require_closed
from holdfast.errors import MethodNotApplicable
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.pose import Pose
from holdfast.spatial.spatial_vector import twist_shift
from holdfast.state import Inputs, State, shaped_inputs


@np.errstate(all="ignore")  # what overflows is refused
def state_from_joints(
    chain: ClosedChain,
    q: ArrayLike,
    qd: ArrayLike,
    *,
    inputs: Inputs | None = None,
    check: bool = True,
    base_pose: Pose | ArrayLike | None = None,
    base_twist: ArrayLike | None = None,
) -> State:
    """Return the state with the object's pose and twist computed from the joints.

    V(C) = (A^T A)^-1 A^T V(0) (2.8a); the pose follows from the tip of the first grasp. O(n).

    Args:
        chain: a chain with at least one grasp, whose grasps are all rigid.
        q: (n,) joint positions.
        qd: (n,) joint rates.
        inputs: base motion, if the bases move.
        check: refuse joints that violate the grasps.
        base_pose: pose of a trunk's floating base, wxyz_xyz, if there is one.
        base_twist: (6,) twist of its origin, world axes.

    Raises:
        MethodNotApplicable: a grasp is not rigid, or there is none.
        StateError: the joints violate the grasps.
    """
    checks.instance(chain, ClosedChain, "chain")
    others = [f"'{name}' is a {grasp.kind} grasp" for name, grasp in chain.grasps.items() if grasp.free]
    if others or not chain.grasps:
        raise MethodNotApplicable(
            f"state_from_joints: needs rigid grasps, but {'; '.join(others[:3]) or 'there is none'}; give the object's"
            " pose, or try holdfast.close"
        )
    given = shaped_inputs(chain, inputs)
    start = State(q, qd, np.r_[1.0, np.zeros(6)], base_pose=base_pose, base_twist=base_twist)
    start.fits(chain)
    arms = chain_motion(chain, start, np.zeros(chain.joint_count), given).arms
    tips = {name: (arms[name].at.tip, arms[name].tip_twist) for name in chain.grasps}
    (first, (tip, _)), *_ = tips.items()
    pose = tip @ chain.grasps[first].frame.inverse()
    A = np.concatenate([twist_shift(pose.R @ grasp.frame.p) for grasp in chain.grasps.values()])
    V = np.concatenate([twist for _, twist in tips.values()])
    checks.finite(np.append(A, V), "state_from_joints")
    state = replace(start, object_pose=pose.wxyz_xyz, object_twist=np.linalg.lstsq(A, V, rcond=None)[0])
    if check:
        require_closed(chain_motion(chain, state, np.zeros(chain.joint_count), given), state)
    return state
