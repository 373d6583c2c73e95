"""The rotation of a joint whose position carries derivatives.

    d(E x) = E (dx + dq h x x),    d(E^T x) = E^T dx + dq (E^T x) x h

with the joint's axis h. Entry by entry of E they would take several times the operations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from holdfast.dynamics.arm.forward_kinematics import joint_rotation
from holdfast.model.joint import Joint
from holdfast.spatial.differentiation import Recorded, by_rule_below
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.spatial.vector import cross


def rotation_of(joint: Joint, q: Scalar) -> Any:
    """Return the rotation from link axes to parent axes, (3, 3) or what multiplies vectors like it."""
    turns = isinstance(q, Recorded) and joint.motion_subspace[0] is not None
    return Turning(joint, q) if turns else joint_rotation(joint, q)


class Turning:
    """The rotation E of a joint whose position carries derivatives; `E @ x` and `x @ E` are its products with (3,) x.

    Attributes:
        joint: the joint.
        q: its position.
    """

    __array_ufunc__ = None  # so that NumPy leaves `x @ E` to `__rmatmul__`

    def __init__(self, joint: Joint, q: Recorded) -> None:
        self.joint, self.q = joint, q
        self._below = rotation_of(joint, q.value)

    def __matmul__(self, x: Array) -> Array:
        """Return E x."""

        def turned(q: Any, x: Array) -> tuple[list[Array], ProductRule]:
            E = self._at(q)
            return [E @ x], ProductRule(E, self.joint.axis, x)

        return by_rule_below(turned, self.q, x)[0]

    def __rmatmul__(self, x: Array) -> Array:
        """Return E^T x."""

        def turned(q: Any, x: Array) -> tuple[list[Array], TransposedRule]:
            E = self._at(q)
            y = x @ E
            return [y], TransposedRule(E, self.joint.axis, y)

        return by_rule_below(turned, self.q, x)[0]

    def _at(self, q: Any) -> Any:
        """Return the rotation at q, which is this one's or has one derivative less."""
        return self if q[()] is self.q else self._below


class ProductRule(NamedTuple):
    """The derivatives of E x by q and x.

    Attributes:
        E: the rotation.
        h: (3,) the axis, link axes.
        x: (3,) the vector.
    """

    E: Any
    h: Array
    x: Array

    def rates(self, *rates: Any) -> list[Array]:
        """Return the rate of the product."""
        of_q, of_x = rates
        return [self.E @ (of_x + of_q[()] * cross(self.h, self.x))]

    def gradient(self, *cotangents: Any) -> list[Array]:
        """Return the gradients by q and x."""
        (bar,) = cotangents
        by_x = bar @ self.E
        return [array(self.h @ cross(self.x, by_x)), by_x]


class TransposedRule(NamedTuple):
    """The derivatives of y = E^T x by q and x.

    Attributes:
        E: the rotation.
        h: (3,) the axis, link axes.
        y: (3,) the product.
    """

    E: Any
    h: Array
    y: Array

    def rates(self, *rates: Any) -> list[Array]:
        """Return the rate of the product."""
        of_q, of_x = rates
        return [of_x @ self.E + of_q[()] * cross(self.y, self.h)]

    def gradient(self, *cotangents: Any) -> list[Array]:
        """Return the gradients by q and x."""
        (bar,) = cotangents
        return [array(self.h @ cross(bar, self.y)), self.E @ bar]
