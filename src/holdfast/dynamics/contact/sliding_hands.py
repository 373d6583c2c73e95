"""Hands that may slide on the object: contacts whose other body is the tip of an arm instead of the world.

Such an arm is not part of the closed chain. Its tip gives way to a force by its own mobility Lambda, so that with the
stacked velocities of the object and of these tips the rows of a hand's point l (from C), r (from the tip's origin) are

    u = C V - C_tip V_tip = [C, -C_tip] [V; V_tip],        mobility diag(P, Lambda_1, ..)

and the laws, the solver and the modes are those of the world's contacts, all in one problem. (Equivalently, u has the
compliance C_tip Lambda C_tip^T.) The surface is the plane of the grasp's frame, fixed in the object with its axes; the
points are fixed in the tip. Along the object's axes, with a_r the acceleration of the point,

    du/dt = axes (a + alpha x l + w x (w x l) - 2 w x u - a_r)

A ball has one point. So has a soft finger, with a fourth row e n . (w - w_tip). A hinge with friction has the ends of
its edge. A sole is a patch whose corners would share its load in an arbitrary way, and does not slide.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.motion import at_rest
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion, pseudo_gravity
from holdfast.dynamics.closed.sequential import rest_response
from holdfast.dynamics.closed.tip_response import tip_response
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.touch import impulse_response
from holdfast.dynamics.impulse import grasp_here
from holdfast.dynamics.projection import Change
from holdfast.dynamics.result import ForwardResult
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.frozen import Frozen, changed
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import Inputs, State

SLIDING_SIZES = (None, "torsion_radius", "half_length")  # of the kinds that can slide: points, patches and edges


@dataclass(frozen=True, eq=False)
class Hand(Frozen):
    """A one-sided grasp that has left the closed chain, and touches the object in points.

    Attributes:
        arm: name of the arm.
        grasp: the grasp; the plane of its frame is the surface on which it slides.
    """

    arm: str
    grasp: Grasp

    @property
    def points(self) -> Array:
        """The points of contact in tip axes, from the tip's origin, (points, 3) [m]."""
        if self.grasp.of_kind.size == "half_length":
            half, _ = self.grasp.contact_size
            return np.array([[-half, 0.0, 0.0], [half, 0.0, 0.0]])
        return np.zeros((1, 3))

    @property
    def torsion_radius(self) -> float:
        """The torsion radius of a soft finger, 0 for other hands [m]."""
        assert self.grasp.contact is not None
        return self.grasp.contact.torsion_radius or 0.0

    @property
    def names(self) -> list[str]:
        """A name of every point."""
        count = len(self.points)
        return [self.arm] if count == 1 else [f"{self.arm}/{k}" for k in range(count)]


def may_slide(grasp: Grasp) -> bool:
    """Return whether a grasp holds by friction at a point, along an edge or in a small patch, so that it can slide."""
    return grasp.contact is not None and grasp.of_kind.size in SLIDING_SIZES


def point_owners(hands: Sequence[Hand]) -> list[int]:
    """Return for every point of all hands the index of its hand."""
    return [i for i, hand in enumerate(hands) for _ in hand.points]


def names_of(chain: ClosedChain, hands: Sequence[Hand]) -> list[str]:
    """Return the names of the world's contacts, and of the points of hands."""
    world = () if chain.touching is None else chain.touching.names
    return [*world, *(name for hand in hands for name in hand.names)]


def touching_rows(chain: ClosedChain, state: State, hands: Sequence[Hand] = ()) -> ContactRows:
    """Return the rows of the world's contacts and of hands' points, by the stacked velocities. O(n) + O(k).

    With a soft finger among the hands, every contact has a fourth row, which is 0 for points.
    """
    if not hands:
        assert chain.touching is not None
        return contact_rows(chain.touching, state.object_frame, state.object_twist)
    motion = _moving(chain, state)
    d = 4 if any(hand.torsion_radius for hand in hands) else 3
    m = 6 + 6 * len(hands)
    found = [] if chain.touching is None else _of_world(chain, state, d, m)
    for i, hand in enumerate(hands):
        found += _of_hand(motion, state, hand, d, m, 6 + 6 * i)
    return ContactRows(*(np.array(x) for x in zip(*found, strict=True)))


def _of_world(chain: ClosedChain, state: State, d: int, m: int) -> list[tuple[Array, ...]]:
    """Return the fields of every contact with the world, with rows and columns of zeros added."""
    found = []
    for one in zip(*touching_rows(chain, state), strict=True):
        gap, rows, drift, carried, *rest = one
        C = np.zeros((d, m))
        C[:3, :6] = rows
        found.append((gap, C, np.resize(np.append(drift, 0.0), d), np.resize(np.append(carried, 0.0), d), *rest))
    return found


def _of_hand(motion: ChainMotion, state: State, hand: Hand, d: int, m: int, start: int) -> list[tuple[Array, ...]]:
    """Return the fields of the points of a hand, whose columns begin at `start`."""
    arm, frame, twist = motion.arms[hand.arm], state.object_frame, state.object_twist
    w, v, w_tip, v_tip = twist[:3], twist[3:], arm.tip_twist[:3], arm.tip_twist[3:]
    axes = (frame.R @ hand.grasp.frame.R).T
    n, e = axes[2], hand.torsion_radius
    origin = frame.p + frame.R @ hand.grasp.frame.p
    assert hand.grasp.contact is not None
    found = []
    for point in hand.points:
        r = arm.at.tip.R @ point
        place = arm.at.tip.p + r
        l = place - frame.p
        C, drift = np.zeros((d, m)), np.zeros(d)
        for k, t in enumerate(axes):
            C[k, :6] = np.concatenate([np.cross(l, t), t])
            C[k, start : start + 6] = -np.concatenate([np.cross(r, t), t])
        u = v + np.cross(w, l) - v_tip - np.cross(w_tip, r)
        inward = np.cross(w, np.cross(w, l)) - 2.0 * np.cross(w, u) - np.cross(w_tip, np.cross(w_tip, r))
        drift[:3] = axes @ inward
        if e:
            C[3, :3], C[3, start : start + 3] = e * n, -e * n
            drift[3] = e * (n @ np.cross(w, w_tip))
        found.append((n @ (origin - place), C, drift, np.zeros(d), l, axes, hand.grasp.contact.mu, 0.0))
    return found


def _moving(chain: ClosedChain, state: State) -> ChainMotion:
    """Return the motion of a chain with standing bases, without torques."""
    return chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))


def stacked_twist(chain: ClosedChain, state: State, hands: Sequence[Hand]) -> Array:
    """Return the twists of the object about C and of the hands' tips, (6 + 6 hands,) world axes."""
    if not hands:
        return state.object_twist
    motion = _moving(chain, state)
    return np.concatenate([state.object_twist, *(motion.arms[hand.arm].tip_twist for hand in hands)])


def stacked_acceleration(chain: ClosedChain, state: State, hands: Sequence[Hand], found: ForwardResult) -> Array:
    """Return the accelerations of the object and of the hands' tips with those of a result, (6 + 6 hands,)."""
    parts = [found.object_acceleration]
    motion = _moving(chain, state) if hands else None
    for hand in hands:
        assert motion is not None
        arm = motion.arms[hand.arm]
        drift = arm.bias.tip_acceleration + pseudo_gravity(chain)
        parts.append(jacobian(arm.arm, arm.at) @ found.qdd[chain.joints[hand.arm]] + drift)
    return np.concatenate(parts)


def stacked_mobility(still: ChainMotion, hands: Sequence[Hand]) -> Array:
    """Return diag(P, Lambda_1, ..) of a chain at rest, (6 + 6 hands, 6 + 6 hands)."""
    P = np.zeros((6 + 6 * len(hands),) * 2)
    P[:6, :6] = rest_response(still).mobility
    for i, hand in enumerate(hands):
        own = tip_response(at_rest(still.arms[hand.arm]), "auto").mobility
        P[6 + 6 * i : 12 + 6 * i, 6 + 6 * i : 12 + 6 * i] = own.dense()
    return P


class StackedResponse(NamedTuple):
    """The response of a chain at rest to impulses on the object and on the tips of sliding hands.

    Attributes:
        change: of all velocities.
        found: the solution with the impulses of the grasps.
        bases: (6,) impulse of the base on the arm of every hand, about its base origin.
    """

    change: Change
    found: Solution
    bases: list[Array]


def stacked_response(still: ChainMotion, state: State, hands: Sequence[Hand], wrench: Array) -> StackedResponse:
    """Return the response to impulses on the object about C and on the hands' tips, (6 + 6 hands,)."""
    change, found = impulse_response(still, state, wrench[:6])
    qd, bases = np.array(change.qd), []
    for i, hand in enumerate(hands):
        tip = tip_response(at_rest(still.arms[hand.arm]), "auto")
        own, base = tip.back_substitute(-wrench[6 + 6 * i : 12 + 6 * i])
        qd[still.chain.joints[hand.arm]] += own
        bases.append(base)
    return StackedResponse(change._replace(qd=qd), found, bases)


def with_contact_wrench(
    chain: ClosedChain, state: State, inputs: Inputs, hands: Sequence[Hand], wrench: Array
) -> Inputs:
    """Return inputs with further wrenches, stacked: on the object about C, and on the last links of sliding hands."""
    given = inputs.object_wrench
    on_object = wrench[:6] if given is None else given + wrench[:6]
    if not hands:
        return changed(inputs, object_wrench=on_object)
    first = chain.joint_count - sum(arm.joint_count for arm in chain.arms.values())
    links = inputs.link_wrenches
    links = np.zeros((chain.joint_count - first, 6)) if links is None else np.array(links)
    motion = _moving(chain, state)
    for i, hand in enumerate(hands):
        arm = motion.arms[hand.arm]
        if arm.arm.joints:  # an anchor passes the wrench on to its base
            last = chain.joints[hand.arm].stop - first - 1
            links[last] += shift_wrench(arm.at.end @ arm.arm.tip.p, wrench[6 + 6 * i : 12 + 6 * i])
    return changed(inputs, object_wrench=on_object, link_wrenches=links)


def wrenches_of_hands(chain: ClosedChain, hands: Sequence[Hand], wrench: Array) -> Array:
    """Return the wrenches of sliding hands on the object about the tips' origins, (arms, 6); 0 for other arms."""
    found = np.zeros((len(chain.arms), 6))
    for i, hand in enumerate(hands):
        found[chain.names.index(hand.arm)] = -wrench[6 + 6 * i : 12 + 6 * i]
    return found


def without_hands(chain: ClosedChain, arms: Iterable[str]) -> ClosedChain:
    """Return the chain without the grasps of some arms."""
    out = set(arms)
    return changed(chain, grasps={name: grasp for name, grasp in chain.grasps.items() if name not in out})


def regripped(chain: ClosedChain, state: State, hands: Iterable[Hand], keep: Mapping[str, Grasp]) -> dict[str, Grasp]:
    """Return the grasps of hands that hold again: those in `keep` as they were, others where their tips are now."""
    motion = _moving(chain, state)
    return {
        hand.arm: keep.get(hand.arm)
        or grasp_here(hand.grasp, state.object_frame, motion.arms[hand.arm].at.tip, hand.arm)
        for hand in hands
    }
