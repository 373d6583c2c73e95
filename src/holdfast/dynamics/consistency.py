"""Does a state satisfy its grasps? Position and velocity residuals, grasp by grasp.

Closed means: rigid: tip frame = contact frame; hinge: origins and x axes agree; soft
finger and ball: origins agree. Rows, position / velocity: rigid 6/6, hinge 5/5, soft
finger 3/4 (its no-spin condition does not integrate), ball 3/3. Others: docs/theory/contacts.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.arm.velocity import link_twists, tip_twist
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.trunk.trunk_motion import standing
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate
from holdfast.state import Inputs, State

POSITION_TOLERANCE = 1e-6  # m and rad
VELOCITY_TOLERANCE = 1e-6  # relative to max(1, |qd|)
RATE_TOLERANCE = 1e-8  # rad/s, relative to max(1, |W|)


class GraspResidual(NamedTuple):
    """How far one grasp is from holding.

    Attributes:
        position: position rows, contact axes: angles [rad] first, then lengths [m].
        velocity: (6 - n_g,) velocity rows K (A V(C) - V+) [rad/s, m/s].
    """

    position: Array
    velocity: Array


def tip_from_contact(c: Contact, contact_point: Array, tip: Pose) -> Pose:
    """Return the tip frame seen from the contact frame: the identity where a rigid grasp holds.

    A motion given by hand has its place in the tip's axes, since these carry it.

    Args:
        c: the grasp in motion.
        contact_point: (3,) on the object, world axes.
        tip: the arm's tip frame in the world.
    """
    axes = c.R if c.grasp.of_kind.given is None else c.frame
    return Pose.unchecked(axes.T @ tip.R, (tip.p - contact_point) @ c.R)


def position_gap(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return [turn; shift] that would bring the tip to the contact, (6,) world axes.

    The turn is the rotation vector from tip frame to contact frame for a rigid grasp, the
    shortest one between the x axes for a hinge, and 0 where attitudes are free.

    Args:
        c: the grasp in motion.
        contact_point: (3,) on the object, world axes.
        tip: the arm's tip frame in the world.
    """
    seen = tip_from_contact(c, contact_point, tip)
    return rotate(c.R, c.grasp.of_kind.gap(seen.R, seen.p))


def position_residual(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return the position rows of one grasp, contact axes: angles [rad], then lengths [m]."""
    kind, seen = c.grasp.of_kind, tip_from_contact(c, contact_point, tip)
    return kind.along(kind.gap(seen.R, seen.p))[list(kind.position_rows)]


def residuals(motion: ChainMotion, state: State) -> dict[str, GraspResidual]:
    """Return position and velocity residuals of every grasp, by arm name."""
    origin = state.object_frame.p
    return {
        name: GraspResidual(position_residual(c, origin + c.origin, motion.arms[name].at.tip), c.velocity_gap)
        for name, c in zip(motion.chain.grasps, motion.contacts, strict=True)
    }


def closure(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> dict[str, GraspResidual]:
    """Return how far each grasp is from holding, by arm name. O(n) + O(l).

    Args:
        chain: the chain.
        state: any state, consistent or not.
        inputs: base motion, if the bases move.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain.
    """
    state.fits(chain)
    return residuals_at(chain, state, (inputs or Inputs()).shaped(chain))


def residuals_at(chain: ClosedChain, state: State, inputs: Inputs) -> dict[str, GraspResidual]:
    """Return position and velocity residuals of every grasp, inputs shaped, on varied numbers too; see `closure`."""
    stand, frame, found = standing(chain, state, inputs), state.object_frame, {}
    for name, grasp in chain.grasps.items():
        row, part = chain.names.index(name), chain.joints[name]
        arm, base_twist = stand.arms[row], stand.base_twists[row]
        at = posture(arm, state.q[part])
        moving = tip_twist(arm, at, link_twists(arm, at, state.qd[part], base_twist), base_twist)
        c = contact(grasp, frame, state.object_twist, at.tip, moving)
        found[name] = GraspResidual(position_residual(c, frame.p + c.origin, at.tip), c.velocity_gap)
    return found


def require_closed(
    motion: ChainMotion,
    state: State,
    position_tolerance: float = POSITION_TOLERANCE,
    velocity_tolerance: float = VELOCITY_TOLERANCE,
) -> None:
    """Refuse a state that breaks a grasp.

    Raises:
        StateError: naming the gap of every grasp that is open.
    """
    limit = velocity_tolerance * max(1.0, float(np.linalg.norm(state.qd)))
    open_grasps = []
    for name, gap in residuals(motion, state).items():
        x, v = (float(np.abs(part).max(initial=0.0)) for part in gap)  # bushings have no gaps
        if not (x <= position_tolerance and v <= limit):
            open_grasps.append(f"arm '{name}': position gap {x:.3g} (m, rad), velocity gap {v:.3g} (m/s, rad/s)")
    if open_grasps:
        raise StateError(
            f"the state does not satisfy the grasps: {'; '.join(open_grasps)}. Expected <= {position_tolerance:g} and"
            f" <= {limit:.3g}; try holdfast.close(chain, state)"
        )


def require_rates(motion: ChainMotion, rates: Array, tolerance: float = RATE_TOLERANCE) -> None:
    """Refuse given relative rates W that are not those the velocities imply.

    Raises:
        StateError: naming the gap of every grasp.
    """
    gaps = []
    for (name, part), c in zip(motion.chain.contact_freedoms.items(), motion.contacts, strict=True):
        gap = float(np.abs(rates[part] - c.W).max(initial=0.0))
        if not gap <= tolerance * max(1.0, float(np.abs(c.W).max(initial=0.0))):
            gaps.append(f"arm '{name}': gap {gap:.3g} rad/s")
    if gaps:
        raise StateError(
            f"W is not what the velocities imply, omega_object - omega_tip = h W: {'; '.join(gaps)}. Expected <="
            f" {tolerance:g}; try leaving W out"
        )
