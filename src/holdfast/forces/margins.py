"""The margins of grasps and joints; a negative margin means that a grasp slips or lifts off, or a limit is violated.

A grasp's margin is the least of a few conditions on its wrench f in contact axes (z into the object), each of the form
c + a.f >= |B f|, in newtons:

    ball, hinge    mu f_n >= |f_t|                        no sliding
    softfinger     mu f_n >= sqrt(|f_t|^2 + (m_n/e)^2)    no sliding, no spinning
    hinge          f_n >= |m_y| / L                       the edge touches over its whole length
    sole           mu f_n >= |f_t|, f_n >= |m_y| / a, f_n >= |m_x| / b      it stands on all of its rectangle
    one-sided      f_n >= 0                               it presses
    limits         F >= |f|,  M/l >= |m|/l                it is strong enough; l: `WrenchLimits.lever`

The moment of a hinge or a sole about the normal is carried by the edge, and has no limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import StateError
from holdfast.forces.row_wrenches import contact_wrenches
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.model.grasp_rows import GraspRow, grasp_rows
from holdfast.model.serial_chain import answered_as_forest
from holdfast.model.wrench_condition import Condition, largest_force_and_moment
from holdfast.questions.arrays import CONTACTS, LIMITS, RAD, RATE, TORQUE, Row, contact_of, value_of
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question, ResultPart, by_joints
from holdfast.spatial.scalar import Array, Scalar, array, each, less, minimum, where
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import State, require_fit, require_state


class JointMargins(NamedTuple):
    """The margins of the joints, (n,) each; infinite without a limit.

    Attributes:
        position: distance to the nearer end of the range [rad or m].
        rate: rate limit minus |qd| [rad/s or m/s].
        effort: effort limit minus |tau| [N m or N].
    """

    position: Array
    rate: Array
    effort: Array


class JointLimits(NamedTuple):
    """The limits of a chain's joints, (n,) each; infinite for no limit.

    Attributes:
        low: lowest position [rad or m].
        high: highest position.
        rate: largest |qd| [rad/s or m/s].
        effort: largest |tau| [N m or N].
    """

    low: Array
    high: Array
    rate: Array
    effort: Array

    @property
    def limited(self) -> Array:
        """(3, n) whether position, rate and effort of each joint have a limit."""
        nearer = minimum(abs(self.low), abs(self.high))
        return array([less(limit, math.inf) for limit in (nearer, self.rate, self.effort)])


def joint_limits(chain: ClosedChain) -> JointLimits:
    """Return the limits of all joints, arms in order, base to tip."""
    return JointLimits(*value_of(LIMITS, chain))


@asked
def grasp_margins(chain: ClosedChain, state: State, grasp_wrench: ArrayLike) -> Array:
    """Return the margin of every grasp, in the order of `chain.grasps`, (grasps,) [N]. O(l).

    Those of a chain with branches, loops, couplings or several objects are followed by the margins of its loops.

    Args:
        chain: the chain.
        state: state with the object's pose; nothing else is used.
        grasp_wrench: (arms, 6) wrench of each arm on the object about the contact point, world axes, as in
            `ForwardResult`; of a chain with branches, (grasps and loops, 6), as in `MechanismResult`, whose margins are
            returned, (grasps and loops,); joint positions are used, too.

    The derivative of each margin is that of the condition with the least margin, or of one of them if several are
    equal; that of a norm |B f| is 0 where the norm is 0, and that of an infinite margin is 0.

    Raises:
        StateError: a shape is wrong.
    """
    if answered_as_forest(chain):
        rows = dict(enumerate(grasp_rows(chain)))
        require_state(chain, state)
        f = checks.numbers(grasp_wrench, (len(rows), 6), "grasp_wrench", StateError)
        with np.errstate(all="ignore"):
            return np.array([margin_of_row(rows[i], x) for i, x in contact_wrenches(chain, state, f, rows).items()])
    require_fit(chain, state)
    f = checks.numbers(grasp_wrench, (len(chain.arms), 6), "grasp_wrench", StateError)
    with np.errstate(all="ignore"):  # squares of huge forces
        return limited_margins(chain, value_of(CONTACTS, chain), state.object_frame.R, f)


def limited_margins(chain: ClosedChain, contacts: Array, R: Array, f: Array) -> Array:
    """Return the margins of all grasps, which are infinite for unlimited grasps, whatever their wrenches.

    Arguments as in `margins_of_grasps`, for the frames of the chain's grasps.
    """
    margins = margins_of_grasps(chain, contacts, R, [grasp.frame.R for grasp in chain.grasps.values()], f)
    return array([where(limited(x), margin, math.inf) for x, margin in zip(contacts, margins, strict=True)])


def margins_of_grasps(chain: ClosedChain, contacts: Array, R: Array, frames: Iterable[Array], f: Array) -> Array:
    """Return the margin of every grasp, (grasps,) [N].

    Args:
        chain: the chain, of which only names and kinds are used.
        contacts: (grasps, 7) numbers of `questions.arrays.contact_of`.
        R: (3, 3) attitude of the object.
        frames: (3, 3) each, attitudes of the contact frames, object axes.
        f: (arms, 6) wrench of each arm on the object about the contact point, world axes.
    """
    kinds, rows = [grasp.kind for grasp in chain.grasps.values()], [chain.names.index(name) for name in chain.grasps]
    found = each(
        lambda kind, contact, frame, f: contact_margin(kind, contact, unrotate(R @ frame, f)),
        kinds,
        contacts,
        frames,
        [f[row] for row in rows],
    )
    return array(found)


def contact_margin(kind: str, contact: Array, f: Array) -> Scalar:
    """Return the margin of one grasp [N], infinite if it is two-sided and has no wrench limits.

    Args:
        kind: kind of the grasp.
        contact: (7,) numbers of `questions.arrays.contact_of`.
        f: (6,) wrench of the arm on the object about the contact point, contact axes.
    """
    one_sided, mu, moment, force, lever = contact[0], contact[1], *contact[4:]
    strength = least_margin(largest_force_and_moment(moment, force, lever), f)
    friction = GRASP_KINDS[kind].friction
    if friction is None:
        return strength
    pressed = least_margin(friction(mu, contact[2:4]), f)
    return minimum(strength, where(one_sided > 0.5, pressed, math.inf))


def margin_of_row(row: GraspRow, wrench: Array) -> float:
    """Return the margin of a grasp or loop for its wrench (6,) in contact axes [N]; infinite without a limit."""
    assert row.grasp is not None
    contact = contact_of(row.grasp)
    return float(contact_margin(row.grasp.kind, contact, wrench)) if limited(contact) else math.inf


def limited(contact: Array) -> Scalar:
    """Return whether a grasp is one-sided or has wrench limits; `contact` as in `questions.arrays.contact_of`."""
    one_sided, moment, force = contact[0], contact[4], contact[5]
    return where(one_sided > 0.5, 0.0, minimum(moment, force)) < math.inf


def least_margin(conditions: tuple[Condition, ...], wrench: Array) -> Scalar:
    """Return the least margin of several conditions on a wrench in contact axes [N]."""
    margins = [condition.margin(wrench) for condition in conditions]
    return reduce(minimum, margins) if margins else math.inf


def conditions(grasp: Grasp) -> tuple[Condition, ...]:
    """Return the conditions that a grasp's wrench must satisfy."""
    found: tuple[Condition, ...] = ()
    kind, contact, limits = grasp.of_kind, grasp.contact, grasp.wrench_limits
    if contact is not None and kind.friction is not None:
        found += kind.friction(contact.mu, np.array(grasp.contact_size))
    if limits is not None:
        found += largest_force_and_moment(limits.moment, limits.force, limits.lever)
    return found


@asked
def joint_margins(chain: ClosedChain, state: State, tau: ArrayLike) -> JointMargins:
    """Return the margins of all joints. O(n).

    Args:
        chain: the chain.
        state: joint positions and rates.
        tau: (n,) drive torques, arms in order, base to tip [N m or N].

    The derivative of a position margin is that for the nearer end of the range. Half way between both ends, and at
    qd = 0 and tau = 0, it is that of one side; those of infinite margins are 0.

    Raises:
        StateError: a shape is wrong.
    """
    checks.instance(chain, ClosedChain, "chain")
    require_state(chain, state)
    efforts = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    return margins_of_joints(joint_limits(chain), joint_coordinates(chain, state.q), state.qd, efforts)


def joint_coordinates(chain: ClosedChain, q: Array) -> Array:
    """Return the positions of joints in the order of qd, (..., n); 0 for a spherical joint, which has no limits."""
    if chain.position_count == chain.joint_count:
        return q
    found = np.zeros((*q.shape[:-1], chain.joint_count), q.dtype)
    found[..., [not joint.type.quaternion for joint in chain.freedoms]] = q[..., ~quaternion_entries(chain)]
    return found


def quaternion_entries(chain: ClosedChain) -> Array:
    """Return for every entry of q whether it is one of a spherical joint, which has four."""
    entries = [joint.type.quaternion for joint in chain.all_joints for _ in range(joint.type.position_count)]
    return np.array(entries, dtype=bool)


def margins_of_joints(limits: JointLimits, q: Array, qd: Array, tau: Array) -> JointMargins:
    """Return the margins of joints for positions, rates and torques (..., n) with any leading axes."""
    return JointMargins(minimum(q - limits.low, limits.high - q), limits.rate - abs(qd), limits.effort - abs(tau))


def _margins(case: VariedCase) -> tuple[Array]:
    return (limited_margins(case.chain, case.own[CONTACTS], case.state.object_frame.R, case.own["grasp_wrench"]),)


def _limited(case: VariedCase) -> tuple[Array, ...]:
    limits = JointLimits(*case.own[LIMITS])
    found = margins_of_joints(limits, case.state.q, case.state.qd, case.own["tau"])
    return tuple(where(limited, margin, math.inf) for limited, margin in zip(limits.limited, found, strict=True))


def _grasps(chain: ClosedChain, result: str) -> list[ResultPart]:
    return [ResultPart(slice(k, k + 1), chain.names.index(name)) for k, name in enumerate(chain.grasps)]


GRASP_MARGINS = declare(
    Question(
        "grasp_margins",
        _margins,
        (Row("grasp_margins", ("grasps",), "N", "margins of the grasps; infinite without a limit"),),
        "the margin of every grasp: how far it is from slipping, lifting off or giving way",
        inputs=("object_pose", "grasp_wrench"),
        parameters=(CONTACTS, "grasp_R"),
        arguments=("object_pose", "grasp_pose", "grasp_wrench"),
        by=("object_pose", "grasp_wrench"),
        depends_on=("grasps",),
        unlimited=True,
        parts=_grasps,
        of_object=True,
    ),
    grasp_margins,
)
declare(
    Question(
        "joint_margins",
        _limited,
        (
            Row("position", ("n",), RAD, "distance to the nearer end of the range"),
            Row("rate", ("n",), RATE, "rate limit minus |qd|"),
            Row("effort", ("n",), TORQUE, "effort limit minus |tau|"),
        ),
        "the margins of all joints; infinite without a limit",
        inputs=("q", "qd", "tau"),
        parameters=(LIMITS,),
        arguments=("q", "qd", "tau"),
        by=("q", "qd", "tau"),
        depends_on=(),
        unlimited=True,
        parts=by_joints,
        returns="JointMargins",
        shown=lambda chain: lambda found: JointMargins(**found),
    ),
    joint_margins,
)
