"""How far one grasp is from being closed, and how far a state may be."""

from __future__ import annotations

from holdfast.dynamics.closed.contact import Contact
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate

POSITION_TOLERANCE = 1e-6  # m and rad
VELOCITY_TOLERANCE = 1e-6  # relative to max(1, |qd|)


def tip_from_contact(c: Contact, contact_point: Array, tip: Pose) -> Pose:
    """Return the pose of the tip frame in the contact frame, which is the identity for a closed rigid grasp.

    If the grasp has a motion subspace of the user's own, the position is along the tip's axes, because the tip
    carries that subspace.

    Args:
        c: the grasp in motion.
        contact_point: (3,) contact point on the object in the world, world axes [m].
        tip: pose of the arm's tip frame in the world.
    """
    axes = c.R if c.grasp.of_kind.given is None else c.frame
    return Pose.unchecked(axes.T @ tip.R, (tip.p - contact_point) @ c.R)


def position_gap(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return the displacement [rotation vector; translation] that would close the grasp, (6,) world axes [rad, m].

    The rotation takes the tip frame to the contact frame for a rigid grasp. It is the smallest one between the
    x axes for a hinge, and zero for grasps that leave the attitude free.

    Args:
        c: the grasp in motion.
        contact_point: (3,) contact point on the object in the world, world axes [m].
        tip: pose of the arm's tip frame in the world.
    """
    seen = tip_from_contact(c, contact_point, tip)
    return rotate(c.R, c.grasp.of_kind.gap(seen.R, seen.p))


def position_residual(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return the residuals of one grasp's position rows along contact axes: angles [rad], then lengths [m]."""
    kind, seen = c.grasp.of_kind, tip_from_contact(c, contact_point, tip)
    return kind.along(kind.gap(seen.R, seen.p))[list(kind.position_rows)]
