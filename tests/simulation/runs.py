"""Runs of one stepper, step by step, and what is asked of them: closure and energy.

Every function takes the stepper, so that whatever takes steps is held to the same laws.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from holdfast import ClosedChain, State, forward_dynamics, holding_torques
from holdfast.control import GravityCompensation
from holdfast.dynamics import closure, kinetic_energy, potential_energy
from holdfast.simulation.adaptive import Tolerance, first_proposal, next_step
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant, evaluate
from holdfast.simulation.runge_kutta import RK4, Tableau
from holdfast.simulation.stepper import ReferenceStepper, Stepper
from holdfast.spatial import rotation
from tests.systems.problems import largest_gaps

# (environment, controller, generic rank, scheme, tolerance) -> stepper
MakeStepper = Callable[..., Stepper]


def limp(t: float, state: State, memory: Any) -> tuple[np.ndarray, Any]:
    """No torques at all."""
    return np.zeros(len(state.q)), memory


def assert_held_still(chain: ClosedChain, state: State, controlled: bool) -> None:
    """Assert that a chain at rest stays there under `GravityCompensation`, or under `holding_torques`."""
    still = State(state.q, np.zeros(len(state.q)), state.object_pose)
    tau = GravityCompensation(chain)(0.0, still, None)[0] if controlled else holding_torques(chain, still)
    assert np.abs(forward_dynamics(chain, still, tau).qdd).max() < 1e-9 * np.abs(tau).max()


def stepper_of(
    chain: ClosedChain,
    state: State,
    scheme: Tableau = RK4,
    rtol: float = 1e-8,
    make: MakeStepper = ReferenceStepper,
    controller: Any = limp,
) -> tuple[Stepper, Instant]:
    """Return a stepper of the chain and where it starts, at t = 0."""
    environment = Environment(chain)
    generic = evaluate(environment, controller, 0.0, state, None).result.rank
    stepper = make(environment, controller, generic, scheme, Tolerance(rtol))
    return stepper, stepper.start(0.0, state, None)[0]


def fixed(stepper: Stepper, now: Instant, times: np.ndarray) -> Iterator[Instant]:
    """Yield the start and the instants at the times, a step each."""
    yield now
    for _, end in pairwise(times):
        (reached,) = stepper.advance(now, [float(end)])
        if reached.failure is not None:
            raise reached.failure
        assert reached.instant is not None
        now = reached.instant
        yield now


def adaptive(stepper: Stepper, now: Instant, until: float) -> Iterator[Instant]:
    """Yield the start and every accepted instant to a time."""
    yield now
    proposal = first_proposal(now)
    while now.t < until:
        reached, proposal = next_step(stepper, now, proposal, until)
        assert reached.instant is not None
        now = reached.instant
        yield now


@dataclass
class Balances:
    """The worst values of a run.

    Attributes:
        position, velocity: worst gap of any grasp [m or rad, m/s or rad/s].
        drift: largest change of T + V [J]; nothing but gravity may do work.
        peak_kinetic: largest T [J].
        peak_rate: fastest joint [rad/s or m/s].
        steps: how many.
        last: where it ended.
    """

    position: float = 0.0
    velocity: float = 0.0
    drift: float = 0.0
    peak_kinetic: float = 0.0
    peak_rate: float = 0.0
    steps: int = -1
    last: Instant | None = None

    @property
    def end(self) -> np.ndarray:
        """(2 n + 13,) the last state."""
        assert self.last is not None
        return numbers(self.last.state)

    def __str__(self) -> str:
        """Return one line of figures."""
        return (
            f"{self.steps} steps, rates to {self.peak_rate:.1f}; open {self.position:.1e} m or rad,"
            f" {self.velocity:.1e} m/s or rad/s; energy {self.drift / self.peak_kinetic:.1e} of"
            f" {self.peak_kinetic:.3g} J"
        )


def balances_of(instants: Iterator[Instant]) -> Balances:
    """Return the balances of a run."""
    balances, energy = Balances(), None
    for at in instants:
        position, velocity = largest_gaps(closure(at.chain, at.state, at.inputs)).tolist()
        balances.position, balances.velocity = max(balances.position, position), max(balances.velocity, velocity)
        T = kinetic_energy(at.chain, at.state, at.inputs)
        total = T + potential_energy(at.chain, at.state)
        energy = total if energy is None else energy
        balances.drift = max(balances.drift, abs(total - energy))
        balances.peak_kinetic = max(balances.peak_kinetic, T)
        balances.peak_rate = max(balances.peak_rate, float(np.abs(at.state.qd).max()))
        balances.steps, balances.last = balances.steps + 1, at
    return balances


def differences(a: State, b: State) -> np.ndarray:
    """Return the largest difference of positions [rad or m] and of velocities, (2,); joint angles modulo a turn."""
    turn = rotation.log(a.object_frame.R @ b.object_frame.R.T)
    joints = np.remainder(a.q - b.q + np.pi, 2 * np.pi) - np.pi
    positions = np.concatenate([joints, turn, a.object_pose[4:] - b.object_pose[4:]])
    velocities = np.concatenate([a.qd - b.qd, a.object_twist - b.object_twist])
    return np.array([np.abs(positions).max(), np.abs(velocities).max()])


def numbers(state: State) -> np.ndarray:
    """Return a state as one array, (2 n + 13,)."""
    return np.concatenate([state.q, state.qd, state.object_pose, state.object_twist])
