"""Simulation of a forest by the classical Runge-Kutta scheme, projected onto its closures after every step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_balance import kinetic_energy, potential_energy, power_into
from holdfast.dynamics.tree.forest_closing import FOREST_CLOSED, forest_close
from holdfast.dynamics.tree.forest_dynamics import forest_arguments, solved_forest
from holdfast.dynamics.tree.forest_gaps import position_gaps, require_closed, velocity_gaps
from holdfast.dynamics.tree.forest_projection import ClosingRound, closing_round, closing_rounds
from holdfast.dynamics.tree.varied_forest import ForestArguments, position_rates, unit_quaternions
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar

MOST_FOREST_STEPS = 100_000
ForestLaw = Callable[[float, Array, Array], ArrayLike]


@called
@dataclass(frozen=True, eq=False)
class ForestRun(Frozen):
    """A motion of a forest.

    Attributes:
        t: (steps + 1,) times [s].
        q: (steps + 1, n_q) positions.
        qd: (steps + 1, n_v) rates.
    """

    t: Array
    q: Array
    qd: Array


class ForestInstant(NamedTuple):
    """What a step of a run needs of a forest at one time.

    Attributes:
        qdd: (n_v,) accelerations.
        q_rates: (n_q,) dq/dt.
        power: (4,) power of drives, dampers, bases and wrenches [W].
        closure_wrench: (closures, 6) wrenches of the closures.
        coupling_force: (couplings,) forces of the couplings.
        unique: whether the forces are unique.
        condition: dimensionless condition number of the constraint; see `ForestResult`.
        rank: rank of the constraint.
    """

    qdd: Array
    q_rates: Array
    power: Array
    closure_wrench: Array
    coupling_force: Array
    unique: bool
    condition: float
    rank: int


class ForestAccount(NamedTuple):
    """What is recorded of a forest at one time, besides its motion.

    Attributes:
        closure_wrench, coupling_force: as of `ForestInstant`; the smallest, if they are not unique.
        position_gap: the largest gap in position [m and rad].
        velocity_gap: the largest gap in velocity.
        kinetic, potential: energies [J].
    """

    closure_wrench: Array
    coupling_force: Array
    position_gap: float
    velocity_gap: float
    kinetic: float
    potential: float


class StepEngine(Protocol):
    """How a step evaluates a forest: by the reference, by machine code, or as part of the code of the whole step."""

    def instant(self, given: ForestArguments) -> ForestInstant:
        """Return what a step needs at one time."""
        ...

    def closed(self, q: Array, qd: Array) -> tuple[Array, Array, tuple[Scalar, Scalar]]:
        """Return closed positions and rates near some, and the largest gaps in position and velocity before."""
        ...


class ForestEngine(StepEngine, Protocol):
    """How a run evaluates a forest: by the reference or by machine code."""

    def account(self, given: ForestArguments, now: ForestInstant) -> ForestAccount:
        """Return what is recorded of an instant."""
        ...

    def margins(self, x: Array, rates: Array, tau: Array, wrenches: Array) -> Array | None:
        """Return the margins of the closures at several points, (points, closures), infinite without a limit [N].

        Args:
            x: (points, n_q) positions, whose quaternions need not be of unit length, and which are nearly closed.
            rates: (points, n_q) dq/dt.
            tau: (points, n_v) torques of drives.
            wrenches: (bodies, 6) external wrenches.

        Returns:
            None if there is no faster way to find them than `instant` and `account`.
        """
        ...


class ForestReference(NamedTuple):
    """The reference as the engine of a run."""

    forest: Forest

    def instant(self, given: ForestArguments) -> ForestInstant:
        """See `ForestEngine`."""
        motion, _, found = solved_forest(given, check=False)
        rates, power = position_rates(given.forest, given.q, given.qd), np.array(power_into(given, motion))
        forces = found.closure_wrench, found.coupling_force
        return ForestInstant(found.qdd, rates, power, *forces, found.status is Status.OK, found.condition, found.rank)

    def closed(self, q: Array, qd: Array) -> tuple[Array, Array, tuple[Scalar, Scalar]]:
        """See `ForestEngine`."""
        return closed_near(partial(closing_round, self.forest), self.forest, q, qd)

    def account(self, given: ForestArguments, now: ForestInstant) -> ForestAccount:
        """See `ForestEngine`."""
        numbers = checks.finite(np.array(gaps_and_energies(given)), "the balance of the forest")
        return ForestAccount(now.closure_wrench, now.coupling_force, *numbers.tolist())

    def margins(self, x: Array, rates: Array, tau: Array, wrenches: Array) -> Array | None:
        """See `ForestEngine`."""
        return None


def gaps_and_energies(given: ForestArguments) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Return the largest gaps in position and velocity, and the kinetic and the potential energy. O(bodies)."""
    motion = given.motion({})
    gaps = position_gaps(motion, given.q).largest, velocity_gaps(motion, given.qd).largest
    return *gaps, kinetic_energy(motion, given.qd), potential_energy(motion, given.q)


class ForestSample(NamedTuple):
    """A forest at one time.

    Attributes:
        t: time [s].
        given: its arguments.
        now: its accelerations.
    """

    t: float
    given: ForestArguments
    now: ForestInstant


class ForestStep(NamedTuple):
    """A step of a forest, closed.

    Attributes:
        q: (n_q,) positions at its end.
        qd: (n_v,) rates there.
        work: (4,) work during the step, in the order of the power, by the same weights as the motion [J].
        drift: the largest gaps in position and velocity before it was closed.
        estimates: the scheme's estimates of the error of (q, qd, work), (n_q + n_v + 4,) each.
    """

    q: Array
    qd: Array
    work: Array
    drift: tuple[Scalar, Scalar]
    estimates: list[Array]


Acting = Callable[[float, Array, Array], ForestArguments]  # of t, q and qd
Slope = Callable[[float, Array], Array]  # of the time and the increment since the start
Scheme = Callable[[Array, float, Slope], tuple[Array, list[Array]]]


def classical(first: Array, h: float, slope: Slope) -> tuple[Array, list[Array]]:
    """Return the increment of the classical Runge-Kutta scheme, and no estimates of its error.

    Args:
        first: slope at the start.
        h: the step's length [s].
        slope: function of the time and the increment since the start.
    """
    b = slope(0.5 * h, 0.5 * h * first)
    c = slope(0.5 * h, 0.5 * h * b)
    d = slope(h, h * c)
    return h / 6.0 * (first + 2.0 * b + 2.0 * c + d), []


def forest_step(
    engine: StepEngine, acting: Acting, start: ForestSample, until: Scalar, scheme: Scheme = classical
) -> ForestStep:
    """Return one step of a forest.

    Where some rows follow from others, they contradict each other beside closed states. The stages of a step are then
    closed, too, which is the same scheme for accelerations that depend on the nearest closed state.

    Args:
        engine: evaluates the forest.
        acting: returns the arguments of the forest at a time and state.
        start: the forest before the step.
        until: time at the end of the step [s].
        scheme: returns the increment of (q, qd, work) and estimates of its error.

    Raises:
        ClosureError: the step cannot be closed.
        StateError: it overflows.
        SingularChainError: no accelerations satisfy the closures.
    """
    forest = start.given.forest
    n_q, n_v, t = forest.position_count, forest.velocity_count, start.t
    x = np.concatenate([start.given.q, start.given.qd, np.zeros(4)])

    def slope(later: float, y: Array) -> Array:
        _require_finite(y)
        q, qd = unit_quaternions(forest, (x + y)[:n_q]), (x + y)[n_q : n_q + n_v]
        if not start.now.unique:
            q, qd, _ = engine.closed(q, qd)
        return _rates(engine.instant(acting(t + later, q, qd)))

    y, estimates = scheme(_rates(start.now), until - t, slope)
    _require_finite(y)
    moved = x + y
    q, qd, drift = engine.closed(unit_quaternions(forest, moved[:n_q]), moved[n_q : n_q + n_v])
    return ForestStep(q, qd, y[n_q + n_v :], drift, estimates)


def _require_finite(y: Array) -> None:
    if y.dtype != object and not np.isfinite(y).all():  # of traced numbers, a status says so
        raise StateError("the step overflows float64; try a smaller time step")


def _rates(now: ForestInstant) -> Array:
    """Return the rates of positions, velocities and works."""
    return np.concatenate([now.q_rates, now.qdd, now.power])


def forest_steps(engine: ForestEngine, q: Array, qd: Array, acting: Acting, times: Array) -> Iterator[ForestSample]:
    """Yield a forest at given times, the first of which is the start; see `forest_simulate`.

    Args:
        engine: evaluates the forest.
        q: (n_q,) positions at the start.
        qd: (n_v,) rates at the start.
        acting: returns the arguments of the forest at a time and state.
        times: (steps + 1,) increasing times [s].
    """
    given = acting(float(times[0]), q, qd)
    require_closed(given.motion({}), q, qd)
    sample = ForestSample(float(times[0]), given, engine.instant(given))
    yield sample
    for t in times[1:].tolist():
        step = forest_step(engine, acting, sample, t)
        given = acting(t, step.q, step.qd)
        sample = ForestSample(t, given, engine.instant(given))
        yield sample


def closed_near(
    closing: Callable[[Array, Array], ClosingRound], forest: Forest, q: Array, qd: Array
) -> tuple[Array, Array, tuple[float, float]]:
    """Return closed positions and rates near some, and the largest gaps in position and velocity before.

    Args:
        closing: takes a round, `closing_round` or its machine code.
        forest: bodies, closures and couplings.
        q: (n_q,) positions with unit quaternions.
        qd: (n_v,) rates.

    Raises:
        ClosureError: they cannot be closed from there.
    """
    rounds = [*closing_rounds(closing, q, qd)]
    first, last = rounds[0], rounds[-1]
    closed = last if last.position_gap <= FOREST_CLOSED else forest_close(forest, q, qd)
    return closed.q, closed.qd, (float(first.position_gap), float(first.velocity_gap))


@np.errstate(all="ignore")  # what overflows is refused
def forest_simulate(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    torque: ForestLaw | None = None,
    *,
    duration: float,
    step: float,
) -> ForestRun:
    """Return a motion of a forest in fixed steps, O(n) per step as `forest_dynamics`.

    The scheme has fourth order. After every step, positions and rates are brought back to closures and couplings by the
    smallest changes in the kinetic metric, in O(n), and by `forest_close` where this does not close them.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions at the start.
        qd: (n_v,) rates at the start.
        torque: function of time [s], q and qd that returns (n_v,) torques [N m or N]; None for none.
        duration: [s].
        step: the longest step [s]; a whole number of equal steps is taken.

    Raises:
        StateError: a shape is wrong, or the state violates a closure or a coupling.
        SingularChainError: no accelerations satisfy the closures.
        ClosureError: a step leaves the closures too far open.
    """
    given = forest_arguments(forest, q, qd)
    n = forest.velocity_count
    total, longest = checks.number(duration, "duration", above=0.0), checks.number(step, "step", above=0.0)
    if not total <= MOST_FOREST_STEPS * longest:
        raise StateError(f"step: expected at most {MOST_FOREST_STEPS} steps, got {total:g} s in steps of {longest:g} s")
    count = math.ceil(total / longest - 1e-9)
    h = total / count

    def acting(t: float, at: Array, rates: Array) -> ForestArguments:
        tau = np.zeros(n) if torque is None else checks.numbers(torque(t, at, rates), (n,), "torque", StateError)
        return ForestArguments(forest, at, rates, tau, given.wrenches)

    samples = [*forest_steps(ForestReference(forest), given.q, given.qd, acting, h * np.arange(count + 1))]
    reached = [(sample.given.q, sample.given.qd) for sample in samples]
    return ForestRun(np.array([sample.t for sample in samples]), *(np.array(x) for x in zip(*reached, strict=True)))
