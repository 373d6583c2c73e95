"""Random bars on parallel cranks, pivots on one line: they pass singular configurations where the cranks lie along it.

As long as it stays a parallelogram its motion is that of one angle, I w' = -g d/d(angle) of the height of all masses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State, close
from tests.systems.five_bar import ACROSS

GRAVITY = 9.81


@dataclass(frozen=True)
class ParallelCranks:
    """A mechanism, and its one equation.

    Attributes:
        chain: cranks and bar in space.
        state: where it starts.
        inertia: of the motion as a parallelogram [kg m^2].
        moment: of all masses, times 1, in the crank's axes [kg m].
        along: angle of the line of the pivots [rad].
        angle: of the cranks at the start [rad].
        rate: of the cranks at the start [rad/s].
    """

    chain: ClosedChain
    state: State
    inertia: float
    moment: complex
    along: float
    angle: float
    rate: float

    def slope(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return d/dt of angle and rate."""
        turning = -GRAVITY * (self.moment * 1j * np.exp(1j * y[0])).imag / self.inertia
        return np.array([y[1], turning])

    def motion(self, duration: float) -> tuple[float, np.ndarray]:
        """Return the angle after a time, and when the cranks have lain along the line of their pivots [s]."""

        def aligned(t: float, y: np.ndarray) -> float:
            return np.sin(y[0] - self.along)

        begin = np.array([self.angle, self.rate])
        options = {"rtol": 1e-12, "atol": 1e-13, "max_step": 0.05}
        found = solve_ivp(self.slope, (0.0, duration), begin, "DOP853", events=aligned, **options)
        return float(found.y[0, -1]), found.t_events[0]


def parallel_cranks(seed: int, longer: float = 0.0) -> ParallelCranks:
    """Return two to four cranks that will soon lie along the line of their pivots.

    Args:
        seed: of the random numbers.
        longer: of two cranks: by how much the second one is longer, which then is no parallelogram [m].
    """
    random = np.random.default_rng(seed)
    count = 2 if longer else int(random.integers(2, 5))
    along, length = random.uniform(-3.0, 3.0), random.uniform(0.4, 1.0)
    angle = along + random.choice([0.0, np.pi]) + random.choice([-1.0, 1.0]) * random.uniform(0.2, 0.6)
    towards = -np.sign(np.sin(angle - along) * np.cos(angle - along))
    rate = towards * random.uniform(2.0, 4.0)
    pivots = np.exp(1j * along) * (np.cumsum(random.uniform(0.3, 0.8, size=count)) - random.uniform(0.0, 1.0))
    middle = pivots.mean() + complex(*random.uniform(-0.2, 0.2, size=2))
    inertia, moment, arms, grasps = 0.0, 0.0, {}, {}
    for i, pivot in enumerate(pivots):
        mass, own = random.uniform(0.5, 2.0), random.uniform(0.02, 0.1)
        centre = length * complex(random.uniform(0.3, 0.6), random.uniform(-0.1, 0.1))
        tip = length + longer * (i == 1)
        link = Link(mass, (centre.real, centre.imag, 0), np.diag([own / 2, own, own]))
        base = Pose(np.eye(3), (pivot.real, pivot.imag, 0))
        arms[f"crank{i}"] = Arm([Joint("revolute", (0, 0, 1))], [link], tip=Pose(ACROSS, (tip, 0, 0)), base=base)
        at = pivot - middle
        grasps[f"crank{i}"] = Grasp("hinge", Pose(ACROSS, (at.real, at.imag, 0)))
        inertia += own + mass * abs(centre) ** 2
        moment += mass * centre
    mass, own = random.uniform(0.5, 4.0), random.uniform(0.05, 0.3)
    chain = ClosedChain(arms, HeldObject(mass, np.diag([own / 2, own, own])), grasps, gravity=(0, -GRAVITY, 0))
    body, turned = middle + length * np.exp(1j * angle), np.exp(1j * angle)
    moving = 1j * rate * length * turned
    state = State(
        np.full(count, angle),
        np.full(count, rate),
        [1, 0, 0, 0, body.real, body.imag, 0],
        [0, 0, 0, moving.real, moving.imag, 0],
    )
    state = close(chain, state) if longer else state
    return ParallelCranks(chain, state, inertia + mass * length**2, moment + mass * length, along, angle, float(rate))
