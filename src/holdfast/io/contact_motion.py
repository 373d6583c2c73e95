"""Problem cases of motions in which an object touches the world, with closed-form answers.

Every kind says how its chain and state are built, and how its answers are read from a run.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import msgspec
import numpy as np

from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.world.features import Sphere
from holdfast.model.world.solids import HalfSpace
from holdfast.model.world.touching import Touching, corners
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State

LONGER = 1.05  # a run goes on for so much longer than the motion is asked for
THIN = 1e-3  # inertia of a rod about itself, of that across it; it never turns about itself


class ContactMotion(msgspec.Struct, tag_field="motion", forbid_unknown_fields=True, kw_only=True):
    """A motion: parameters, and by name what is asked.

    Attributes:
        name: its name.
        kind: "trajectory".
        what: the motion in words.
        gravity: along -z [m/s^2].
        expected: the answers, if the file contains them.
    """

    name: str
    kind: Literal["trajectory"] = "trajectory"
    what: str = ""
    gravity: float = 9.81
    expected: dict[str, float | list[float]] = {}

    step: ClassVar[float] = 0.01
    answers: ClassVar[tuple[str, ...]] = ()

    def chain(self) -> ClosedChain:
        """Return the chain."""
        raise NotImplementedError

    def state(self) -> State:
        """Return the state at the start."""
        raise NotImplementedError

    @property
    def duration(self) -> float:
        """Duration of the run [s]."""
        raise NotImplementedError

    def found(self, run: Trajectory) -> dict[str, Any]:
        """Return the answers that a run gives, by the names of `expected`."""
        raise NotImplementedError

    def check(self, at: Location) -> None:
        """Refuse parameters of which no chain or state can be made, and answers that the motion does not have.

        Raises:
            SceneError: naming the first.
        """
        for name in self.expected:
            if name not in self.answers:
                raise (at / "expected" / name).refuse(f"expected one of {', '.join(self.answers)}")
        with at.refusals():
            self.chain()
            self.state()
            checks.number(self.duration, "duration", above=0.0)

    @property
    def _time(self) -> float | None:
        """The time at which answers are asked; None without one [s]."""
        given = self.expected.get("time")
        return given if isinstance(given, float) else None

    def free(self, body: HeldObject, touching: Touching) -> ClosedChain:
        """Return the chain of a free object."""
        return ClosedChain({}, body, {}, gravity=[0.0, 0.0, -self.gravity], touching=touching)


class BlockOnSlope(ContactMotion, tag="block_on_slope"):
    """A box slides down a slope and stops."""

    mass: float
    half: tuple[float, float, float]
    slope: float
    mu: float
    speed: float

    step: ClassVar[float] = 0.02
    answers: ClassVar[tuple[str, ...]] = ("stop_time", "stop_distance", "force_on_slope_while_it_slides")

    @property
    def _R(self) -> Array:
        return rotation.exp(np.array([0.0, self.slope, 0.0]))

    def chain(self) -> ClosedChain:
        """Return the box on its slope."""
        edges = [2.0 * half for half in self.half]
        below = {name: x for name, x in corners(*edges).items() if name[2] == "-"}
        slope = HalfSpace(normal=_unit(self._R[:, 2]), friction=self.mu)
        return self.free(HeldObject.box(self.mass, *edges), Touching(below, {"slope": slope}))

    def state(self) -> State:
        """Return the box sliding down the slope."""
        R = self._R
        return State([], [], Pose(R, self.half[2] * R[:, 2]), np.concatenate([np.zeros(3), self.speed * R[:, 0]]))

    @property
    def duration(self) -> float:
        """Until it stands [s]."""
        braking = self.gravity * (self.mu * math.cos(self.slope) - math.sin(self.slope))
        return LONGER * self.speed / braking

    def found(self, run: Trajectory) -> dict[str, Any]:
        """Return when and where it stops, and the force on the slope along and across it."""
        R, stop = self._R, _first(run, "stick")
        force = -run.touch_force[np.searchsorted(run.t, 0.5 * stop)].sum(axis=0)
        return {
            "stop_time": stop,
            "stop_distance": (run.object_pose[-1, 4:] - run.object_pose[0, 4:]) @ R[:, 0],
            "force_on_slope_while_it_slides": [force @ R[:, 0], -(force @ R[:, 2])],
        }


class BallSlidesThenRolls(ContactMotion, tag="ball_slides_then_rolls"):
    """A ball is set down with speed and no spin."""

    mass: float
    radius: float
    mu: float
    speed: float

    answers: ClassVar[tuple[str, ...]] = ("rolls_from", "speed_rolling", "spin_rolling", "time", "travelled")

    def chain(self) -> ClosedChain:
        """Return the ball on a floor."""
        touching = Touching({"sphere": Sphere(radius=self.radius)}, {"floor": HalfSpace(friction=self.mu)})
        return self.free(HeldObject.sphere(self.mass, self.radius), touching)

    def state(self) -> State:
        """Return the ball sliding along x."""
        return State([], [], Pose.translation(0.0, 0.0, self.radius), [0.0, 0.0, 0.0, self.speed, 0.0, 0.0])

    @property
    def duration(self) -> float:
        """Until `time`, or until it rolls [s]."""
        return self._time or (LONGER * 2.0 / 7.0 * self.speed / (self.mu * self.gravity))

    def found(self, run: Trajectory) -> dict[str, Any]:
        """Return when it rolls, how fast, and how far it comes."""
        return {
            "rolls_from": _first(run, "stick"),
            "speed_rolling": run.object_twist[-1, 3],
            "spin_rolling": run.object_twist[-1, 1],
            "time": run.t[-1],
            "travelled": run.object_pose[-1, 4],
        }


class BouncingBall(ContactMotion, tag="bouncing_ball"):
    """A ball falls, and bounces until it rests."""

    mass: float
    radius: float
    height: float
    restitution: float
    mu: float

    step: ClassVar[float] = 0.1
    answers: ClassVar[tuple[str, ...]] = ("touches", "height_after_each", "comes_to_rest_at")

    def chain(self) -> ClosedChain:
        """Return the ball above a floor."""
        floor = HalfSpace(friction=self.mu, restitution=self.restitution)
        touching = Touching({"sphere": Sphere(radius=self.radius)}, {"floor": floor})
        return self.free(HeldObject.sphere(self.mass, self.radius), touching)

    def state(self) -> State:
        """Return the ball at rest above the floor."""
        return State([], [], Pose.translation(0.0, 0.0, self.radius + self.height))

    @property
    def duration(self) -> float:
        """Until it rests [s]."""
        e = self.restitution
        return LONGER * math.sqrt(2.0 * self.height / self.gravity) * (1.0 + e) / (1.0 - e)

    def found(self, run: Trajectory) -> dict[str, Any]:
        """Return the first touches, the heights after them, and when it rests."""
        touches = [one.t for one in run.occurrences if one.kind == "touch"][
            : len(np.atleast_1d(np.array(self.expected.get("touches", [0.0] * 4))))
        ]
        heights = [_extreme(run, lambda s: s.object_twist[5], t).object_pose[6] - self.radius for t in touches]
        rest = next((one for one in run.occurrences if one.kind == "rest"), None)
        last = [one.t for one in run.occurrences if one.kind == "touch"][-1]  # by steps
        ends = last if rest is None or rest.rebounds_until is None else rest.rebounds_until
        return {"touches": touches, "height_after_each": heights, "comes_to_rest_at": ends}


class Ladder(ContactMotion, tag="ladder"):
    """A rod slides down a frictionless wall and floor, until it leaves the wall."""

    mass: float
    half_length: float
    from_rest_at: float
    angle: float
    rate: float

    step: ClassVar[float] = 0.005
    answers: ClassVar[tuple[str, ...]] = ("leaves_after", "angle", "rate", "centre_speed_x", "floor_force")

    def chain(self) -> ClosedChain:
        """Return the rod between wall and floor."""
        across = self.mass * self.half_length**2 / 3.0
        body = HeldObject(self.mass, np.diag([THIN * across, across, across]))
        ends = {"foot": [-self.half_length, 0.0, 0.0], "head": [self.half_length, 0.0, 0.0]}
        return self.free(body, Touching(ends, {"floor": HalfSpace(), "wall": HalfSpace(normal=[1.0, 0.0, 0.0])}))

    def state(self) -> State:
        """Return the rod with its foot on the floor and its head on the wall, sliding down."""
        c, s, l = math.cos(self.angle), math.sin(self.angle), self.half_length
        R = np.array([[-c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, -c]])
        v = -self.rate * l * np.array([-s, 0.0, c])
        return State([], [], Pose(R, [l * c, 0.0, l * s]), [0.0, -self.rate, 0.0, *v])

    @property
    def duration(self) -> float:
        """Until shortly after it leaves the wall, at two thirds of its first height [s]."""
        if isinstance(left := self.expected.get("leaves_after"), float):
            return LONGER * left
        return 2.0 * math.sqrt(self.half_length / self.gravity)

    def found(self, run: Trajectory) -> dict[str, Any]:
        """Return when and how it leaves the wall."""
        t = next(one.t for one in run.occurrences if one.kind == "lift" and one.name == "head/wall")
        k = int(np.searchsorted(run.t, t))  # the sample after the event
        x = rotation.from_quaternion(run.object_pose[k, :4])[:, 0]
        return {
            "leaves_after": t,
            "angle": math.atan2(x[2], -x[0]),
            "rate": -run.object_twist[k, 1],
            "centre_speed_x": run.object_twist[k, 3],
            "floor_force": run.touch_force[k].sum(axis=0)[2],
        }


class BoxTips(ContactMotion, tag="box_tips"):
    """A box turns about its edge, over the balance."""

    mass: float
    half: tuple[float, float, float]
    inertia_y: float
    mu: float
    rate: float

    step: ClassVar[float] = 0.005
    answers: ClassVar[tuple[str, ...]] = ("angle", "time", "rate", "energy_lost")

    def chain(self) -> ClosedChain:
        """Return the box on a floor."""
        edges = [2.0 * half for half in self.half]
        J = HeldObject.box(self.mass, *edges).inertia.copy()
        J[1, 1] = self.inertia_y
        below = {name: x for name, x in corners(*edges).items() if name[2] == "-"}
        return self.free(HeldObject(self.mass, J), Touching(below, {"floor": HalfSpace(friction=self.mu)}))

    def state(self) -> State:
        """Return the box turning about its lower edge at +x."""
        x, _, z = self.half
        return State([], [], Pose.translation(0.0, 0.0, z), [0.0, self.rate, 0.0, self.rate * z, 0.0, self.rate * x])

    @property
    def duration(self) -> float:
        """Until `time` [s]."""
        return self._time or 1.0 / self.rate

    def found(self, run: Trajectory) -> dict[str, Any]:
        """Return the angle and the rate at the end, and the time at which the expected angle is passed."""
        R = rotation.from_quaternion(run.object_pose[-1, :4])
        angle, rate = math.atan2(R[0, 2], R[2, 2]), run.object_twist[-1, 1]
        wanted = self.expected.get("angle", angle)
        passed = run.t[-1] + (wanted - angle) / rate if isinstance(wanted, float) else math.nan
        return {"angle": angle, "time": passed, "rate": rate, "energy_lost": -run.impact[-1]}


class ArmStrikesWall(ContactMotion, tag="arm_strikes_wall"):
    """An arm of one joint swings a ball against a wall."""

    link_length: float
    link_mass: float
    ball_mass: float
    ball_radius: float
    restitution: float
    wall_angle: float
    start_angle: float

    step: ClassVar[float] = 0.005
    answers: ClassVar[tuple[str, ...]] = (
        "first_touch", "rate_before", "rate_after", "impulse", "highest_angle_after", "second_touch",
    )  # fmt: skip

    def chain(self) -> ClosedChain:
        """Return the arm, the ball in its hand, and the wall."""
        l, across = self.link_length, self.link_mass * self.link_length**2 / 12.0
        link = Link(self.link_mass, [0.0, 0.0, -0.5 * l], np.diag([across, across, THIN * across]))
        arm = Arm([Joint(axis=[0.0, -1.0, 0.0])], [link], tip=Pose.translation(0.0, 0.0, -l))
        n = [math.cos(self.wall_angle), 0.0, math.sin(self.wall_angle)]
        wall = HalfSpace(normal=_unit(n), offset=-self.ball_radius, restitution=self.restitution)
        return ClosedChain(
            {"arm": arm},
            HeldObject.sphere(self.ball_mass, self.ball_radius),
            {"arm": Grasp("rigid")},
            gravity=[0.0, 0.0, -self.gravity],
            touching=Touching({"sphere": Sphere(radius=self.ball_radius)}, {"wall": wall}),
        )

    def state(self) -> State:
        """Return the arm at rest."""
        turned = Pose(rotation.exp(np.array([0.0, -self.start_angle, 0.0])), np.zeros(3))
        return State([self.start_angle], [0.0], turned @ Pose.translation(0.0, 0.0, -self.link_length))

    @property
    def duration(self) -> float:
        """Until shortly after the second touch [s]."""
        if isinstance(last := self.expected.get("second_touch"), float):
            return LONGER * last
        return 6.0 * math.sqrt(self.link_length / self.gravity)

    def found(self, run: Trajectory) -> dict[str, Any]:
        """Return touches, rates and the impulse at the first, and the highest angle after it."""
        touches = [one for one in run.occurrences if one.kind == "touch"]
        k = int(np.searchsorted(run.t, touches[0].t))
        return {
            "first_touch": touches[0].t,
            "rate_before": run.qd[k - 1, 0],
            "rate_after": run.qd[k, 0],
            "impulse": float(np.linalg.norm(touches[0].impulse)),
            "highest_angle_after": _extreme(run, lambda state: state.qd[0], touches[0].t).q[0],
            "second_touch": touches[1].t if len(touches) > 1 else math.nan,
        }


AnyMotion = BlockOnSlope | BallSlidesThenRolls | BouncingBall | Ladder | BoxTips | ArmStrikesWall


def error_of(motion: ContactMotion, found: dict[str, Any]) -> float | None:
    """Return the largest difference from what is expected, relative to it; None without expected answers."""
    off = [0.0]
    for name, wanted in motion.expected.items():
        x, y = np.atleast_1d(np.array(found[name], float)), np.atleast_1d(np.array(wanted, float))
        off.append(math.inf if x.shape != y.shape else float(np.abs(x - y).max() / (np.abs(y).max() or 1.0)))
    return max(off) if motion.expected else None


def _first(run: Trajectory, kind: str) -> float:
    """Return the time of the first entry of a kind [s]; NaN without one."""
    return next((one.t for one in run.occurrences if one.kind == kind), math.nan)


def _unit(x: Any) -> Array:
    return np.array(x) / np.linalg.norm(x)


def _extreme(run: Trajectory, rate: Any, after: float) -> State:
    """Return the state at which a rate that is positive after an event becomes zero."""
    first = int(np.searchsorted(run.t, after))
    rates = np.array([rate(run.state(k)) for k in range(first, len(run.t))])
    falling = np.flatnonzero((rates[:-1] > 0.0) & (rates[1:] <= 0.0))
    if not len(falling):
        return run.state(len(run.t) - 1)
    k = first + int(falling[0])
    from scipy.optimize import brentq  # imported here because it takes half a second

    at: float = brentq(lambda t: rate(run.state_at(t)), run.t[k], run.t[k + 1], xtol=1e-15)  # pyright: ignore
    return run.state_at(at)
