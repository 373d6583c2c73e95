"""The zero-order hold of `control.sampled` in a run: the controller is called once per sample.

Between two samples the torques are data, not a function of time or state. Steps receive them as the memory of
`held_torques_law`. Whole steps are therefore machine code for any controller, and neither stages nor evaluations inside
a step nor repeated steps call the controller.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.control.controller import ControlLaw, Controller, GivenLaw, torques_and_memory
from holdfast.control.sampled import SampledTorque
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.simulation.stops import ALIKE, MOST_STEPS
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State, parts_of

MOST_KNOWN = 512  # samples


@dataclass(frozen=True, eq=False)
class ZeroOrderHold:
    """The times at which a sampled controller is called, and at which its torques begin to act.

    Attributes:
        sample_time: time between two samples [s].
        delay: time from a sample until its torques act [s].
        asked: (k,) times at which the controller is called, beginning with 0 [s].
        acts: (k,) times from which its torques act [s]; 0 for the first, infinity for torques that would act only after
            the run's end.
    """

    sample_time: float
    delay: float
    asked: Array
    acts: Array

    @property
    def jumps(self) -> list[float]:
        """Times at which the torques jump [s]."""
        return [float(t) for t in self.acts if 0.0 < t < np.inf]


@dataclass(frozen=True, eq=False)
class HeldTorques:
    """The state of a sampled controller.

    Attributes:
        asked: number of times that the controller has been called.
        memory: memory that the controller returned last.
        waiting: torques (n,) that do not act yet, the oldest first.
        sample_time: sample time of the hold [s].
        delay: delay of the hold [s].
    """

    asked: int
    memory: Any
    waiting: tuple[Array, ...]
    sample_time: float
    delay: float


def at_samples(controller: Any, sample_time: float | None, delay: float) -> tuple[Any, float | None, float]:
    """Return the controller that is called at samples, the sample time and the delay.

    Args:
        controller: any controller; one that `control.sampled` returned brings its sample time and delay.
        sample_time: time between two samples [s], or None.
        delay: time from a sample until its torques act [s].

    Raises:
        ModelError: a sample time or a delay is given for a law that has its own.
    """
    law = controller.law if isinstance(controller, GivenLaw) else controller
    if not isinstance(law, ControlLaw) or not isinstance(law.torque, SampledTorque):
        return controller, sample_time, delay
    own = law.torque
    if sample_time is not None or delay != 0.0:
        raise ModelError(
            f"simulation: sample_time, delay: expected none beside a sampled law, which has {own.sample_time:g} s and"
            f" {own.delay:g} s, got {sample_time!r} and {delay!r}; try the law that was sampled"
        )
    inner, memory = own.law, law.memory[: len(own.law.memory)]
    if not np.array_equal(memory, inner.memory):  # another stream of random numbers
        inner = replace(inner, memory=memory)
    found = inner if law is controller else replace(controller, law=inner)
    return found, own.sample_time, own.delay


def zero_order_hold(
    sample_time: float | None, delay: float, duration: float, declared: Sequence[float]
) -> ZeroOrderHold | None:
    """Return the zero-order hold of a run; None if the controller is evaluated at every stage.

    Args:
        sample_time: time between two samples [s]; None to evaluate the controller at every stage of every step.
        delay: time from a sample until its torques act [s].
        duration: duration of the run [s].
        declared: times of events and breakpoints [s]; samples that differ from them by rounding are moved to them.

    Raises:
        ModelError: the sample time or the delay is invalid.
    """
    delay = checks.number(delay, "simulation: delay", at_least=0.0)
    if sample_time is None:
        if delay > 0.0:
            raise ModelError(
                f"simulation: delay: expected a sample_time with it, got {delay:g} s alone; a controller that is asked"
                " all along has none: try sample_time=1e-3"
            )
        return None
    period = checks.number(sample_time, "simulation: sample_time", above=0.0)
    if duration / period > MOST_STEPS:
        raise ModelError(
            f"simulation: sample_time: expected at most {MOST_STEPS} samples, got {duration / period:.3g}; try a larger"
            " sample_time"
        )
    if delay >= duration:
        raise ModelError(
            f"simulation: delay: expected less than the duration {duration:g} s, got {delay:g} s: no torques but the"
            " first would act"
        )
    apart = ALIKE * period
    count = max(1, int(np.ceil(duration / period * (1.0 - ALIKE))))
    asked = period * np.arange(count)
    whole = round(delay / period)
    steady = abs(delay - whole * period) <= apart
    acts = period * (np.arange(count) + whole) if steady else asked + delay
    acts[0] = 0.0
    acts[acts > duration - apart] = np.inf
    at = np.unique(checks.numbers(list(declared), (len(declared),), "simulation: breakpoints"))
    return ZeroOrderHold(period, delay, _brought_to(at, asked, apart), _brought_to(at, acts, apart))


def _brought_to(at: Array, times: Array, apart: float) -> Array:
    """Return `times`, each replaced by the entry of the sorted array `at` from which it differs by at most `apart`."""
    if not len(at):
        return times
    right = np.clip(np.searchsorted(at, times), 0, len(at) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(at[left] - times) < np.abs(at[right] - times), at[left], at[right])
    return np.where(np.abs(nearest - times) <= apart, nearest, times)


def initial_hold(hold: ZeroOrderHold | None) -> HeldTorques | None:
    """Return the state of a sampled controller that has not been called yet; None without a hold."""
    return None if hold is None else HeldTorques(0, None, (), hold.sample_time, hold.delay)


def require_same(hold: ZeroOrderHold | None, saved: HeldTorques | None) -> None:
    """Check that a run continues with the sample time and delay with which it began.

    Raises:
        StateError: they differ; the message gives both.
    """
    ours, theirs = (None if one is None else (one.sample_time, one.delay) for one in (hold, saved))
    if ours != theirs:
        raise StateError(
            f"simulation: start: expected {_in_words(theirs)}, as the run began with, got {_in_words(ours)}; try the"
            " same again, or a new run"
        )


def _in_words(given: tuple[float, float] | None) -> str:
    return "no sample_time" if given is None else f"sample_time={given[0]:g} and delay={given[1]:g}"


def due(hold: ZeroOrderHold, held: HeldTorques, t: float) -> bool:
    """Return whether the controller has to be called at a time [s]."""
    return held.asked < len(hold.asked) and bool(hold.asked[held.asked] <= t)


def sampled(
    hold: ZeroOrderHold, controller: Controller, t: float, state: State, held: HeldTorques, acting: Array
) -> tuple[HeldTorques, Array]:
    """Return the state of the sampled controller at a time, called if a sample is due, and the torques that act, (n,).

    Args:
        hold: times at which the controller is called and at which its torques act.
        controller: the controller.
        t: time [s].
        state: positions and velocities at that time.
        held: the state of the sampled controller before.
        acting: (n,) the torques that have acted so far [N m or N].

    Raises:
        StateError: the controller does not return valid torques and memory.
    """
    asked, memory, waiting = held.asked, held.memory, held.waiting
    if due(hold, held, t):
        tau, memory = torques_and_memory(controller(float(hold.asked[asked]), state, memory))
        given = checks.numbers(tau, (len(state.q),), "controller: torques", StateError)
        asked, waiting = asked + 1, (*waiting, given)
    while waiting and hold.acts[asked - len(waiting)] <= t:
        acting, *others = waiting
        waiting = tuple(others)
    return HeldTorques(asked, memory, waiting, held.sample_time, held.delay), acting


class AskedOnce:
    """A controller that is not asked again for what it was asked shortly before.

    Steps that are taken together ask a few samples ahead. If the last of them have to be taken again, one by one, their
    torques are known.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller, self._known = controller, OrderedDict[float, tuple[State, Any, Any]]()

    def __call__(self, t: float, state: State, memory: Any) -> Any:
        """Return the torques and the memory."""
        if t in self._known:
            there, before, found = self._known[t]
            if before is memory and all(map(np.array_equal, parts_of(there).values(), parts_of(state).values())):
                return found
        found = self._controller(t, state, memory)
        self._known[t] = state, memory, found
        if len(self._known) > MOST_KNOWN:
            self._known.popitem(last=False)
        return found


def held_torques_law(joint_count: int) -> ControlLaw:
    """Return a control law that returns its memory as torques."""
    return ControlLaw(_remembered, memory=np.zeros(joint_count), key="held in memory")


def _remembered(t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
    return memory, memory
