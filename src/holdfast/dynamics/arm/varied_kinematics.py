"""Forward kinematics of an arm whose joint positions or base carry derivatives.

The derivatives are those of rotating bodies instead of those of matrix entries, which takes a fraction of the
operations: a joint turns what lies beyond it about its axis h, and moves the tip by h x reach. Its rotation E obeys
    d(E x) = E (dx + dq h x x),    d(E^T x) = E^T dx + dq (E^T x) x h
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics, joint_rotation, joint_translation
from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.spatial.differentiation import Recorded, by_rule_below, is_recorded
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.spatial.vector import axial, cross, outer, skew


def varied_kinematics(arm: Arm, q: Array) -> Kinematics:
    """Return `forward_kinematics` of an arm with the derivatives of its poses by q and by the base's pose. O(N)."""
    base = arm.base
    if not arm.joints or not (is_recorded(q) or is_recorded(base.R)):
        return forward_kinematics(arm, q)

    def placed(q: Array, R: Array) -> tuple[tuple[Array, ...], FrameRule]:
        at = varied_kinematics(arm.standing_at(Pose.unchecked(R, np.zeros(3))), q)
        return (array(at.R), array(at.reach), at.from_base), FrameRule(arm, R, at)

    R, reach, r = by_rule_below(placed, q, base.R)
    tip = Pose.unchecked(R[-1] @ arm.tip.R, base.p + r)
    E = tuple([rotation_of(joint, qk) for joint, qk in zip(arm.joints, q, strict=True)])
    l = tuple([joint_translation(joint, qk) for joint, qk in zip(arm.joints, q, strict=True)])
    return Kinematics(E, l, tuple(R), tuple(reach), tip, R[-1], r)


class FrameRule(NamedTuple):
    """The derivatives of (R, reach, from_base) by joint positions and the base's rotation.

    Attributes:
        arm: the arm.
        base: (3, 3) from base axes to world axes.
        at: its configuration.
    """

    arm: Arm
    base: Array
    at: Kinematics

    def axes(self) -> list[tuple[Array, Array]]:
        """Return the turn and the shift of every joint per unit of q, (3,) each in world axes; zero for none."""
        none, found = np.zeros(3), []
        for joint, R in zip(self.arm.joints, self.at.R, strict=True):
            h, s = joint.motion_subspace
            found.append((none if h is None else R @ h, none if s is None else R @ s))
        return found

    def rates(self, *rates: Any) -> list[Array]:
        """Return the rates of the results."""
        of_q, of_base = rates
        at, B = self.at, of_base @ self.base.T
        axes = self.axes()
        beyond = [cross(h, reach) + s for (h, s), reach in zip(axes, at.reach, strict=True)]
        turns, w = [], np.zeros(3)
        for (h, _), rate in zip(axes, of_q, strict=True):
            w = w + rate * h
            turns.append(w)
        reach, v = [], np.zeros(3)
        for moved, w, r, rate in reversed(list(zip(beyond, turns, at.reach, of_q, strict=True))):
            reach.insert(0, cross(w, r) + v + B @ r)
            v = v + rate * moved
        R = [(skew(w) + B) @ of_link for w, of_link in zip(turns, at.R, strict=True)]
        return [array(R), array(reach), v + B @ at.from_base]

    def gradient(self, *cotangents: Any) -> list[Array]:
        """Return the gradient of sum(cotangent . result) by q and by the base's rotation."""
        of_R, of_reach, of_r = cotangents
        at, total = self.at, np.zeros((3, 3))
        of_tip, before = [], of_r  # the cotangent of the displacement of the tip, by joint
        for x in of_reach:
            of_tip.append(before)
            before = before + x
        by_q: list[Scalar] = []
        torque = np.zeros(3)
        links = zip(self.axes(), at.R, of_R, at.reach, of_reach, of_tip, strict=True)
        for (h, s), R, bar, reach, of_own, f in reversed(list(links)):
            B = bar @ R.T
            total = total + B + outer(of_own, reach)
            torque = torque + axial(B) + cross(reach, of_own)
            by_q.insert(0, h @ (torque + cross(reach, f)) + s @ f)
        return [array(by_q), (total + outer(of_r, at.from_base)) @ self.base]


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
