"""The trunk's part of the virtual power, and the motion of the bases mounted on it.

    L_t = y_t.(armature qdd_t + damping qd_t + stiffness (q_t - rest) - T_t) + sum_k U_k.(M_k alpha_k + b_k - w_k)

U are the virtual twists of its bodies. An arm on the trunk has its own part of L (`closed.virtual_power`), which
depends on the pose, the twist, the acceleration and the virtual twist of its base. These are functions of the trunk's
numbers, so gradients are propagated from the bases to the trunk, and rates from the trunk to the bases
(docs/theory/derivatives.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.bias import bias_accelerations
from holdfast.dynamics.arm.forward_kinematics import link_twists
from holdfast.dynamics.arm.varied_kinematics import varied_kinematics
from holdfast.model.arm import Arm
from holdfast.model.link import Link
from holdfast.questions.case import Numbers
from holdfast.spatial.differentiation import gradient, linearised
from holdfast.spatial.inertia import RigidInertia, about_origin
from holdfast.spatial.linear import Linear
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.spatial_vector import acceleration_gradient, rotate, shift_twist, unrotate


class TrunkUnknowns(NamedTuple):
    """The trunk's part of z, or of y.

    Attributes:
        qdd: (n_t,) accelerations of its joints; or virtual rates.
        base: (6,) acceleration of a floating base, 0 without one; or the virtual twist of the base origin.
    """

    qdd: Array
    base: Array


class MountedBase(NamedTuple):
    """The motion of a base mounted on the trunk, for the equations of its arm, in world axes.

    Attributes:
        base_R, base_p: pose of the base.
        base_twist: (6,) twist of its origin.
        base_acceleration: (6,) acceleration of its origin minus [0; g].
        virtual: (6,) virtual twist of its origin.
    """

    base_R: Array
    base_p: Array
    base_twist: Array
    base_acceleration: Array
    virtual: Array


MOTION = MountedBase._fields[:-1]


def varied_inertia(link: Link, k: int, varied: Numbers) -> RigidInertia:
    """Return the inertia of a body about its origin, with the numbers of row k that are varied."""
    own = {"link_mass": link.mass, "link_com": link.com, "link_inertia": link.inertia}
    if varied.keys().isdisjoint(own):
        return link.spatial_inertia
    return about_origin(*(varied[name][k] if name in varied else x for name, x in own.items()))


class TrunkCase(NamedTuple):
    """The arguments of the equations of a trunk.

    Attributes:
        floating: its floating base; None without one.
        serial: its joints and links; None without any.
        base: pose of its base in the world.
        q, qd, tau: (n_t,) positions, rates and torques of its joints.
        base_twist: (6,) twist of the base origin, world axes.
        base_acceleration: (6,) acceleration of the base origin minus [0; g], which is -[0; g] for a floating base.
        wrenches: (bodies, 6) external wrenches about the bodies' origins, world axes.
        mounts: by arm, the index of its body, and the pose of its base relative to that body.
    """

    floating: Link | None
    serial: Arm | None
    base: Pose
    q: Array
    qd: Array
    tau: Array
    base_twist: Array
    base_acceleration: Array
    wrenches: Array
    mounts: Mapping[str, tuple[int, Pose]]

    @property
    def bodies(self) -> list[Link]:
        """Its bodies from the base outward."""
        floating = [] if self.floating is None else [self.floating]
        return floating if self.serial is None else [*floating, *self.serial.links]

    def numbers(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the named numbers; rotations are matrices, and those of mounts are stacked."""
        joints, places = [] if self.serial is None else self.serial.joints, [p for _, p in self.mounts.values()]
        bodies = self.bodies
        own = {
            "base_R": lambda: self.base.R,
            "base_p": lambda: self.base.p,
            "armature": lambda: np.array([joint.armature for joint in joints]),
            "damping": lambda: np.array([joint.damping for joint in joints]),
            "link_mass": lambda: np.array([body.mass for body in bodies]),
            "link_com": lambda: np.array([body.com for body in bodies]),
            "link_inertia": lambda: np.array([body.inertia for body in bodies]),
            "place_R": lambda: np.array([place.R for place in places]).reshape(-1, 3, 3),
            "place_p": lambda: np.array([place.p for place in places]).reshape(-1, 3),
        }
        return {name: own[name]() if name in own else getattr(self, name) for name in names}

    def outward(self, z: TrunkUnknowns, y: TrunkUnknowns, varied: Numbers) -> tuple[Scalar, list[MountedBase]]:
        """Return the trunk's part of L, and the motions of the bases mounted on it.

        Args:
            z: the solution.
            y: the multipliers.
            varied: values that replace the case's own numbers, with the names of `numbers`.
        """
        own = self.numbers(("base_R", "base_p", "q", "qd", "tau", "base_twist", "base_acceleration", "wrenches"))
        R, p, q, qd, tau, twist, acceleration, external = (varied.get(name, x) for name, x in own.items())
        base, acceleration, power = Pose.unchecked(R, p), acceleration + z.base, 0.0
        bodies = []  # for each: frame, twist and virtual twist, acceleration and its gradient, in body axes
        if self.floating is not None:
            v, a = unrotate(R, twist), unrotate(R, acceleration)
            bodies.append((base, v, unrotate(R, y.base), a, acceleration_gradient(a[:3], v[:3])))
        if self.serial is not None:
            arm = self.serial.standing_at(base)
            at = varied_kinematics(arm, q)
            V, U = link_twists(arm, at, qd, twist), link_twists(arm, at, y.qdd, y.base)
            found = bias_accelerations(arm, at, V, qd, twist, acceleration, z.qdd)
            frames = [Pose.unchecked(turn, at.tip.p - reach) for turn, reach in zip(at.R, at.reach, strict=True)]
            bodies += [(f, v, u, a, K) for f, v, u, (a, K) in zip(frames, V, U, found, strict=True)]
            drives = varied.get("armature", arm.armature) * z.qdd + self.passive_torque(arm, q, qd, varied)
            power = power + y.qdd @ (drives - tau)
        for k, (link, (frame, v, u, a, K), w) in enumerate(zip(self.bodies, bodies, external, strict=True)):
            inertia = varied_inertia(link, k, varied)
            power = power + u @ (inertia.wrench(a, v[:3], K) - unrotate(frame.R, w))
        places = self.numbers(("place_R", "place_p")) | dict(varied)
        carried = []
        for (k, _), turn, shift in zip(self.mounts.values(), places["place_R"], places["place_p"], strict=True):
            frame, v, u, a, K = bodies[k]
            moved = concatenate([a[:3], a[3:] + K @ shift])
            six = (shift_twist(shift, v), moved, shift_twist(shift, u))
            carried.append(
                MountedBase(frame.R @ turn, frame.p + frame.R @ shift, *(rotate(frame.R, part) for part in six))
            )
        return power, carried

    def passive_torque(self, arm: Arm, q: Array, qd: Array, varied: Numbers) -> Array:
        """Return the torques of dampers and springs, which are subtracted from the joint torques, (n_t,)."""
        return varied.get("damping", arm.damping) * qd + arm.stiffness * (q - arm.rest)

    def carried(self, z: TrunkUnknowns, y: TrunkUnknowns) -> dict[str, MountedBase]:
        """Return the motions of the bases mounted on the trunk, by arm."""
        return dict(zip(self.mounts, self.outward(z, y, {})[1], strict=True))

    def gradient(
        self, z: TrunkUnknowns, y: TrunkUnknowns, of_bases: Sequence[MountedBase], names: Sequence[str]
    ) -> dict[str, Array]:
        """Return -dL/dtheta with respect to the named numbers, for constant z and y.

        Args:
            z: the solution.
            y: the multipliers.
            of_bases: -dL/dtheta of the arms mounted on the trunk, with respect to the motions of their bases.
            names: names of the numbers.
        """
        numbers = self.numbers(names)

        def less(*x: Array) -> Scalar:
            power, carried = self.outward(z, y, dict(zip(names, x, strict=True)))
            total: Scalar = -power
            for base, of_base in zip(carried, of_bases, strict=True):
                for part, of_part in zip(base, of_base, strict=True):
                    total = total + np.ravel(part) @ np.ravel(of_part)
            return total

        return dict(zip(names, gradient(less, *numbers.values()), strict=True))

    def base_motion(self, z: TrunkUnknowns, names: Sequence[str]) -> Linear:
        """Return the linearisation of the motions of the mounted bases in the named numbers for constant z."""
        none = TrunkUnknowns(np.zeros(len(self.q)), np.zeros(6))

        def motion(*x: Array) -> list[Array]:
            carried = self.outward(z, none, dict(zip(names, x, strict=True)))[1]
            return [part for base in carried for part in base[:-1]]

        return linearised(motion, *self.numbers(names).values())

    def base_rates(self, motion: Linear, rates: Numbers) -> dict[str, dict[str, Array]]:
        """Return the rates of the linearised motions of the mounted bases, by arm, for rates of the numbers."""
        found = motion.rates(*rates.values())
        count = len(MOTION)
        return {
            name: dict(zip(MOTION, found[count * i : count * (i + 1)], strict=True))
            for i, name in enumerate(self.mounts)
        }

    def residual(self, z: TrunkUnknowns, wrenches: Sequence[Array], names: Sequence[str]) -> Linear:
        """Return the linearisation of dL/dy in the wrenches on the arms and the named numbers for constant z.

        Args:
            z: the solution.
            wrenches: (6,) wrench of the trunk on each arm about the arm's base origin.
            names: names of the numbers.
        """
        count = len(wrenches)

        def residual(*x: Array) -> tuple[Array, ...]:
            loads, varied = x[:count], dict(zip(names, x[count:], strict=True))

            def power(*y: Array) -> Scalar:
                own, carried = self.outward(z, TrunkUnknowns(*y), varied)
                for base, load in zip(carried, loads, strict=True):
                    own = own + load @ base.virtual
                return own

            return gradient(power, np.zeros(len(self.q)), np.zeros(6))

        return linearised(residual, *wrenches, *self.numbers(names).values())
