"""The contact frame at a point of the object."""

from __future__ import annotations

from numpy.typing import ArrayLike

from holdfast.spatial.pose import Pose


def contact_frame(point: ArrayLike, into: ArrayLike, x: ArrayLike | None = None) -> Pose:
    """Return the contact frame at a point of the object, its z axis along the normal into the object.

    A rigid grasp's tip frame comes to lie in it; a hinge turns about its x axis.

    Args:
        point: (3,) the contact point, object axes from C [m].
        into: (3,) the normal INTO the object, object axes, of any length.
        x: (3,) the direction that x is as near to as it can be. By default x and y are a camera's that
            looks along `into`: to the right, and down, the object's -z; the object's x where `into` is along its z.

    Raises:
        ModelError: a direction of length zero, or an `x` along `into`.
    """
    return Pose.looking(point, z=into, x=x)
