"""Back onto the constraint: the smallest change, in the kinetic metric, that closes the grasps.

A velocity mismatch v_i = V+ - A V(C) at the grasps is removed by impulses p_i with

    K Omega K^T p = K v,   dqd = -M^-1 J^T p,   dV(C) = M(C)^-1 A^T p

which is forward dynamics at rest with v_i for the free tip accelerations (docs/theory/simulation.md): the
same object filter, O(n) + O(l). A position mismatch is removed likewise, in a few rounds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion, at_rest
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest, chain_motion
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.object_filter import object_filter
from holdfast.dynamics.closed.tip_response import TipResponse, tip_response
from holdfast.dynamics.consistency import tip_from_contact
from holdfast.dynamics.trunk.trunk_dynamics import filtered
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each, maximum, scan
from holdfast.spatial.spatial_vector import rotate, shift_twist
from holdfast.state import Inputs, State

CLOSED = 1e-14  # m and rad: no round beyond this
STEP_ROUNDS = 2  # for a step's end
FARTHEST = 1e-2  # m and rad: a state further off was not produced by a sound step
LEFT_OPEN = 1e-9  # m and rad: what is left beyond this is no rounding


class Change(NamedTuple):
    """A change of the chain's velocities, or a small displacement.

    Attributes:
        qd: (n,) of the joint rates.
        object: (6,) of the object's twist.
        base: (6,) of the twist of a floating base; None without one.
    """

    qd: Array
    object: Array
    base: Array | None


def constraint_impulses(
    motion: ChainMotion, contacts: list[Contact], mismatch: list[Array]
) -> tuple[Change, list[Array]]:
    """Return the change of velocities that removes a mismatch at the grasps, and the impulses that bring it.

    Args:
        motion: the chain at its configuration; its velocities do not enter.
        contacts: the grasps whose transmitted directions are to agree.
        mismatch: per grasp, (6,) tip side minus object side about the contact point,
            world axes; only its transmitted part counts.

    Returns:
        The change, and per grasp the impulse of the arm on the object.
    """
    none, chain = np.zeros(6), motion.chain
    tips = each(gap_response, motion.holding, mismatch)
    still = each(lambda c: replace(c, a=none, g=none), contacts)
    if motion.trunk is not None:
        return trunk_impulses(replace(motion, contacts=still), tips)
    found = object_filter(still, tips, motion.body.free.at_rest())
    changes = each(lambda tip, impulse: tip.back_substitute(impulse)[0], tips, found.wrenches)
    of_arm = dict(zip(chain.grasps, changes, strict=True))
    dqd = [of_arm.get(name, np.zeros(arm.joint_count)) for name, arm in chain.arms.items()]
    return Change(concatenate(dqd), found.object_acceleration, None), found.wrenches


def trunk_impulses(motion: ChainMotion, tips: list[TipResponse]) -> tuple[Change, list[Array]]:
    """Return what `constraint_impulses` does where arms stand on a trunk: it moves too, and all arms on it.

    Args:
        motion: the chain, its grasps without accelerations of their own.
        tips: the answers of the arms that hold, at rest but for the mismatch.
    """
    assert motion.trunk is not None
    chain, none = motion.chain, np.zeros(6)
    still = replace(motion, trunk=motion.trunk.at_rest(), body=replace(motion.body, free=motion.body.free.at_rest()))
    lone = each(lambda arm: gap_response(arm, none), [motion.arms[name] for name in motion.lone_on_trunk])
    whole = filtered(still, tips, lone)
    of_arm = dict(zip(chain.grasps, zip(tips, whole.found.wrenches, strict=True), strict=True))
    of_arm |= {name: (tip, none) for name, tip in zip(motion.lone_on_trunk, lone, strict=True)}
    dqd = [whole.trunk.qdd]
    for name, arm in chain.arms.items():
        if name in of_arm:
            tip, impulse = of_arm[name]
            dqd.append(tip.back_substitute(impulse, motion.trunk.of_columns(name, whole.trunk, whole.betas))[0])
        else:
            dqd.append(np.zeros(arm.joint_count))
    return Change(concatenate(dqd), whole.found.object_acceleration, whole.trunk.base), whole.found.wrenches


def gap_response(arm: ArmMotion, gap: Array) -> TipResponse:
    """Return how an arm at rest answers to impulses at its tip, its mismatch in the place of the free acceleration."""
    return tip_response(at_rest(arm), "auto")._replace(free_acceleration=gap)


def project_velocities(motion: ChainMotion, state: State) -> State:
    """Return the state with the velocities nearest in kinetic energy that keep the grasps."""
    twist = state.object_twist
    mismatch = each(lambda arm, c: arm.tip_twist - shift_twist(c.offset, twist), motion.holding, motion.contacts)
    change, _ = constraint_impulses(motion, motion.contacts, mismatch)
    return quickened(state, change)


def quickened(state: State, by: Change) -> State:
    """Return the state with its velocities changed."""
    base = None if by.base is None or state.base_twist is None else state.base_twist + by.base
    return State(state.q, state.qd + by.qd, state.object_pose, state.object_twist + by.object, state.base_pose, base)


class Gap(NamedTuple):
    """How far the worst grasp is from holding.

    Attributes:
        position: largest component of the position rows, a turn as its sine [m or rad].
        velocity: largest component of the velocity rows [m/s or rad/s].
    """

    position: Scalar
    velocity: Scalar


def after_step(chain: ClosedChain, state: State, inputs: Inputs, held: Array | None = None) -> State:
    """Return a step's end moved back onto position and velocity constraints.

    Two of `project`'s rounds on the positions, which close a sound step to rounding, then velocities once.

    Args:
        chain: the chain.
        state: where an integrator's step ends.
        inputs: shaped inputs; base motion enters.
        held: which components of the grasps the step holds, see `held_rows`; None: all.
    """
    for _ in range(STEP_ROUNDS):
        motion = holding(chain_at_rest(chain, state), held, positions=True)
        state = closer(motion, state, position_mismatch(motion, state))
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    return project_velocities(holding(motion, held), state)


def closer(motion: ChainMotion, state: State, gaps: list[Array]) -> State:
    """Return the state after one of Newton's rounds on the position rows.

    Args:
        motion: the chain in that configuration.
        state: the state.
        gaps: its `position_mismatch`.
    """
    change, _ = constraint_impulses(motion, each(position_contact, motion.contacts), gaps)
    return displaced_by(state, change)


def largest_gaps(chain: ClosedChain, state: State, inputs: Inputs) -> Gap:
    """Return how far the worst grasp is from holding, 0 without any.

    Args:
        chain: the chain.
        state: any state.
        inputs: shaped inputs; base motion enters.
    """
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    shifts = position_mismatch(motion, state)
    found = each(
        lambda c, shift: (largest(position_contact(c).transmitted(shift)), largest(c.velocity_gap)),
        motion.contacts,
        shifts,
    )
    gaps, _ = scan(lambda worst, gap: ((maximum(worst[0], gap[0]), maximum(worst[1], gap[1])), None), (0.0, 0.0), found)
    return Gap(*gaps)


def largest(x: Array) -> Scalar:
    """Return the largest absolute value of an array's entries."""
    found: Scalar = 0.0
    for entry in x:
        found = maximum(found, abs(entry))
    return found


def position_mismatch(motion: ChainMotion, state: State) -> list[Array]:
    """Return per grasp the small displacement tip minus object, (6,) world axes."""
    origin = state.object_frame.p
    return each(lambda arm, c: small_displacement(c, origin + c.origin, arm.at.tip), motion.holding, motion.contacts)


def small_displacement(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return the displacement tip minus object, (6,) world axes, its turn as sine times axis.

    Newton's rounds need a turn only as exactly as they converge: for a turn t the sine is off by
    t^3 / 6. The turn is zero where attitudes are free, and about no direction of a hinge's axis.

    Args:
        c: the grasp in motion.
        contact_point: (3,) on the object, world axes.
        tip: the arm's tip frame in the world.
    """
    seen = tip_from_contact(c, contact_point, tip)
    return rotate(c.R, c.grasp.of_kind.small_gap(seen.R, seen.p))


def moved(state: State, step: Array) -> State:
    """Return the state displaced by a step in the columns of `ConstraintRows.matrix`: joints, object, floating base."""
    n = len(state.q)
    base = step[n + 6 :]
    return displaced_by(state, Change(step[:n], step[n : n + 6], base if len(base) else None))


def displaced_by(state: State, by: Change) -> State:
    """Return the state displaced by joint steps, and [turn; shift] of the object and of a floating base."""
    base = None if by.base is None or state.base_pose is None else turned_and_shifted(state.base_pose, by.base)
    object_pose = turned_and_shifted(state.object_pose, by.object)
    return State(state.q + by.qd, state.qd, object_pose, state.object_twist, base, state.base_twist)


def turned_and_shifted(pose: Array, dx: Array) -> Array:
    """Return a pose wxyz_xyz displaced by [turn; shift], world axes."""
    turn = rotation.quaternion_product(rotation.quaternion_exp(dx[:3]), pose[:4])
    return concatenate([rotation.normalised(turn), pose[4:] + dx[3:]])


def position_contact(c: Contact) -> Contact:
    """Return the contact with its position rows: fewer than its velocity rows where the grasp is nonholonomic."""
    return replace(c, rows=c.grasp.of_kind.position_rows)
