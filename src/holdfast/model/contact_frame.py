"""The contact frame at a point of the object."""

from __future__ import annotations

from numpy.typing import ArrayLike

from holdfast.spatial.pose import Pose


def contact_frame(point: ArrayLike, into: ArrayLike, x: ArrayLike | None = None) -> Pose:
    """Return the contact frame at a point of the object, with its z axis along the normal into the object.

    The tip frame of a rigid grasp coincides with this frame; a hinge rotates about its x axis.

    Args:
        point: (3,) the contact point from C, object axes [m].
        into: (3,) the normal INTO the object, object axes, of any length.
        x: (3,) direction to which the x axis is as close as possible. By default, x and y are the axes of a camera that
            looks along `into`, with x to the right and y downwards (the object's -z); if `into` is parallel to the
            object's z axis, x is the object's x axis.

    Raises:
        ModelError: a direction has zero length, or `x` is parallel to `into`.
    """
    return Pose.looking(point, z=into, x=x)
