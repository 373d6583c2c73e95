"""Projection onto the constraint by the smallest change in the kinetic metric that closes the grasps.

A velocity mismatch v_i = V+ - A V(C) at the grasps is removed by impulses p_i with

    K Omega K^T p = K v,   dqd = -M^-1 J^T p,   dV(C) = M(C)^-1 A^T p

This is forward dynamics at rest with v_i in place of the free tip accelerations (docs/theory/simulation.md), and is
computed by the same object filter in O(n) + O(l). A position mismatch is removed in the same way, in a few iterations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion, at_rest
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.tip_response import TipResponse, tip_response
from holdfast.dynamics.grasp_gap import tip_from_contact
from holdfast.dynamics.tree.of_chain import chain_elimination
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import ARRAYS, FLOATING, OBJECT, STATE, Row, state_fields
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import declare
from holdfast.questions.question import Question
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each, maximum, scan
from holdfast.spatial.spatial_vector import rotate, shift_twist
from holdfast.spatial.vector import largest
from holdfast.state import Inputs, State

CLOSED_GAP = 1e-14  # m and rad: the iteration stops below this gap
STEP_ROUNDS = 2  # iterations at the end of a step
WIDEST_GAP = 1e-2  # m and rad: a larger gap does not come from a valid step
LEFT_OPEN = 1e-9  # m and rad: a larger remaining gap is not rounding


class Change(NamedTuple):
    """A change of the chain's velocities, or a small displacement.

    Attributes:
        qd: (n,) change of the joint rates.
        object: (6,) change of the object's twist.
        base: (6,) change of the twist of a floating base; None without one.
    """

    qd: Array
    object: Array
    base: Array | None


def constraint_impulses(
    motion: ChainMotion, contacts: list[Contact], mismatch: list[Array]
) -> tuple[Change, list[Array]]:
    """Return the change of velocities that removes a mismatch at the grasps, and the corresponding impulses.

    Args:
        motion: the chain at its configuration; its velocities are ignored.
        contacts: the grasps at which tip and object shall agree along the transmitted directions.
        mismatch: per grasp, (6,) tip side minus object side about the contact point,
            world axes; only its transmitted part counts.

    Returns:
        The change, and per grasp the impulse of the arm on the object.
    """
    none, chain = np.zeros(6), motion.chain
    tips = each(gap_response, motion.holding, mismatch)
    still = motion.at_rest_with(each(lambda c: replace(c, a=none, g=none), contacts))
    lone = each(lambda arm: gap_response(arm, none), [motion.arms[name] for name in motion.lone_on_trunk])
    of_arms = dict(zip([*chain.grasps, *motion.lone_on_trunk], [*tips, *lone], strict=True))
    whole = chain_elimination(chain, still.contacts, of_arms, still.body.free, still.trunk)
    pushes = [*whole.wrenches, *(none for _ in lone)]
    found = each(
        lambda tip, impulse, beta: tip.back_substitute(impulse, beta)[0],
        of_arms.values(),
        pushes,
        [whole.columns.get(name) for name in of_arms],
    )
    changes = {name: np.zeros(arm.joint_count) for name, arm in chain.arms.items()}
    changes |= dict(zip(of_arms, found, strict=True))
    dqd = concatenate([whole.trunk.qdd, *changes.values()])
    return Change(dqd, whole.object_acceleration, whole.trunk.base), whole.wrenches


def gap_response(arm: ArmMotion, gap: Array) -> TipResponse:
    """Return the tip response of an arm at rest, with the mismatch in place of the free acceleration."""
    return replace(tip_response(at_rest(arm), "auto"), free_acceleration=gap)


def project_velocities(motion: ChainMotion, state: State) -> State:
    """Return the state with the velocities that satisfy the grasps and are nearest in the kinetic metric."""
    twist = state.object_twist
    mismatch = each(lambda arm, c: arm.tip_twist - shift_twist(c.offset, twist), motion.holding, motion.contacts)
    change, _ = constraint_impulses(motion, motion.contacts, mismatch)
    return quickened(state, change)


def quickened(state: State, by: Change) -> State:
    """Return the state with its velocities changed."""
    base = None if by.base is None or state.base_twist is None else state.base_twist + by.base
    return State(state.q, state.qd + by.qd, state.object_pose, state.object_twist + by.object, state.base_pose, base)


class Gap(NamedTuple):
    """The largest gaps of any grasp.

    Attributes:
        position: largest component of the position rows, with the sine for rotations up to a quarter turn, and the
            angle beyond, see `rotation.beyond_quarter_turn` [m or rad].
        velocity: largest component of the velocity rows [m/s or rad/s].
    """

    position: Scalar
    velocity: Scalar


class StepEnd(NamedTuple):
    """A step's end on the grasps.

    Attributes:
        state: the state.
        before, after: the gaps before the projection, and after it.
        motion: the chain's motion there, without torques.
    """

    state: State
    before: Gap
    after: Gap
    motion: ChainMotion


def after_step(
    chain: ClosedChain,
    state: State,
    inputs: Inputs,
    held: Array | None = None,
    going_on: Callable[[State, State], State] | None = None,
) -> StepEnd:
    """Return a step's end projected onto the position and velocity constraints.

    Two of the iterations of `project` correct the positions, which closes a valid step up to rounding; then the
    velocities are corrected once.

    Args:
        chain: the chain.
        state: the state at the end of an integrator's step.
        inputs: shaped inputs, of which only the base motion matters.
        held: mask of the constraint rows that the step imposes, see `held_rows`; None for all.
        going_on: function of the states before and after a projection that returns the one to go on with; None: that
            after it.
    """
    start, none, before = state, np.zeros(chain.joint_count), None
    for _ in range(STEP_ROUNDS):
        motion = chain_motion(chain, state, none, inputs)
        before = largest_gaps(chain, state, inputs, motion) if before is None else before
        state = closer(holding(motion, held, positions=True), state, position_mismatch(motion, state))
    state = state if going_on is None else going_on(start, state)
    motion = chain_motion(chain, state, none, inputs)
    end = project_velocities(holding(motion, held), state)
    end = end if going_on is None else going_on(state, end)
    motion = chain_motion(chain, end, none, inputs, motion)
    assert before is not None
    return StepEnd(end, before, largest_gaps(chain, end, inputs, motion), motion)


def closer(motion: ChainMotion, state: State, gaps: list[Array]) -> State:
    """Return the state after one Newton iteration on the position rows.

    Args:
        motion: the chain's motion at that state.
        state: the state.
        gaps: its `position_mismatch`.
    """
    change, _ = constraint_impulses(motion, each(position_contact, motion.contacts), gaps)
    return displaced_by(state, change)


def largest_gaps(chain: ClosedChain, state: State, inputs: Inputs, motion: ChainMotion | None = None) -> Gap:
    """Return the largest gaps of any grasp; 0 without grasps.

    Args:
        chain: the chain.
        state: any state.
        inputs: shaped inputs, of which only the base motion matters.
        motion: the chain's motion at that state, if it is known.
    """
    if motion is None:
        motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    shifts = position_mismatch(motion, state)
    found = each(
        lambda c, shift, hidden: (
            maximum(largest(position_contact(c).transmitted(shift)), hidden),
            largest(c.velocity_gap),
        ),
        motion.contacts,
        shifts,
        hidden_gaps(motion, state),
    )
    gaps, _ = scan(lambda worst, gap: ((maximum(worst[0], gap[0]), maximum(worst[1], gap[1])), None), (0.0, 0.0), found)
    return Gap(*gaps)


def position_mismatch(motion: ChainMotion, state: State) -> list[Array]:
    """Return for each grasp the small displacement of the tip relative to the object, (6,) world axes."""
    origin = state.object_frame.p
    return each(lambda arm, c: small_displacement(c, origin + c.origin, arm.at.tip), motion.holding, motion.contacts)


def hidden_gaps(motion: ChainMotion, state: State) -> list[Scalar]:
    """Return for each grasp the gap that its small displacement does not show; see `GraspKind.hidden_gap`."""
    origin = state.object_frame.p

    def hidden(arm: ArmMotion, c: Contact) -> Scalar:
        seen = tip_from_contact(c, origin + c.origin, arm.at.tip)
        return c.grasp.of_kind.hidden_gap(seen.R, seen.p)

    return each(hidden, motion.holding, motion.contacts)


def small_displacement(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return the displacement of the tip relative to the object, (6,) world axes, with sine times axis as rotation.

    This is accurate enough for Newton iterations, because the sine differs from a small angle t by t^3 / 6 only. The
    rotation is zero for grasps with free attitude, and has no component about the axis of a hinge.

    Args:
        c: the contact.
        contact_point: (3,) contact point on the object, world axes.
        tip: pose of the arm's tip frame in the world.
    """
    seen = tip_from_contact(c, contact_point, tip)
    return rotate(c.R, c.grasp.of_kind.small_gap(seen.R, seen.p))


def moved(state: State, step: Array) -> State:
    """Return the state displaced by a step in the columns of `ConstraintRows.matrix`: joints, object, floating base.

    A pose that is displaced by exactly zero is kept: a rotation by zero could change its last bits. For floats only.
    """
    n = len(state.q)
    base = step[n + 6 :]
    there = displaced_by(state, Change(step[:n], step[n : n + 6], base if len(base) else None))
    object_pose = there.object_pose if step[n : n + 6].any() else state.object_pose
    return replace(there, object_pose=object_pose, base_pose=there.base_pose if base.any() else state.base_pose)


def displacement(before: State, after: State) -> Array:
    """Return the step from one state to another, for `moved`, but with rotation vectors of any length."""
    frames = [(before.object_frame, after.object_frame), (before.base_frame, after.base_frame)]
    turns = [[rotation.log(b.R @ a.R.T), b.p - a.p] for a, b in frames if a is not None and b is not None]
    return np.concatenate([after.q - before.q, *(part for turn in turns for part in turn)])


def displaced_by(state: State, by: Change) -> State:
    """Return the state displaced by joint steps, and [turn; shift] of the object and of a floating base."""
    base = None if by.base is None or state.base_pose is None else turned_and_shifted(state.base_pose, by.base)
    object_pose = turned_and_shifted(state.object_pose, by.object)
    return State(state.q + by.qd, state.qd, object_pose, state.object_twist, base, state.base_twist)


def turned_and_shifted(pose: Array, dx: Array) -> Array:
    """Return a pose wxyz_xyz displaced by [turn; shift] along world axes."""
    turn = rotation.quaternion_product(rotation.quaternion_exp(dx[:3]), pose[:4])
    return concatenate([rotation.normalised(turn), pose[4:] + dx[3:]])


def position_contact(c: Contact) -> Contact:
    """Return the contact with its position rows, which are fewer than its velocity rows for a nonholonomic grasp."""
    return replace(c, rows=c.grasp.of_kind.position_rows)


_OF_CLOSED = "closed."  # the prefix of the names of a projected state's arrays


def _projected(case: VariedCase) -> tuple[Array, ...]:
    found = after_step(case.chain, case.state, case.inputs).state
    return tuple(getattr(found, field) for field in state_fields(case.chain).values())


def _closed_row(row: Row) -> Row:
    return row._replace(name=f"{_OF_CLOSED}{row.name}", meaning=f"closed: {row.meaning}")


PROJECT = declare(
    Question(
        "project",
        _projected,
        tuple(_closed_row(ARRAYS[name]) for name in (*STATE, *FLOATING)),
        "the state projected onto the grasp constraint, positions and velocities, in the kinetic metric",
        inputs=STATE,
        parameters=(*OBJECT, "base_R", "base_p", "base_twist", "grasp_R", "grasp_p"),
        depends_on=("grasps", "links"),
        returns="dict[str, Array]",
        shown=lambda chain: lambda found: {name.removeprefix(_OF_CLOSED): x for name, x in found.items()},
    )
)
