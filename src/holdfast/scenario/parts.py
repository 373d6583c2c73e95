"""Building the parts of a scene: grasps, the object, springs, swaying bases and external wrenches."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.paths import quintic
from holdfast.errors import ModelError
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closure import Closure
from holdfast.model.coupling import Coupling
from holdfast.model.force_element import WORLD, SpringEnd
from holdfast.model.grasp import Friction, Grasp, WrenchLimits, contact_frame
from holdfast.model.held_object import HeldObject
from holdfast.model.spring import Spring
from holdfast.model.trunk import Trunk
from holdfast.model.world.features import Circle, Sphere
from holdfast.model.world.height_field import HeightField
from holdfast.model.world.holes import Hole, Rod
from holdfast.model.world.shape import WorldShape
from holdfast.model.world.solids import Ball, Box, Cone, Cylinder, HalfSpace
from holdfast.model.world.touching import Touching, corners
from holdfast.scenario import scene, world_tables
from holdfast.scenario.joints import inertia_and_shape, pose, require_names
from holdfast.scenario.table import BaseMotionTable, SwayTable
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, cos, sin
from holdfast.spatial.vector import cross
from holdfast.state import Inputs


def grasp(data: scene.HoldTable, at: Location, of: str | None = None) -> Grasp:
    """Return a grasp, of an object by name if there are several."""
    frame = pose(data, at) if data.into is None else _pointing(data, data.into, at)
    contact = limits = None
    if data.contact is not None:
        with (at / "contact").refusals():
            given = data.contact
            contact = Friction(given.mu, given.torsion_radius, given.half_length, given.half_lengths)
    if data.wrench_limits is not None:
        given = data.wrench_limits
        with (at / "wrench_limits").refusals():
            limits = WrenchLimits(*(math.inf if limit is None else limit for limit in (given.moment, given.force)))
    motion = None if data.motion is None else np.array(data.motion, dtype=float).T
    with at.refusals():
        return Grasp(data.kind, frame, contact, limits, data.pitch, motion, data.stiffness, data.damping, of)


def _pointing(data: scene.HoldTable, into: Sequence[float], at: Location) -> Pose:
    """Return the contact frame with z along the normal `into` what is held."""
    if data.quaternion is not None or data.rpy is not None:
        raise at.refuse("expected one of into, quaternion and rpy, got into and another")
    if not any(into):
        raise (at / "into").refuse("expected a direction, got a vector of length zero")
    with at.refusals():
        return contact_frame(data.position, into=into)


def grasp_key(data: scene.GraspTable | scene.ReleaseTable) -> str | tuple[str, str]:
    """Return what names a grasp in a chain: the arm, or the arm and its link or frame."""
    return data.arm if data.frame is None else (data.arm, data.frame)


def loop(data: scene.LoopTable, at: Location) -> Closure:
    """Return a closure that is no grasp."""
    tip = Pose.identity() if data.tip is None else pose(data.tip, at / "tip")
    held = grasp(data, at)
    with at.refusals():
        return Closure(None if data.a == WORLD else data.a, data.b, held, tip)


def coupling(data: scene.CouplingTable, at: Location) -> Coupling:
    """Return a coupling of joints."""
    if data.rates_only and data.offset:
        raise (at / "offset").refuse("expected none with rates_only, which leaves positions as they are")
    with at.refusals():
        return Coupling(data.terms, None if data.rates_only else data.offset)


def spring(data: scene.SpringTable, arms: Mapping[str, Arm], trunk: Trunk | None, at: Location) -> Spring:
    """Return a spring whose ends are resolved to links of the arms or the trunk."""
    with at.refusals():
        a, b = (SpringEnd(end.body, end.point, end.link) for end in (data.a, data.b))
        return Spring(a, b, data.stiffness, data.length, data.damping).found(arms, trunk)


def held_object(data: scene.ObjectTable, at: Location) -> HeldObject:
    """Return the held object; if a solid is given, it has uniform density and its centre is at `com`."""
    com = np.array(data.com, dtype=float)
    with at.refusals():
        inertia, shape = inertia_and_shape(data, at)
        return HeldObject(data.mass, inertia, com, shape=None if com.any() else shape)  # drawn about C


WORLD_SHAPES: dict[type[world_tables.ShapeTable], type[WorldShape]] = {
    world_tables.HalfSpaceTable: HalfSpace,
    world_tables.BallTable: Ball,
    world_tables.CylinderTable: Cylinder,
    world_tables.ConeTable: Cone,
    world_tables.RoundedBoxTable: Box,
    world_tables.HoleTable: Hole,
    world_tables.RodTable: Rod,
    world_tables.HeightFieldTable: HeightField,
}


def touching(data: scene.SceneTable, at: Location) -> Touching | None:
    """Return what of the object may touch which shapes of the world; None if the scene says nothing of either.

    Raises:
        SceneError: there are shapes without points or points without shapes, or one is impossible.
    """
    given = None if data.object is None else data.object.touching
    for name, one in data.objects.items():
        if one.touching is not None:
            raise (at / "objects" / name / "touching").refuse("expected none, as only the table [object] can have it")
    if given is None or data.object is None:
        if data.world:
            raise (at / "world").refuse('expected object.touching beside it, e.g. points = "corners"; got none')
        return None
    here = at / "object" / "touching"
    if not data.world:
        raise here.refuse("expected shapes in [[world]] beside it, got none")
    require_names((one.name for one in data.world), at / "world", "name")
    shapes = _shapes(data.world, at / "world")
    points: dict[str, ArrayLike]
    if given.points != "corners":
        points = {**(given.points or {})}
    elif data.object.box is None:
        raise (here / "points").refuse(
            "expected points by name for an object that is no box; 'corners' are those of one"
        )
    else:
        points = {name: np.add(data.object.com, x) for name, x in corners(*data.object.box).items()}
    if twice := [name for name in given.circles if name in points]:
        raise (here / "circles" / twice[0]).refuse("expected another name, as a point has it")
    for i, one in enumerate(given.solids):
        if one.base_motion is not None:
            raise (here / "solids" / i / "base_motion").refuse("expected none, as the solid is on the object")
    require_names((one.name for one in given.solids), here / "solids", "name")
    solids = _shapes(given.solids, here / "solids")
    with here.refusals():
        spheres = {name: Sphere(x, given.radius) for name, x in points.items()}
        circles, edges = (
            {name: Circle(x.centre, x.axis, x.radius, x.thickness) for name, x in of.items()}
            for of in (given.circles, given.edges)
        )
        return Touching({**spheres, **circles}, shapes, given.pairs, solids, edges)


def _shapes(tables: Sequence[world_tables.ShapeTable], at: Location) -> dict[str, WorldShape]:
    """Return the shapes of some tables, by name."""
    shapes = {}
    for i, one in enumerate(tables):
        keys = {key: getattr(one, key) for key in one.__struct_fields__ if key not in NO_SHAPE_KEYS}
        frame = pose(one.pose, at / i / "pose")
        with (at / i).refusals():
            shapes[one.name] = WORLD_SHAPES[type(one)](pose=frame, **keys)
    return shapes


NO_SHAPE_KEYS = ("name", "pose", "base_motion")
QUICKEST_START = 1e-6  # [s]; a shorter start would be a jump
HIGHEST_FREQUENCY = 1e4  # [Hz]; beyond any real base motion


@dataclass(frozen=True, eq=False)
class SwayingBase:
    """A base that oscillates about a pose in six coordinates: x_k = s(t) a_k sin(2 pi f_k t + phase_k).

    The coordinates are roll, pitch, yaw (about world axes through the base's origin, in this order) and the
    shift along these axes; s = 10 y^3 - 15 y^4 + 6 y^5, y = t / smooth_start, so that the motion starts from rest.

    Attributes:
        rest: the pose about which the base oscillates.
        amplitude: (6,) amplitudes a [rad, m].
        frequency: (6,) frequencies f, up to 10 kHz in absolute value [Hz].
        phase: (6,) phases [rad].
        smooth_start: duration of the smooth start, at least 1e-6 [s].
        traceable: whether the motion can be compiled into machine code.
    """

    traceable: ClassVar[bool] = True
    rest: Pose
    amplitude: Array
    frequency: Array
    phase: Array
    smooth_start: float

    def __post_init__(self) -> None:
        for name in ("amplitude", "frequency", "phase"):
            object.__setattr__(self, name, checks.numbers(getattr(self, name), (6,), f"base motion: {name}"))
        checks.number(self.smooth_start, "base motion: smooth_start", at_least=QUICKEST_START)
        if (fastest := float(np.abs(self.frequency).max())) > HIGHEST_FREQUENCY:
            raise ModelError(f"base motion: frequency: expected at most {HIGHEST_FREQUENCY:g} Hz, got {fastest:g}")

    def __call__(self, t: Scalar) -> tuple[Pose, Array, Array]:
        """Return pose, twist and acceleration (plain derivative) of the base at time t, world axes."""
        x, rate, acceleration = self.coordinates(t)
        (roll, pitch, _), p = x[:3], x[3:]
        yaw_axis = np.array([0.0, 0.0, 1.0])
        pitch_axis = rotation.from_euler_zyx(x[2], 0.0, 0.0)[:, 1]
        roll_axis = rotation.from_euler_zyx(x[2], pitch, 0.0)[:, 0]
        turning = rate[2] * yaw_axis
        tilting = turning + rate[1] * pitch_axis
        omega = tilting + rate[0] * roll_axis
        omega_dot = acceleration[2] * yaw_axis + acceleration[1] * pitch_axis + acceleration[0] * roll_axis
        omega_dot = omega_dot + rate[1] * cross(turning, pitch_axis) + rate[0] * cross(tilting, roll_axis)
        pose = Pose(rotation.from_euler_zyx(x[2], pitch, roll) @ self.rest.R, self.rest.p + p)
        return pose, concatenate([omega, rate[3:]]), concatenate([omega_dot, acceleration[3:]])

    def coordinates(self, t: Scalar) -> tuple[Array, Array, Array]:
        """Return the six coordinates, their rates and accelerations."""
        s, ds, dds = quintic(t / self.smooth_start)
        ds, dds = ds / self.smooth_start, dds / self.smooth_start**2
        w = 2.0 * np.pi * self.frequency
        sine, cosine = sin(w * t + self.phase), cos(w * t + self.phase)
        return (
            self.amplitude * s * sine,
            self.amplitude * (ds * sine + s * w * cosine),
            self.amplitude * (dds * sine + 2.0 * ds * w * cosine - s * w**2 * sine),
        )


@dataclass(frozen=True, eq=False)
class Pushes:
    """External wrenches on the object or objects, each acting for an interval of time.

    Attributes:
        wrenches: (pushes, 6) [moment; force] about C, world axes [N m, N]; (pushes, k, 6) on k objects.
        begins: (pushes,) times at which they begin [s].
        ends: (pushes,) times at which they end [s]; a wrench no longer acts at its end.
    """

    wrenches: Array
    begins: Array
    ends: Array

    def __call__(self, t: float) -> Inputs:
        """Return the wrench that acts at time t."""
        return Inputs(object_wrench=self.wrenches[(self.begins <= t) & (t < self.ends)].sum(axis=0))

    @property
    def breakpoints(self) -> list[float]:
        """Times at which the wrenches begin and end [s]."""
        return [float(t) for t in (*self.begins, *self.ends) if np.isfinite(t)]


def swaying_base(data: BaseMotionTable, rest: Pose, at: Location) -> SwayingBase:
    """Return a base's motion.

    Raises:
        SceneError: `smooth_start` is too short, or a number is impossible.
    """
    still = SwayTable(amplitude=(0.0, 0.0, 0.0), frequency=(0.0, 0.0, 0.0))
    turn, shift = data.turn or still, data.shift or still
    with at.refusals():
        return SwayingBase(
            rest,
            amplitude=np.array([*turn.amplitude, *shift.amplitude]),
            frequency=np.array([*turn.frequency, *shift.frequency]),
            phase=np.array([*turn.phase, *shift.phase]),
            smooth_start=data.smooth_start,
        )


def pushes(data: Sequence[scene.WrenchTable], objects: Sequence[str], at: Location) -> Pushes:
    """Return the wrenches on the objects.

    Raises:
        SceneError: a wrench ends before it begins, or it is not said on which object it acts.
    """
    wrenches = np.zeros((len(data), len(objects), 6))
    for i, push in enumerate(data):
        if push.end is not None and push.end <= push.begin:
            raise (at / i / "end").refuse(f"expected a time after the begin at {push.begin:g} s, got {push.end:g}")
        name = objects[0] if push.of is None and len(objects) == 1 else push.of
        if name not in objects:
            raise (at / i / "of").refuse(f"expected one of {', '.join(objects) or 'no objects'}, got {name!r}")
        wrenches[i, objects.index(name)] = (*push.moment, *push.force)
    return Pushes(
        wrenches[:, 0] if len(objects) == 1 else wrenches,
        np.array([push.begin for push in data]),
        np.array([np.inf if push.end is None else push.end for push in data]),
    )
