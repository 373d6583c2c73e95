"""Impedance of the object: a spring and a damper between the object and its path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from holdfast.compiler.program import Shape
from holdfast.control.controller import known_breakpoints
from holdfast.control.gains import gain_matrix
from holdfast.control.law_parts import CommandedMotion, LawInput
from holdfast.control.paths import ObjectPath, Target, path_function, pose_error
from holdfast.dynamics.closed.sequential import rest_response
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, REQUIRED, ArrayField, OptionalArrayField
from holdfast.spatial.scalar import Array


@called
@dataclass(frozen=True, eq=False)
class ObjectImpedance(CommandedMotion):
    """Mass, damper and spring between object and path, M_d (alpha - alpha_d) + D (V - V_d) = K e + w_d + w.

    e = [log(R_d R^T); p_d - p] is the pose error, w_d a wished push, and w the external wrench on the object. Commanded
    is alpha = alpha_d + M_d^-1 (D (V_d - V) + K e + w_d + w). Without `inertia`, M_d is the inertia that the closed
    chain has at C, and w acts by itself: nothing is measured. With `inertia`, the law has the parameter
    `external_wrench`, (6,) world axes about C, from a sensor or from `observed`. With constant M_d, the power of w is
    that of D plus the change of 1/2 V_e^T M_d V_e + 1/2 e^T K e, if the rotational stiffness is the same about all
    axes and there is no push.

    With no stiffness along the normal of a wall and a push along it, this is hybrid position / force control: at rest
    the wall bears exactly the push. Until there, the object approaches with the push over its damping.

    Attributes:
        path: function of t [s] that returns the target, or a path object, whose method `at` is used.
        stiffness: K, (6, 6), its diagonal (6,), or one number for all [N m/rad, N/m].
        damping: D, likewise [N m s/rad, N s/m].
        inertia: M_d, likewise [kg m^2, kg]; None for the inertia of the closed chain.
        push: w_d, (6,) constant wrench with which the object presses on what it meets, world axes about C [N m, N].

    Raises:
        ModelError: a matrix is not symmetric or not positive (semi)definite, or the path is none.

    Reference:
        Schneider and Cannon, Object impedance control for cooperative manipulation, T-RA 1992; Raibert and Craig,
        Hybrid position/force control of manipulators, 1981.
    """

    path: Callable[[float], Target] | ObjectPath
    stiffness: ArrayField = REQUIRED
    damping: ArrayField = REQUIRED
    inertia: OptionalArrayField = NOT_GIVEN
    push: OptionalArrayField = NOT_GIVEN

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "path", path_function(self.path, "object impedance: path"))
        put(self, "stiffness", gain_matrix(self.stiffness, "object impedance: stiffness"))
        put(self, "damping", gain_matrix(self.damping, "object impedance: damping"))
        if self.inertia is not None:
            put(self, "inertia", gain_matrix(self.inertia, "object impedance: inertia", definite=True))
        if self.push is not None:
            put(self, "push", checks.numbers(self.push, (6,), "object impedance: push"))

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its path accelerates by leaps [s], as far as they are known in advance."""
        return known_breakpoints(self.path)

    def parameters(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shape of the external wrench if it must be known."""
        return {} if self.inertia is None else {"external_wrench": (6,)}

    def acceleration(self, x: LawInput) -> Array:
        """Return the commanded acceleration of C, (6,)."""
        target, frame = cast(Callable[[object], Target], self.path)(x.t), x.state.object_frame
        pull = self.damping @ (target.twist - x.state.object_twist) + self.stiffness @ pose_error(target.pose, frame)
        if self.push is not None:
            pull = pull + self.push
        if self.inertia is None:
            return target.acceleration + rest_response(x.motion).mobility @ pull
        return target.acceleration + np.linalg.inv(self.inertia) @ (pull + x.given["external_wrench"])
