"""Forces and impulses of the world on the object of a chain, found in the chain's mobility at the object.

A contact is closed if its gap is at most `CLOSED` and it does not separate. Forces belong to accelerations: a closed
contact must not approach (that takes an impulse, `touch`). One whose point moves along the surface slides, with a
friction of known direction; one at rest may start to move in any.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, pseudo_gravity
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.object_motion import object_motion
from holdfast.dynamics.closed.sequential import sequential, tips_of
from holdfast.dynamics.closed.tip_response import TipResponse, responded
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.solve_contacts import solve_contacts
from holdfast.dynamics.contact.solved_contacts import ContactSolution, ContactStatus
from holdfast.dynamics.projection import Change
from holdfast.dynamics.tree.of_chain import ChainLoads, object_response, solved_again
from holdfast.errors import ContactError, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.world.touching import Touching
from holdfast.spatial.scalar import Array, array, each
from holdfast.state import State

CLOSED = 1e-9  # m: a smaller gap is closed
LEAST_SLIP = 1e-9  # m/s, or relative to a larger twist of the object: a slower contact is at rest


class TouchingForces(NamedTuple):
    """The contacts of a chain's object, with the forces of the world on it.

    Attributes:
        rows: all candidates.
        closed: (k,) which of them are closed.
        solution: forces of the closed ones; accelerations are changes of the object's.
        slide: (closed, 2) unit directions in which contacts slide, 0 for those at rest.
    """

    rows: ContactRows
    closed: Array
    solution: ContactSolution
    slide: Array

    @property
    def force(self) -> Array:
        """The forces of all candidates on the object, (k, 3) world axes."""
        found = np.zeros((len(self.closed), 3))
        found[self.closed] = self.solution.force
        return self.rows.in_world(found)

    @property
    def mode(self) -> Array:
        """Numbers of `ContactMode` of all candidates, (k,)."""
        found = np.zeros(len(self.closed), int)
        found[self.closed] = self.solution.mode
        return found

    def of_result(self, alpha: Array) -> dict[str, Any]:
        """Return the fields of `ForwardResult`, for an object acceleration alpha (6,) with the forces."""
        found = self.solution
        span = None if found.range is None else found.range + (alpha - found.change)
        return {
            "touch_force": self.force,
            "touch_gap": self.rows.gap,
            "touch_mode": self.mode,
            "touch_status": found.status,
            "touch_residual": found.residual,
            "touch_range": span,
        }


def touching_forces(motion: ChainMotion, state: State, free: Solution) -> TouchingForces:
    """Return the forces of the world on the object. O(l) + O(k).

    Args:
        motion: the chain's motion; the chain has `touching`.
        state: its state.
        free: its solution by `sequential` without forces of the world.

    Raises:
        StateError: a closed contact approaches.
    """
    touching = motion.chain.touching
    assert touching is not None
    rows, closed, slides = closed_contacts(touching, state)
    slide = slides[closed]
    P = _mobility(motion, free) if closed.any() else np.zeros((6, 6))
    alpha = free.object_acceleration + pseudo_gravity(motion.chain)
    b = rows.C[closed] @ alpha + rows.drift[closed]
    return TouchingForces(rows, closed, solve_contacts(P, rows.C[closed], b, rows.friction[closed], slide=slide), slide)


def closed_contacts(touching: Touching, state: State) -> tuple[ContactRows, Array, Array]:
    """Return all candidates, which of them are closed and do not leave (k,), and the directions of slip (k, 2). O(k).

    The directions are unit vectors [t1, t2], 0 for contacts that are at rest or open.

    Raises:
        StateError: a closed contact approaches.
    """
    twist = state.object_twist
    rows = contact_rows(touching, state.object_frame, twist)
    require_no_approach(touching, rows, twist)
    u, least = rows.velocity(twist), _least_slip(twist)
    closed = (rows.gap <= CLOSED) & (u[:, 2] <= least)
    speed = np.linalg.norm(u[:, :2], axis=1)
    moves = closed & (speed > least)
    return rows, closed, np.where(moves, u[:, :2].T / np.where(moves, speed, 1.0), 0.0).T


def require_no_approach(touching: Touching, rows: ContactRows, twist: Array) -> None:
    """Refuse closed contacts that approach.

    Raises:
        StateError: naming the fastest.
    """
    approach = np.where(rows.gap <= CLOSED, rows.velocity(twist)[:, 2], np.inf)
    fastest = int(np.argmin(approach))
    if approach[fastest] < -_least_slip(twist):
        raise StateError(
            f"contact '{touching.names[fastest]}' is closed and approaches with {-approach[fastest]:.3g} m/s, expected"
            " a state at rest or sliding there; try holdfast.touch, which returns the state after the impact"
        )


def require_outside(chain: ClosedChain, state: State) -> None:
    """Refuse a state in which a point of the object is inside a shape, or one of the world inside the object's.

    Raises:
        StateError: naming the deepest.
    """
    touching = chain.touching
    if touching is None or not touching.candidates:
        return
    rows = contact_rows(touching, state.object_frame, state.object_twist)
    j = int(np.argmin(rows.gap))
    if rows.gap[j] >= -CLOSED:
        return
    one, normal = touching.candidates[j], rows.axes[j][2]
    of_shape, shape = touching.names[j].rsplit("/", 1)
    others = int((rows.gap < -CLOSED).sum()) - 1
    raise StateError(
        f"simulation: state: '{of_shape}' is {-rows.gap[j]:.6g} m inside of '{shape}' ({type(one.shape).__name__}; gap"
        f" {rows.gap[j]:.6g} m)"
        + f", and {others} more contacts penetrate"
        * (others > 0)
        + ", expected gaps >= 0 at the"
        f" start; try to move the object by {-rows.gap[j]:.6g} m along ({', '.join(f'{x:.4g}' for x in normal)}), check"
        " the side to which the shape's normal points and `inside=`, or list the `pairs` that may touch"
    )


def _least_slip(twist: Array) -> float:
    return LEAST_SLIP * max(1.0, float(np.abs(twist).max()))


def _mobility(motion: ChainMotion, free: Solution) -> Array:
    """Return the object's mobility, from the tip responses of a solution if it has those of all arms."""
    names = [*motion.chain.grasps, *motion.lone_on_trunk]
    known = len(names) == len(free.tips)
    return chain_mobility(motion, dict(zip(motion.chain.grasps, free.tips, strict=True)) if known else tips_of(motion))


def chain_mobility(motion: ChainMotion, tips: Mapping[str, TipResponse]) -> Array:
    """Return the object's mobility in the chain, (6, 6), from the arms' tip responses; see `object_mobility`."""
    return np.array(object_response(motion.chain, motion.contacts, tips, motion.body.free, motion.trunk).mobility)


def mobility_found(motion: ChainMotion, free: Solution, tips: Mapping[str, TipResponse]) -> Array:
    """Return `chain_mobility` by the factors of a solution, six right-hand sides, if it has those of all bodies."""
    if free.factors is None:
        return chain_mobility(motion, tips)
    still, trunk = [np.zeros(6)] * len(free.wrenches), motion.trunk.at_rest()
    return array(
        each(
            lambda unit: solved_again(free.factors, ChainLoads(still, unit, trunk)).object_acceleration, list(np.eye(6))
        )
    )


def with_push(pushed_motion: ChainMotion, free: Solution, tips: Mapping[str, TipResponse], wrench: Array) -> Solution:
    """Return a solution by `sequential` with one more wrench on the object. O(n) + O(l).

    Args:
        pushed_motion: the motion with it, see `pushed`.
        free: the solution without it.
        tips: the tip responses of all arms on which the solution depends.
        wrench: (6,) about C, world axes.
    """
    if free.factors is None:
        return sequential(pushed_motion, tips=tips)
    trunk, still = pushed_motion.trunk, [np.zeros(6)] * len(free.wrenches)
    more = solved_again(free.factors, ChainLoads(still, wrench, trunk.at_rest()))
    wrenches = each(lambda f, own: f + own, free.wrenches, more.wrenches)
    moved = free.trunk.plus(more.trunk)
    betas = trunk.accelerations(moved)
    columns = [trunk.of_columns(name, moved, betas) for name in pushed_motion.chain.grasps]
    responses = each(responded, free.tips, wrenches, columns)
    return replace(
        free,
        qdd=[qdd for qdd, _ in responses],
        wrenches=wrenches,
        object_acceleration=free.object_acceleration + more.object_acceleration,
        base_wrenches=[base for _, base in responses],
        trunk=moved,
    )


def pushed(motion: ChainMotion, state: State, wrench: Array) -> ChainMotion:
    """Return the motion with one more wrench (6,) on the object about C, world axes."""
    total = motion.body.wrench + wrench
    body = object_motion(motion.chain.held_object, state.object_frame, state.object_twist, total)
    case = None if motion.object_case is None else motion.object_case._replace(wrench=total)
    return replace(motion, body=body, object_case=case)


class PushResponse(NamedTuple):
    """How a chain at rest gives way to wrenches on its object, by one factorisation for all of them.

    Attributes:
        motion: the chain at rest.
        state: its positions, at rest.
        free: the solution by `sequential` without any wrench.
        tips: the tip responses of the arms.
    """

    motion: ChainMotion
    state: State
    free: Solution
    tips: Mapping[str, TipResponse]

    @property
    def mobility(self) -> Array:
        """The object's mobility P in the chain, (6, 6), about C, world axes."""
        return mobility_found(self.motion, self.free, self.tips)

    def change(self, wrench: Array) -> Change:
        """Return the change of all velocities by an impulse (6,) on the object about C, world axes."""
        loaded = pushed(self.motion, self.state, wrench)
        found = with_push(loaded, self.free, self.tips, wrench)
        whole = chain_solution(loaded, found, "auto")
        return Change(whole.qdd, found.object_acceleration, whole.base_acceleration)


def push_response(still: ChainMotion, state: State) -> PushResponse:
    """Return the response of a chain at rest. O(n) + O(l).

    Args:
        still: the chain at rest, with the rows that its grasps impose.
        state: its positions.
    """
    tips = tips_of(still)
    return PushResponse(still, state.at_rest(), sequential(still, tips=tips), tips)


def require_resolved(found: ContactSolution, names: tuple[str, ...]) -> None:
    """Refuse a contact problem that has no solution, or to which none was found.

    Raises:
        ContactError: with the status.
    """
    at = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    if found.status is ContactStatus.JAMMED:
        raise ContactError(
            f"no contact forces satisfy Coulomb's law at {at}: the chain jams (Painleve), and an impulse without a"
            " collision follows; try a smaller friction, or another direction of motion",
            found.status.name,
        )
    if found.status is ContactStatus.UNRESOLVED:
        raise ContactError(
            f"no contact forces were found at {at} that satisfy Coulomb's law to 1e-9 of the accelerations: the best"
            f" ones violate it by {found.residual:.1e}; try fewer or less opposed contacts, or a smaller friction",
            found.status.name,
        )
