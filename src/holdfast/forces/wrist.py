"""The wrench at a force-torque sensor in an arm's wrist, mounted at the tip frame or at the last joint."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.contact_places import tip_frames
from holdfast.dynamics.inverse import require_holding
from holdfast.dynamics.result import ForwardResult, require_result_of
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import Row
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question, ResultPart
from holdfast.spatial.scalar import Array, array, each
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench, unrotate
from holdfast.state import Inputs, State, require_fit, shaped_inputs


@asked
def wrist_wrenches(chain: ClosedChain, state: State, result: ForwardResult) -> Array:
    """Return the wrench of each arm on the object across its tip frame, (arms, 6) [N m, N].

    This is the grasp wrench in TIP axes, [moment; force] about the tip's origin, as a massless sensor between the last
    link and the object measures it. It is zero for an arm without a grasp. O(n).

    Args:
        chain: the chain.
        state: a closed state (the tip's origin is the contact point).
        result: forward dynamics at that state.

    Raises:
        StateError: the state has a wrong shape for the chain, or the result belongs to another chain.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    wrenches = checks.numbers(result.grasp_wrench, (len(chain.arms), 6), "result: grasp_wrench", StateError)
    return across_tips(chain, state, wrenches)


def across_tips(chain: ClosedChain, state: State, grasp_wrench: Array) -> Array:
    """Return the grasp wrenches in tip axes, without checks; see `wrist_wrenches`."""
    tips = tip_frames(chain, state, chain.names)
    return array(each(lambda tip, f: unrotate(tip.R, f), tips.values(), grasp_wrench)).reshape(-1, 6)


@np.errstate(all="ignore")  # what overflows is refused below
def last_joint_wrenches(chain: ClosedChain, state: State, result: ForwardResult, inputs: Inputs | None = None) -> Array:
    """Return the wrench of each arm on its last link across the last joint, (arms, 6) [N m, N].

    F = phi f + M alpha + b: the grasp wrench plus the wrench for the last link's weight, inertia and external wrench,
    in the LAST LINK's axes, [moment; force] about that link's origin, which lies on the joint. Its component along the
    joint's axis is the torque of the drive minus those of damping, spring and rotor. For an anchor, which has no joint,
    it is the wrench across its base, [moment; force] about the base's origin, in the base's axes. O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        result: forward dynamics at that state.
        inputs: the inputs of forward dynamics.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain, or a result of another chain.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), shaped_inputs(chain, inputs))
    found, carried = [], motion.trunk.carried(result.qdd, result.base_acceleration)
    for (name, arm), f in zip(motion.arms.items(), result.grasp_wrench, strict=True):
        R, tip = arm.at.end, arm.arm.tip.p
        across_tip = shift_wrench(tip, unrotate(R, arm.unknown(f)))  # the bias contains known wrenches
        if not arm.arm.joints:
            found.append(across_tip if arm.bias.of_base is None else across_tip + arm.bias.of_base)
            continue
        by_joints = tip_acceleration(arm, result.qdd[chain.joints[name]], carried.get(name)) - arm.bias.tip_acceleration
        alpha = shift_twist(-tip, unrotate(R, by_joints))  # of the link's origin, without the bias
        found.append(across_tip + arm.arm.links[-1].spatial_inertia.apply(alpha) + arm.bias.wrenches[-1])
    return checks.finite(np.array(found), "last joint wrenches")


def _wrists(case: VariedCase) -> tuple[Array]:
    return (across_tips(case.chain, case.state, case.own["grasp_wrench"]),)


WRISTS = declare(
    Question(
        "wrist_wrenches",
        _wrists,
        (Row("wrist_wrenches", ("arms", 6), "N m, N", "wrench [moment; force] of each arm on the object"
            " across its tip frame, about the tip's origin, tip axes"),),
        "the grasp wrenches in tip axes, as force-torque sensors in the wrists measure them",
        inputs=("q", "grasp_wrench"),
        parameters=("base_R",),
        arguments=("q", "base_pose", "floating_pose", "grasp_wrench"),
        by=("q", "grasp_wrench"),
        depends_on=(),
        require=require_holding,
        parts=lambda chain, _: [ResultPart(slice(6 * row, 6 * row + 6), row) for row in range(len(chain.arms))],
    ),
    wrist_wrenches,
    own=lambda result, **_: {"grasp_wrench": result.grasp_wrench},
)  # fmt: skip
