"""A slider-crank in space, its rod on a ball and on a universal joint, in one coordinate: the crank's angle.

The crank turns about z in a plane beside the slider's line along x. The rod's direction follows from two points, its
turn about itself from the universal joint's cross: one arm c lies along the world's z, the other along the rod's y, and
both stay perpendicular. Places and axes are differentiated twice by the angle, by hand; the virtual work along the one
way of moving gives

    M angle'' + N angle'^2 = torque - losses + (push - spring) (slider's place)' + weight . (its place)'

No spatial operators, no constraints, no forces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State

GRAVITY = np.array([0.0, -9.81, 0.0])
X, _, Z = np.eye(3)
TIP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # the slider's tip frame: its x is the world's z


def _rod() -> np.ndarray:
    return np.array([[4e-3, 5e-4, -3e-4], [5e-4, 3.1e-2, 2e-4], [-3e-4, 2e-4, 2.9e-2]])


class Moving(NamedTuple):
    """What moves, and its first and second derivatives by the crank's angle.

    Attributes:
        place: of the slider on its line [m].
        pin: the crank's end [m].
        turn: the rod's attitude, a matrix.
        spin: the rod's angular velocity per unit of the angle's rate, and that once more.
    """

    place: tuple[float, float, float]
    pin: tuple[np.ndarray, np.ndarray, np.ndarray]
    turn: tuple[np.ndarray, np.ndarray, np.ndarray]
    spin: tuple[np.ndarray, np.ndarray]


def _vector(W: np.ndarray) -> np.ndarray:
    """Return w of the skew part of a matrix, which is w x."""
    return 0.5 * np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]])


@dataclass(frozen=True)
class SliderCrank:
    """Sizes and masses; the rod's axes have x from the slider to the crank, its origin is C.

    Attributes:
        radius, crank_inertia: of the crank, about its axis [m, kg m^2].
        length, behind: of the rod, and from the slider to C [m].
        rod_mass, rod_com, rod_inertia: from C, and about the mass centre.
        slider_mass: [kg].
        line: y and z of the slider's line [m].
        stiffness, rest: of the spring on the slider [N/m, m].
        damping, sliding: of the crank's joint and of the slider's [N m s/rad, N s/m].
    """

    radius: float = 0.2
    crank_inertia: float = 0.03
    length: float = 0.7
    behind: float = 0.3
    rod_mass: float = 1.3
    rod_com: tuple[float, float, float] = (0.04, 0.03, -0.02)
    rod_inertia: np.ndarray = field(default_factory=_rod)
    slider_mass: float = 0.8
    line: tuple[float, float] = (0.05, 0.15)
    stiffness: float = 120.0
    rest: float = 0.6
    damping: float = 0.02
    sliding: float = 0.6

    def at(self, angle: float) -> Moving:
        """Return places, axes and their derivatives."""
        c, s, r = np.cos(angle), np.sin(angle), self.radius
        pin, pin_1, pin_2 = (r * np.array(e) for e in ((c, s, 0.0), (-s, c, 0.0), (-c, -s, 0.0)))
        y, z = self.line
        across = self.length**2 - (pin[1] - y) ** 2 - (pin[2] - z) ** 2
        place = pin[0] + np.sqrt(across)
        rod = pin - [place, y, z]  # of constant length
        place_1 = rod @ pin_1 / rod[0]
        rod_1 = pin_1 - place_1 * X
        place_2 = (rod_1 @ rod_1 + rod @ pin_2) / rod[0]
        rod_2 = pin_2 - place_2 * X
        x, x_1, x_2 = (e / self.length for e in (rod, rod_1, rod_2))
        # of the rod's y: along n = c x x, whose length is l
        n, n_1, n_2 = (np.cross(Z, e) for e in (x, x_1, x_2))
        l = np.linalg.norm(n)
        y, l_1 = n / l, n @ n_1 / l
        y_1 = (n_1 - l_1 * y) / l
        l_2 = y_1 @ n_1 + y @ n_2
        y_2 = (n_2 - l_2 * y - 2 * l_1 * y_1) / l
        z = np.cross(x, y)
        z_1 = np.cross(x_1, y) + np.cross(x, y_1)
        z_2 = np.cross(x_2, y) + 2 * np.cross(x_1, y_1) + np.cross(x, y_2)
        R, R_1, R_2 = (np.column_stack(axes) for axes in ((x, y, z), (x_1, y_1, z_1), (x_2, y_2, z_2)))
        spins = _vector(R_1 @ R.T), _vector(R_2 @ R.T + R_1 @ R_1.T)
        return Moving((place, place_1, place_2), (pin, pin_1, pin_2), (R, R_1, R_2), spins)

    def acceleration(self, angle: float, rate: float, torque: float, push: Callable[[float, float], float]) -> float:
        """Return the crank's [rad/s^2], under its torque and a force on the slider, a function of place and speed."""
        at = self.at(angle)
        place, place_1, place_2 = at.place
        lever = np.array([self.behind - self.length, 0, 0]) + self.rod_com  # from the pin to the mass centre
        way, bend = (pin + R @ lever for pin, R in zip(at.pin[1:], at.turn[1:], strict=True))
        spin, spin_1 = at.spin
        I = at.turn[0] @ self.rod_inertia @ at.turn[0].T
        M = self.crank_inertia + self.slider_mass * place_1**2 + self.rod_mass * way @ way + spin @ I @ spin
        N = self.slider_mass * place_1 * place_2 + self.rod_mass * way @ bend + spin @ I @ spin_1
        speed = place_1 * rate
        on_slider = push(place, speed) - self.sliding * speed - self.stiffness * (place - self.rest)
        load = torque - self.damping * rate + place_1 * on_slider + self.rod_mass * way @ GRAVITY
        return float((load - N * rate**2) / M)

    def motion(
        self, angle: float, rate: float, torque: Callable[[float], float], push: Callable[[float, float], float], times
    ) -> np.ndarray:
        """Return angle and rate at the times [s], (times, 2)."""
        found = solve_ivp(
            lambda t, y: [y[1], self.acceleration(*y, torque(t), push)],
            (0.0, times[-1]), [angle, rate], "DOP853", times, rtol=1e-13, atol=1e-14,
        )  # fmt: skip
        return found.y.T

    def state(self, angle: float, rate: float) -> State:
        """Return the whole mechanism where the crank is."""
        at = self.at(angle)
        lever = np.array([self.behind - self.length, 0, 0])
        pose = Pose(at.turn[0], at.pin[0] + at.turn[0] @ lever)
        twist = rate * np.concatenate([at.spin[0], at.pin[1] + at.turn[1] @ lever])
        return State([angle, at.place[0]], [rate, at.place[1] * rate], pose, twist)

    def chain(self) -> ClosedChain:
        """Return the mechanism in space: the rod is the object, crank and slider hold it."""
        crank = Arm(
            [Joint("revolute", (0, 0, 1), damping=self.damping)],
            [Link(1.0, (0, 0, 0), self.crank_inertia * np.eye(3))],
            tip=Pose.translation(self.radius, 0, 0),
        )
        slides = Joint("prismatic", (1, 0, 0), damping=self.sliding, stiffness=self.stiffness, rest=self.rest)
        slider = Arm([slides], [Link(self.slider_mass)], tip=Pose(TIP, (0, 0, 0)), base=Pose.translation(0, *self.line))
        grasps = {
            "crank": Grasp("ball", Pose.translation(self.length - self.behind, 0, 0)),
            "slider": Grasp("universal", Pose.translation(-self.behind, 0, 0)),
        }
        rod = HeldObject(self.rod_mass, self.rod_inertia, self.rod_com)
        return ClosedChain({"crank": crank, "slider": slider}, rod, grasps, GRAVITY)
