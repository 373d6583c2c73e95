"""Segments of a run: the time from one change of the grasps to the next, during which the chain stays the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from holdfast.control.controller import Controller, without_machine_code
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.consistency import require_closed
from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.dynamics.contact.sliding_hands import Hand
from holdfast.dynamics.rank import closed_near
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.adaptive_parts import RTOL_OF_PARTS as PARTS_RTOL
from holdfast.simulation.adaptive_parts import AdaptivePartsStepper, HalvedPartsStepper
from holdfast.simulation.balance import Sums
from holdfast.simulation.checkpoint import Origin
from holdfast.simulation.collocation import CollocationStepper
from holdfast.simulation.contact_signals import ContactSignals
from holdfast.simulation.contact_stepper import ContactStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.events import Event, Happened, Occurrence, happen
from holdfast.simulation.instant import Instant, evaluate
from holdfast.simulation.margins import Policy, Signals
from holdfast.simulation.run_record import RecordSettings
from holdfast.simulation.runge_kutta import IMEX, Tableau, dop853
from holdfast.simulation.sample import Samples, recorded, sample
from holdfast.simulation.stability import too_fast
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import Stepper, SubdividingStepper
from holdfast.simulation.stops import Stops
from holdfast.simulation.trajectory import Trajectory
from holdfast.simulation.verification import evaluation_times
from holdfast.simulation.zero_order_hold import AskedOnce, HeldTorques, ZeroOrderHold, held_torques_law, sampled
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

MakeStepper = Callable[[Environment, Controller, int, Tableau, Tolerance], Stepper]
MakeContactStepper = Callable[[Environment, Controller, int, Tableau, Tolerance, ContactModes], Stepper]


@dataclass(frozen=True, eq=False)
class RunSettings:
    """The settings that stay the same during a run.

    Attributes:
        environment: the chain at the start, its base motions and external inputs.
        controller: the controller at the start.
        hold: sample times of a sampled controller; None if the controller is evaluated at every stage.
        make_stepper: function of (environment, controller, generic rank, scheme, tolerance) that returns a stepper.
        scheme: Runge-Kutta scheme.
        tolerance: error tolerance of an adaptive scheme.
        largest_drift: largest drift of a step of fixed length, see `SubdividingStepper` [m or rad]; None for no limit.
        policy: what to do at violations and singular configurations.
        events: the events in order of time.
        stops: times at which steps must end.
        recording: what is recorded.
        by_impulses: whether contacts with the world are followed by steps with impulses instead of events.
        make_segment: makes the segments, `Segment` or a class derived from it.
        make_contacts: as `make_stepper`, of contacts in fixed modes besides.
    """

    environment: Environment
    controller: Controller
    hold: ZeroOrderHold | None
    make_stepper: MakeStepper
    scheme: Tableau
    tolerance: Tolerance
    largest_drift: float | None
    policy: Policy
    events: list[Event]
    stops: Stops
    recording: RecordSettings
    by_impulses: bool = False
    make_segment: Callable[..., Segment] = field(default_factory=lambda: Segment)
    make_contacts: MakeContactStepper = ContactStepper

    @property
    def end(self) -> float:
        """Time at which the run ends [s]."""
        return float(self.stops.times[-1])

    @cached_property
    def longest_step(self) -> float:
        """The longest step that a scheme of fixed steps takes [s]."""
        times, jumps = self.stops
        return float(np.diff(times, prepend=0.0)[~jumps].max())


@dataclass(frozen=True, eq=False)
class Segment:
    """The part of a run during which the same arms hold the object.

    Attributes:
        settings: settings of the run.
        environment: the chain with its current grasps, its base motions and external inputs.
        law: the controller.
        generic_rank: rank of the constraint away from singular configurations.
        implicit: whether steps are linearly implicit, because explicit ones could not follow the damping and springs.
        contacts: what the contacts with the world do; None without any.
        least_gap: (k,) gaps below which open contacts touch, see `ContactSignals`; None without contacts.
        hands: hands that slide, which have no grasps.
    """

    finds_singular: ClassVar[bool] = True  # whether singular configurations within steps are looked for

    settings: RunSettings
    environment: Environment
    law: Controller
    generic_rank: int
    implicit: bool = False
    contacts: ContactModes | None = None
    least_gap: Array | None = None
    hands: tuple[Hand, ...] = ()

    @cached_property
    def controller(self) -> Controller:
        """The controller that steps evaluate: the law, or for a sampled controller the law that holds its torques."""
        hold = self.settings.hold
        return self.law if hold is None else held_torques_law(self.environment.chain.joint_count)

    @property
    def scheme(self) -> Tableau:
        """The scheme of the steps."""
        return IMEX if self.implicit else self.settings.scheme

    @cached_property
    def stepper(self) -> Stepper:
        """The stepper of this segment; it subdivides steps of fixed length if `largest_drift` is given."""
        run = self.settings
        if self.contacts is not None:
            of = self.environment, self.controller, self.generic_rank, self.scheme, run.tolerance
            return run.make_contacts(*of, self.contacts)
        whole = run.make_stepper(self.environment, self.controller, self.generic_rank, self.scheme, run.tolerance)
        if run.scheme.adaptive or run.largest_drift is None:
            return whole
        return SubdividingStepper(whole, run.largest_drift)

    @cached_property
    def collocation(self) -> CollocationStepper:
        """The stepper for steps through singular configurations."""
        return CollocationStepper(self.stepper)

    @cached_property
    def varied_parts(self) -> Stepper:
        """The stepper that divides a fixed step near a singular configuration into parts of different lengths."""
        if self.implicit or self.settings.scheme.implicit or self.contacts is not None:
            return HalvedPartsStepper(self.stepper)
        make = self.settings.make_stepper
        return AdaptivePartsStepper(
            make(self.environment, self.controller, self.generic_rank, dop853(), Tolerance(PARTS_RTOL))
        )

    @cached_property
    def signals(self) -> Signals:
        """The margins of the chain, and the signals of its contacts."""
        if self.least_gap is not None:
            return ContactSignals(self.environment.chain, self.least_gap, self.hands)
        return Signals(self.environment.chain)

    @cached_property
    def acting(self) -> Array:
        """Indices of the signals that end a step when they become negative."""
        return self.settings.policy.acting(self.signals)

    @cached_property
    def of_modes(self) -> list[int]:
        """Those at which contacts change their modes."""
        return [i for i in self.acting.tolist() if i not in self.signals.logged]

    def evaluation_times(self, begin: float, end: float) -> list[float]:
        """Return the times after `begin` at which the margins of a step to `end` are evaluated [s]."""
        return evaluation_times(begin, end, self.scheme.c.tolist()) if len(self.signals.limited) else [end]

    def require_closed(self, start: Origin) -> None:
        """Refuse a start that violates a grasp.

        Raises:
            StateError: naming the gap.
        """
        chain, inputs = self.environment.at(start.t, start.state)
        tau = np.zeros(chain.joint_count)
        require_closed(chain_motion(chain, start.state, tau, inputs.shaped(chain)), start.state)

    def rank_near(self, start: Origin) -> int:
        """Return the rank of the constraint at the start, projected onto the grasps.

        Raises:
            StateError: the controller's torques have a wrong shape or are not finite.
            SingularChainError: the configuration is singular.
        """
        chain, inputs = self.environment.at(start.t, start.state)
        state = closed_near(chain, start.state, inputs) or start.state
        with without_machine_code():
            return evaluate(self.environment, self.controller, start.t, state, start.memory).result.rank

    def too_fast(self, t: float, state: State) -> str | None:
        """Return why explicit steps are too long for the joints; None if they are not."""
        return too_fast(self.environment.chain_at(t), state, self.settings.longest_step, self.scheme)

    def happen(self, event: Event, chain: ClosedChain, state: State, inputs: Inputs) -> Happened:
        """Return the chain and the state just after an event, and the entry for the log; see `events.happen`."""
        return happen(event, chain, state, inputs)

    def sample(
        self, at: Instant, gaps: Gaps, sums: Sums, times: Array, margins: Array, happened: tuple[Occurrence, ...]
    ) -> Trajectory:
        """Return the run of one sample; see `sample.sample`."""
        accounts, names = self.stepper.accounts, self.settings.recording.names
        return sample(self.environment, accounts, at, gaps, sums, times, margins, names, happened)

    def recorded(self, samples: Samples, sums: Sums) -> Trajectory:
        """Return the run of several samples, between which nothing has happened; see `sample.recorded`."""
        return recorded(self.environment, self.stepper.accounts, samples, sums, self.settings.recording.names)

    def at(self, origin: Origin) -> Instant:
        """Return the instant of an accepted time, state and memory, without projection."""
        return self.stepper.evaluate(origin.t, origin.state, origin.memory)

    def sampled(self, t: float, state: State, held: HeldTorques | None, acting: Any) -> tuple[HeldTorques | None, Any]:
        """Return the zero-order hold of a sampled controller at a time, and the memory that steps pass to it.

        Without a zero-order hold, both are returned unchanged.

        Args:
            t: time [s].
            state: positions and velocities at that time.
            held: the hold before.
            acting: the memory of the steps before; for a sampled controller these are the torques that act.

        Raises:
            StateError: the controller does not return valid torques and memory.
        """
        hold = self.settings.hold
        if hold is None or held is None:
            return held, acting
        return sampled(hold, self._asked_once, t, state, held, acting)

    @cached_property
    def _asked_once(self) -> AskedOnce:
        return AskedOnce(self.law)

    def margins(self, at: Instant) -> Array:
        """Return all margins at an instant, (signals,)."""
        return self.margins_of([at])[0]

    def margins_of(self, instants: Sequence[Instant]) -> Array:
        """Return all margins at several instants, (instants, signals); without limits nothing is computed."""
        if len(self.signals.limited):
            return self.signals.of_each(instants)
        return np.full((len(instants), len(self.signals)), np.inf)


def first_segment(settings: RunSettings, start: Origin) -> Segment:
    """Return the first segment of a run.

    Raises:
        StateError: the state violates a grasp, or the controller's torques have a wrong shape or are not finite.
        SingularChainError: the configuration is singular.
    """
    # the generic rank is determined with neighbouring configurations; later, any lower rank is a singularity
    segment = settings.make_segment(settings, settings.environment, settings.controller, -1)
    segment.require_closed(start)
    return replace(segment, generic_rank=segment.rank_near(start))


def segment_with(before: Segment, grasps: Mapping[Any, Grasp], start: Origin, hands: tuple[Hand, ...] = ()) -> Segment:
    """Return the segment that begins when grasps close or open, or hands slide.

    Raises:
        SingularChainError: the configuration is singular with these grasps.
    """
    segment = resumed_segment(before.settings, grasps, -1, before.implicit, hands)
    return replace(segment, generic_rank=segment.rank_near(start))


def suited(segment: Segment, t: float, state: State) -> tuple[Segment, tuple[Occurrence, ...]]:
    """Return the segment, made linearly implicit if explicit steps are too long for its joints, and log entries.

    Args:
        segment: the segment.
        t: time [s].
        state: positions and velocities at that time.
    """
    why = segment.too_fast(t, state)
    if why is None:
        return segment, ()
    text = f"steps are linearly implicit from here ({IMEX.name}): {why}"
    return replace(segment, implicit=True), (Occurrence(t, "stiff", "joints", text),)


def resumed_segment(
    settings: RunSettings,
    grasps: Mapping[Any, Grasp],
    generic_rank: int,
    implicit: bool,
    hands: tuple[Hand, ...] = (),
) -> Segment:
    """Return the segment with the given grasps, generic rank, kind of steps, and hands that slide.

    If the controller has a method `for_chain(chain)`, the segment uses the controller that this method returns; a law
    does not notice that a hand slides.
    """
    chain = replace(settings.environment.chain, grasps=grasps)
    law, believed = settings.controller, chain
    if hands:
        held = {**grasps, **{hand.arm: hand.grasp for hand in hands}}
        believed = replace(chain, grasps={name: held[name] for name in chain.names if name in held})
    for_chain = getattr(law, "for_chain", None)
    if for_chain is not None:
        law = for_chain(believed)
    environment = replace(settings.environment, chain=chain)
    return settings.make_segment(settings, environment, law, generic_rank, implicit, hands=hands)
