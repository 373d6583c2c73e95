"""The virtual power of a chain's equations, a scalar from which the derivatives of its dynamics follow.

With z = (qdd, f, alpha(C), W_dot) and multipliers y = (y_q, y_f, y_a, y_W)

    L = y_q.(M qdd + C + J^T f - T) + y_a.(M_C alpha + b_C - w - sum A^T f)
        + y_f.(J qdd + Jdot qd + g + H^T W_dot - a - A alpha) + y_W.H f

dL/dy = 0 are the equations (2.11) with (b.1), and K = d2L/dz dy is their symmetric matrix. Let theta be any argument of
the equations. A rate theta_dot changes the solution by K z_dot = -d(dL/dy) for constant z and y, and a cotangent z_bar
has the gradient -dL/dtheta with K y = z_bar (docs/theory/derivatives.md). L is a sum over the links, by d'Alembert's
principle: the power of the wrenches needed for the links' accelerations, along the virtual twists U of joint rates y_q.
A virtual twist of the base adds the power of the base's wrench, which gives the derivatives of that wrench, too. The
wrench of a bushing, which follows from the state, contributes the power at its two ends, and has its own multiplier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.bias import acceleration_at_tip, bias_accelerations
from holdfast.dynamics.arm.forward_kinematics import Kinematics, link_twists, tip_twist
from holdfast.dynamics.arm.motion import ArmInputs
from holdfast.dynamics.arm.varied_kinematics import varied_kinematics
from holdfast.dynamics.closed.contact import contact
from holdfast.dynamics.closed.force_elements import deflection
from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.questions.case import Numbers
from holdfast.spatial.differentiation import gradient, linearised
from holdfast.spatial.inertia import RigidInertia, about_origin
from holdfast.spatial.linear import Linear
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar
from holdfast.spatial.spatial_vector import acceleration_gradient, shift_twist, unrotate

NO_KNOWN_WRENCH = np.zeros(0)


class ArmUnknowns(NamedTuple):
    """One arm's part of z, or of y.

    Attributes:
        qdd: (N,) joint accelerations; or virtual joint rates.
        wrench: (6,) f about the contact point; or its multiplier.
        contact_acceleration: (n_g,) W_dot; or its multiplier.
        object_acceleration: (6,) alpha(C) less [0; g]; or a virtual twist of C. The same for all arms.
        base: (6,) the base's wrench on the arm; or a virtual twist of the base origin.
        known: (6,) the wrench of a bushing; or its multiplier. (0,) for other grasps.
    """

    qdd: Array
    wrench: Array
    contact_acceleration: Array
    object_acceleration: Array
    base: Array
    known: Array = NO_KNOWN_WRENCH


class TipMotion(NamedTuple):
    """The motion of a tip, in world axes.

    Attributes:
        pose: pose of the tip frame.
        twist: (6,) twist of the tip point.
        acceleration: (6,) acceleration of the tip point.
        virtual: (6,) virtual twist of the tip point.
    """

    pose: Pose
    twist: Array
    acceleration: Array
    virtual: Array


def varied_inertia(link: Link, k: int, varied: Numbers) -> RigidInertia:
    """Return the inertia of a body about its origin, with the numbers of row k that are varied."""
    own = {"link_mass": link.mass, "link_com": link.com, "link_inertia": link.inertia}
    if varied.keys().isdisjoint(own):
        return link.spatial_inertia
    return about_origin(*(varied[name][k] if name in varied else x for name, x in own.items()))


class LinkMotions(NamedTuple):
    """The motions of links, in their axes.

    Attributes:
        twists: (6,) twist of every link.
        virtual: (6,) virtual twist of every link.
        accelerations: (6,) acceleration of every link, and its gradient.
    """

    twists: tuple[Array, ...]
    virtual: tuple[Array, ...]
    accelerations: list[tuple[Array, Array]]


class ArmCase(NamedTuple):
    """The arguments of the equations of one arm and its grasp.

    Attributes:
        given: the arm, with its state, torques and loads.
        grasp: its grasp, or None.
        frame: pose of the object in the world.
        twist: (6,) twist of C, world axes.
    """

    given: ArmInputs
    grasp: Grasp | None
    frame: Pose
    twist: Array

    @property
    def in_motion(self) -> bool:
        """Whether these are the equations of motion, which `joint_residuals` differentiates by all joints together."""
        return True

    def moved(self, acceleration: Array | None) -> ArmCase:
        """Return the case with an additional acceleration (6,) of the base; None for no change."""
        given = self.given
        if acceleration is None:
            return self
        return self._replace(given=replace(given, base_acceleration=given.base_acceleration + acceleration))

    def base_wrench(self, z: ArmUnknowns, y: ArmUnknowns) -> Array:
        """Return the derivative of L by the virtual twist of the base, which is its wrench on the arm, (6,)."""
        return gradient(lambda base: self.power(z, y._replace(base=base), {}), y.base)[0]

    def numbers(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the named numbers with respect to which L can be differentiated; rotations are matrices."""
        given, arm = self.given, self.given.arm
        own = {
            "base_R": lambda: arm.base.R,
            "base_p": lambda: arm.base.p,
            "armature": lambda: arm.armature,
            "damping": lambda: arm.damping,
            "link_mass": lambda: np.array([link.mass for link in arm.links]),
            "link_com": lambda: np.array([link.com for link in arm.links]).reshape(-1, 3),
            "link_inertia": lambda: np.array([link.inertia for link in arm.links]).reshape(-1, 3, 3),
            "link_wrench": lambda: given.link_wrenches,
            "object_R": lambda: self.frame.R,
            "object_p": lambda: self.frame.p,
            "object_twist": lambda: self.twist,
        }
        if self.grasp is not None:
            frame = self.grasp.frame
            own |= {"grasp_R": lambda: frame.R, "grasp_p": lambda: frame.p}
        return {name: own[name]() if name in own else getattr(given, name) for name in names}

    def power(self, z: ArmUnknowns, y: ArmUnknowns, varied: Numbers) -> Scalar:
        """Return the arm's and its grasp's part of L.

        Args:
            z: the solution.
            y: the multipliers.
            varied: values that replace the case's own numbers, with the names of `numbers`.
        """
        return self.power_at(*self.configuration(varied), z, y, varied)

    def configuration(self, varied: Numbers) -> tuple[Arm, Kinematics]:
        """Return the arm at its base, and the poses of its links."""
        given, arm = self.given, self.given.arm
        if "base_R" in varied or "base_p" in varied:
            base = Pose.unchecked(varied.get("base_R", arm.base.R), varied.get("base_p", arm.base.p))
            arm = arm.standing_at(base)
        return arm, varied_kinematics(arm, varied.get("q", given.q))

    def power_at(self, arm: Arm, at: Kinematics, z: ArmUnknowns, y: ArmUnknowns, varied: Numbers) -> Scalar:
        """Return `power` for a given `configuration`."""
        power, tip = self.of_links(arm, at, z, y, varied)
        return power if self.grasp is None else power + self.grasp_power(z, y, tip, varied)

    def of_links(
        self, arm: Arm, at: Kinematics, z: ArmUnknowns, y: ArmUnknowns, varied: Numbers
    ) -> tuple[Scalar, TipMotion]:
        """Return the links' part of L, and the motion of the tip; arguments as in `power_at`."""
        twist, acceleration = (varied.get(n, getattr(self.given, n)) for n in ("base_twist", "base_acceleration"))
        power, (V, U, found) = self.links_power(arm, at, z.qdd, y.qdd, y.base, varied)
        tip = acceleration_at_tip(arm, at, found, twist, acceleration)
        return power, TipMotion(at.tip, tip_twist(arm, at, V, twist), tip, tip_twist(arm, at, U, y.base))

    def links_power(
        self, arm: Arm, at: Kinematics, qdd: Array, rates: Array, virtual: Array, varied: Numbers
    ) -> tuple[Scalar, LinkMotions]:
        """Return the links' part of L, and their motions.

        Args:
            arm: the arm at its base.
            at: the poses of its links.
            qdd: (N,) joint accelerations.
            rates: (N,) virtual joint rates.
            virtual: (6,) virtual twist of the base origin.
            varied: as in `power`.
        """
        q, qd, tau, base_twist, base_acceleration, external = (
            varied.get(name, getattr(self.given, name))
            for name in ("q", "qd", "tau", "base_twist", "base_acceleration", "link_wrenches")
        )
        external = varied.get("link_wrench", external)
        V, U = link_twists(arm, at, qd, base_twist), link_twists(arm, at, rates, virtual)
        found = list(bias_accelerations(arm, at, V, qd, base_twist, base_acceleration, qdd))
        drives = varied.get("armature", arm.armature) * qdd + self.passive_torque(q, qd, varied)
        power = rates @ (drives - tau)
        for k, (link, v, u, (a, K)) in enumerate(zip(arm.links, V, U, found, strict=True)):
            wrench = varied_inertia(link, k, varied).wrench(a, v[:3], K)
            if external is not None:
                wrench = wrench - unrotate(at.R[k], external[k])
            power = power + u @ wrench
        return power, LinkMotions(V, U, found)

    def grasp_power(self, z: ArmUnknowns, y: ArmUnknowns, tip: TipMotion, varied: Numbers) -> Scalar:
        """Return the grasp's part of L for a given motion of the tip; the other arguments are those of `power`."""
        grasp = self.grasp
        assert grasp is not None
        if "grasp_R" in varied or "grasp_p" in varied:
            frame = grasp.frame
            grasp = grasp.standing_at(Pose.unchecked(varied.get("grasp_R", frame.R), varied.get("grasp_p", frame.p)))
        of_object = Pose.unchecked(varied.get("object_R", self.frame.R), varied.get("object_p", self.frame.p))
        c = contact(grasp, of_object, varied.get("object_twist", self.twist), tip.pose, tip.twist)
        apart = tip.acceleration + c.g - c.a - shift_twist(c.offset, z.object_acceleration)
        together = tip.virtual - shift_twist(c.offset, y.object_acceleration)
        power = 0.0
        if grasp.of_kind.bushing is not None:
            power = (together + y.known) @ deflection(c).wrench()
        if grasp.free:
            apart = apart + c.HT @ z.contact_acceleration
            together = together + c.HT @ y.contact_acceleration
        return power + y.wrench @ apart + together @ z.wrench

    def passive_torque(self, q: Array, qd: Array, varied: Numbers) -> Array:
        """Return the torques of dampers and springs, which are subtracted from the joint torques, (N,)."""
        arm = self.given.arm
        return varied.get("damping", arm.damping) * qd + arm.stiffness * (q - arm.rest)

    def velocity_gap(self, names: Sequence[str]) -> Linear:
        """Return the linearisation of K (V+ - A V(C)), the tip's velocity relative to its contact, in named numbers.

        The numbers may be q, object_R and object_p; and base_R, base_p and base_twist, which must be given together.
        """
        given, grasp = self.given, self.grasp
        assert grasp is not None

        def gap(*x: Array) -> tuple[Array]:
            varied = dict(zip(names, x, strict=True))
            twist, (arm, at) = varied.get("base_twist", given.base_twist), self.configuration(varied)
            tip = tip_twist(arm, at, link_twists(arm, at, given.qd, twist), twist)
            of_object = Pose.unchecked(varied.get("object_R", self.frame.R), varied.get("object_p", self.frame.p))
            return (-contact(grasp, of_object, self.twist, at.tip, tip).velocity_gap,)

        return linearised(gap, *self.numbers(names).values())

    def gradient(self, z: ArmUnknowns, y: ArmUnknowns, names: Sequence[str]) -> dict[str, Array]:
        """Return -dL/dtheta with respect to the named numbers, for constant z and y."""
        numbers = self.numbers(names)
        found = gradient(lambda *x: -self.power(z, y, dict(zip(names, x, strict=True))), *numbers.values())
        return dict(zip(names, found, strict=True))

    def residual(self, z: ArmUnknowns, names: Sequence[str]) -> Linear:
        """Return the linearisation of dL/dy, an `ArmUnknowns`, in the named numbers for constant z."""
        zero = [np.zeros(len(part)) for part in z]  # L is linear in y

        def residual(*x: Array) -> tuple[Array, ...]:
            varied = dict(zip(names, x, strict=True))
            return gradient(lambda *y: self.power(z, ArmUnknowns(*y), varied), *zero)

        return linearised(residual, *self.numbers(names).values())


class ObjectCase(NamedTuple):
    """The arguments of the equations of the object.

    Attributes:
        body: the object.
        frame: its pose (origin C) in the world.
        twist: (6,) twist of C, world axes.
        wrench: (6,) external wrench about C, world axes.
    """

    body: HeldObject
    frame: Pose
    twist: Array
    wrench: Array

    def numbers(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the named numbers with respect to which L can be differentiated."""
        own = {"object_R": self.frame.R, "object_twist": self.twist, "object_wrench": self.wrench}
        own |= {"object_mass": self.body.mass, "object_com": self.body.com, "object_inertia": self.body.inertia}
        return {name: np.asarray(own[name]) for name in names}

    def power(self, alpha: Array, y: Array, varied: Numbers) -> Scalar:
        """Return the object's part of L.

        Args:
            alpha: (6,) alpha(C) minus [0; g].
            y: (6,) its multiplier.
            varied: values that replace the case's own numbers.
        """
        numbers = self.numbers(("object_R", "object_twist", "object_mass", "object_com", "object_inertia"))
        R, twist, mass, com, inertia = (varied.get(name, own) for name, own in numbers.items())
        a, w = unrotate(R, alpha), twist[:3] @ R
        needed = about_origin(mass[()], com, inertia).wrench(a, w, acceleration_gradient(a[:3], w))
        return unrotate(R, y) @ needed - y @ varied.get("object_wrench", self.wrench)

    def gradient(self, alpha: Array, y: Array, names: Sequence[str]) -> dict[str, Array]:
        """Return -dL/dtheta with respect to the named numbers, for constant alpha and y."""
        numbers = self.numbers(names)
        found = gradient(lambda *x: -self.power(alpha, y, dict(zip(names, x, strict=True))), *numbers.values())
        return dict(zip(names, found, strict=True))

    def residual(self, alpha: Array, names: Sequence[str]) -> Linear:
        """Return the linearisation of dL/dy, (6,), in the named numbers for constant alpha."""

        def residual(*x: Array) -> tuple[Array, ...]:
            return gradient(lambda y: self.power(alpha, y, dict(zip(names, x, strict=True))), np.zeros(6))

        return linearised(residual, *self.numbers(names).values())
