"""Inverse dynamics of a closed chain: the torques for given accelerations and grasp forces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.feasible_motion import feasibility, feasible, require_feasible, require_holding
from holdfast.dynamics.trunk.trunk_inverse import trunk_torques
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import ARGUMENTS, FLOATING_RESULT, TRUNK_BASE_MOTION, TRUNK_LINKS
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question, by_joints
from holdfast.spatial.scalar import Array, array, concatenate, each
from holdfast.state import Inputs, State, require_fit, shaped_inputs


@asked
@np.errstate(all="ignore")  # what overflows is refused below
def inverse_dynamics(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike,
    inputs: Inputs | None = None,
    base_acceleration: ArrayLike | None = None,
) -> Array:
    """Return tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), arm by arm (2.1a). O(n).

    The caller must provide accelerations that satisfy the grasps, and wrenches that move the object accordingly;
    `forward_dynamics` with the returned torques then reproduces them.

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) wrench of each arm on the object, about the contact, world axes. Rows of arms without a
            grasp must be zero; rows of bushings must be the wrenches that these exert, or zero, which stands for them.
        inputs: external wrenches and base motion.
        base_acceleration: (6,) true acceleration of a trunk's floating base, world axes; required if there is one.

    Returns:
        (n,) joint torques [N m or N].

    Raises:
        StateError: a shape is wrong, a wrench is given for an arm without a grasp, a wrench differs from that of a
            bushing, or a floating base would need a drive.
    """
    require_fit(chain, state)
    qdd = checks.numbers(qdd, (chain.joint_count,), "qdd", StateError)
    f = checks.numbers(grasp_wrench, (len(chain.arms), 6), "grasp_wrench", StateError)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), shaped_inputs(chain, inputs))
    require_holding(chain, {"grasp_wrench": f})
    tau, *others = torques_and_deciding(motion, qdd, f, acceleration_of_base(chain, base_acceleration))
    require_feasible(chain, f, dict(zip(feasibility(chain), others, strict=True)))
    return checks.finite(tau, "inverse dynamics")


def acceleration_of_base(chain: ClosedChain, given: ArrayLike | None) -> Array | None:
    """Return the checked acceleration of a chain's floating base, (6,); None without one.

    Raises:
        StateError: the acceleration is missing, or is given although no base floats.
    """
    if chain.floats != (given is not None):
        wanted = "the acceleration of the floating base" if chain.floats else "none, as no base floats"
        raise StateError(f"base_acceleration: expected {wanted}, got {checks.short(given)}")
    return None if given is None else checks.numbers(given, (6,), "base_acceleration", StateError)


def torques_and_deciding(motion: ChainMotion, qdd: Array, f: Array, base: Array | None) -> tuple[Array, ...]:
    """Return the torques of inverse dynamics, (n,), and then the arrays of `feasibility`.

    The wrenches of bushings are already part of the arms' bias, so their rows in f, (arms, 6), are not used.
    """
    exerted = [arm.known for arm in motion.arms.values()]
    known = [x for x in exerted if x is not None]
    left = array([row if x is None else np.zeros(6) for row, x in zip(f, exerted, strict=True)]) if known else f
    of_bushings = [array([np.zeros(6) if x is None else x for x in exerted])] if known else []
    if motion.trunk is not None and motion.trunk.floats:
        return *trunk_torques(motion, qdd, left, base), *of_bushings
    return torques(motion, qdd, left), *of_bushings


def torques(motion: ChainMotion, qdd: Array, f: Array, base: Array | None = None) -> Array:
    """Return the torques of the drives of trunk and arms, (n,), for grasp wrenches from which bushings are excluded.

    A floating base has the acceleration `base`, (6,), or zero; the wrench that this requires is ignored. See
    `inverse_dynamics`.
    """
    if motion.trunk is not None:
        return trunk_torques(motion, qdd, f, np.zeros(6) if base is None and motion.trunk.floats else base).tau
    return concatenate(each(drive_torques, motion.arms.values(), [qdd[part] for part in motion.chain.arm_joints], f))


def _torques(case: VariedCase) -> tuple[Array, ...]:
    """Return tau and the arrays of `feasibility`."""
    motion = chain_motion(case.chain, case.state, np.zeros(case.chain.joint_count), case.inputs)
    return torques_and_deciding(motion, case.own["qdd"], case.own["grasp_wrench"], case.own.get(FLOATING_RESULT))


def _with_held(case: VariedCase) -> VariedCase:
    """Return the case with zero wrenches for arms without a grasp."""
    rows = zip(case.chain.arms, case.own["grasp_wrench"], strict=True)
    f = array([row if name in case.chain.grasps else np.zeros(6) for name, row in rows])
    return case._replace(own={**case.own, "grasp_wrench": f})


INVERSE_DYNAMICS = declare(
    Question(
        "inverse_dynamics",
        _torques,
        ("tau",),
        "the joint torques of a motion under given grasp wrenches, tau = M qdd + C + J^T f + damping qd"
        " + stiffness (q - rest)",
        inputs=("q", "qd", "qdd", "grasp_wrench"),
        parameters=("gravity", "base_R", "base_twist", "base_acceleration"),
        arguments=(
            *(name for name in ARGUMENTS if name != "tau"),
            *("qdd", "grasp_wrench", FLOATING_RESULT),
            *(*TRUNK_LINKS, "trunk_link_wrench", *TRUNK_BASE_MOTION, "floating_twist", "floating_pose"),
        ),
        by=("q", "qd", "qdd", "grasp_wrench"),
        depends_on=("links", "forces", "bushings"),
        parts=by_joints,
        feasibility=feasibility,
        restricted=_with_held,
        require=require_holding,
        settle=feasible,
    ),
    inverse_dynamics,
)
