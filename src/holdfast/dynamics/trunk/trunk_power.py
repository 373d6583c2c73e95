"""The trunk's part of the virtual power, and the motion of the bases mounted on it.

Its joints and links have that of an arm without a grasp (`closed.virtual_power`), and a floating base that of one more
body. An arm on the trunk has its own part of L, which depends on the pose, the twist, the acceleration and the virtual
twist of its base. These are functions of the trunk's numbers, so gradients are propagated from the bases to the trunk,
and rates from the trunk to the bases (docs/theory/derivatives.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.virtual_power import ArmCase, varied_inertia
from holdfast.model.link import Link
from holdfast.questions.arrays import LINKS
from holdfast.questions.case import Numbers
from holdfast.spatial.differentiation import gradient, linearised
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


class TrunkCase(NamedTuple):
    """The arguments of the equations of a trunk.

    Attributes:
        floating: its floating base; None without one.
        serial: its joints and links as an arm without a grasp on the trunk's base, whose acceleration minus [0; g] is
            -[0; g] for a floating base.
        wrenches: (bodies, 6) external wrenches about the bodies' origins, world axes.
        mounts: by arm, the index of its body, and the pose of its base relative to that body.
    """

    floating: Link | None
    serial: ArmCase
    wrenches: Array
    mounts: Mapping[str, tuple[int, Pose]]

    @property
    def base(self) -> Pose:
        """The pose of its base in the world."""
        return self.serial.given.arm.base

    @property
    def bodies(self) -> list[Link]:
        """Its bodies from the base outward."""
        return [*([] if self.floating is None else [self.floating]), *self.serial.given.arm.links]

    def numbers(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the named numbers; rotations are matrices, and those of mounts are stacked."""
        places, bodies = [place for _, place in self.mounts.values()], self.bodies
        own = {
            "wrenches": lambda: self.wrenches,
            "link_mass": lambda: np.array([body.mass for body in bodies]),
            "link_com": lambda: np.array([body.com for body in bodies]),
            "link_inertia": lambda: np.array([body.inertia for body in bodies]),
            "place_R": lambda: np.array([place.R for place in places]).reshape(-1, 3, 3),
            "place_p": lambda: np.array([place.p for place in places]).reshape(-1, 3),
        }
        return {name: own[name]() if name in own else self.serial.numbers([name])[name] for name in names}

    def outward(self, z: TrunkUnknowns, y: TrunkUnknowns, varied: Numbers) -> tuple[Scalar, list[MountedBase]]:
        """Return the trunk's part of L, and the motions of the bases mounted on it.

        Args:
            z: the solution.
            y: the multipliers.
            varied: values that replace the case's own numbers, with the names of `numbers`.
        """
        given, first = self.serial.given, 0 if self.floating is None else 1
        acceleration = varied.get("base_acceleration", given.base_acceleration) + z.base
        external, (arm, at) = varied.get("wrenches", self.wrenches), self.serial.configuration(varied)
        rows = {name: varied[name][first:] for name in LINKS if name in varied}
        rows |= {"base_acceleration": acceleration, "link_wrench": external[first:]}
        power, (V, U, found) = self.serial.links_power(arm, at, z.qdd, y.qdd, y.base, {**varied, **rows})
        frames = [Pose.unchecked(turn, at.tip.p - reach) for turn, reach in zip(at.R, at.reach, strict=True)]
        bodies = [(f, v, u, a, K) for f, v, u, (a, K) in zip(frames, V, U, found, strict=True)]  # in body axes
        if self.floating is not None:
            R, twist = arm.base.R, varied.get("base_twist", given.base_twist)
            v, u, a = (unrotate(R, x) for x in (twist, y.base, acceleration))
            K = acceleration_gradient(a[:3], v[:3])
            bodies.insert(0, (arm.base, v, u, a, K))
            inertia = varied_inertia(self.floating, 0, varied)
            power = power + u @ (inertia.wrench(a, v[:3], K) - unrotate(R, external[0]))
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
        none = TrunkUnknowns(np.zeros(len(self.serial.given.q)), np.zeros(6))

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

            return gradient(power, np.zeros(len(self.serial.given.q)), np.zeros(6))

        return linearised(residual, *wrenches, *self.numbers(names).values())
