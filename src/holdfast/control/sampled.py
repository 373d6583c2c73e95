"""Sampled control laws: evaluated once per sample, with torques that are held in between.

    tau(t) = tau_k for t_k + delay <= t < t_(k+1) + delay,   tau_k = law(t_k, state(t_k), memory_(k-1))

Before the first delay is over, the torques of the first sample act, as if the chain had been at rest at its start. The
first sample is taken when the law is first evaluated. `simulate` and rollouts take the same law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.controller import ControlLaw, Controller, GivenLaw
from holdfast.control.digital_law import DigitalTorque, evaluated
from holdfast.control.random_streams import STATE_SIZE, STREAM_BITS, stream_states
from holdfast.control.traced_law import law_key, law_of, require_function
from holdfast.errors import ModelError, StateError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.serial_chain import serial_chain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, concatenate, select, where
from holdfast.state import State

WITH_NOISE = ("q", "qd", "object_pose", "object_twist", "tau")
WITH_RESOLUTION = ("q", "qd", "tau")
EARLY = 1e-6  # part of a sample by which a time may fall short of that of a sample, by rounding
MOST_WAITING = 100
SMALLEST_SETTING, LARGEST_SETTING = 1e-9, 1e9  # what is rounded to 1e-9 is exact up to 2e6, see `scalar.rint`
LARGEST_DENOMINATOR = 1000  # of delay / sample_time, where steps are proposed


def sampled(
    controller: ControlLaw | Controller,
    chain: ClosedChain,
    *,
    sample_time: float,
    delay: float = 0.0,
    noise: Mapping[str, ArrayLike] | None = None,
    seed: int | None = None,
    resolution: Mapping[str, ArrayLike] | None = None,
    saturation: bool | ArrayLike = False,
    rate_limit: ArrayLike | None = None,
) -> ControlLaw:
    """Return the law of a digital controller, with its sensors and actuators, for `simulate` and rollouts.

    At a sample, noise is added to the measurements and they are rounded; the law is evaluated; its torques are rounded,
    clipped to the limits and limited in their change; and noise is added to them. In rollouts, the sample time and the
    delay must be whole multiples of the step.

    Args:
        controller: a `ControlLaw`, or a controller of the library.
        chain: the chain that it controls.
        sample_time: time between two samples [s].
        delay: time from a sample until its torques act [s].
        noise: standard deviations of independent normal noise by name: q, qd, object_twist, object_pose (6,) [rotation
            vector; shift], world axes, and tau; one number, or one for each entry [SI units].
        seed: seed of the noise, an integer >= 0. Every system of a rollout, run of a sweep or episode has its own
            stream of random numbers; `simulate` has stream 0.
        resolution: steps to which q, qd (encoders) and tau (command) are rounded; one number, or (n,).
        saturation: largest |tau| of the command, one number or (n,) [N m or N]; True for the joints' effort limits.
        rate_limit: largest rate of change of the command, one number or (n,) [N m/s or N/s]; no limit for the first.

    Raises:
        ModelError: a number, name or shape is invalid, there is noise without a seed, the controller is not traceable
            or is sampled already, or the law depends on more than its arguments.
    """
    serial_chain(chain, "sampled: chain")
    period = checks.number(sample_time, "sampled: sample_time", above=0.0)
    late = checks.number(delay, "sampled: delay", at_least=0.0)
    if period > LARGEST_SETTING:
        raise ModelError(f"sampled: sample_time: expected at most {LARGEST_SETTING:g} s, got {period:g} s; try 1e-3")
    if late > MOST_WAITING * period:
        raise ModelError(f"sampled: delay: expected at most {MOST_WAITING} samples of {period:g} s, got {late:g} s")
    law, n = _traceable(controller, chain), chain.joint_count
    limits = _limits(saturation, chain)
    change = np.full(n, np.inf) if rate_limit is None else period * _positive(rate_limit, n, "rate_limit")
    deviations = _by_name(noise, WITH_NOISE, n, "noise")
    steps = _by_name(resolution, WITH_RESOLUTION, n, "resolution")
    if deviations and seed is None:
        raise ModelError("sampled: seed: expected an integer >= 0 for the noise, got none; try seed=0")
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0):
        raise ModelError(f"sampled: seed: expected an integer >= 0, got {checks.short(seed)}")
    require_function(law, chain)
    key = law_key(law, chain)
    digital = DigitalTorque(law, n, deviations, steps, limits, change)
    if deviations or steps or np.isfinite([limits, change]).any():
        key = f"digital/{exact_fingerprint([n, deviations, steps, limits, change])}/{key}" if key else ""
        source = stream_states(seed or 0, 0)[0] if deviations else np.zeros(STATE_SIZE)
        law = ControlLaw(digital, digital.memory(source), law.parameters, key)
    torque = SampledTorque(law, n, period, late, seed if deviations else None)
    key = f"sampled/{period!r}/{late!r}/{key}" if key else ""
    return ControlLaw(torque, torque.memory(law.memory), law.parameters, key)


def _traceable(controller: ControlLaw | Controller, chain: ClosedChain) -> ControlLaw:
    """Return a controller as a control law that is not sampled yet.

    Raises:
        ModelError: it cannot be traced, or it is sampled already.
    """
    law = controller if isinstance(controller, ControlLaw) else None
    if law is None and not isinstance(controller, GivenLaw):
        law = law_of(controller, chain)
    if law is None:
        raise ModelError(
            f"sampled: expected a ControlLaw or a built-in controller, got {type(controller).__name__}; try"
            " ControlLaw(torque), with values of its parameters given to the run, or simulate(..., sample_time=...) for"
            " any function"
        )
    if isinstance(law.torque, SampledTorque):
        raise ModelError("sampled: expected a law that is not sampled yet, got one that is")
    return law


def _limits(saturation: bool | ArrayLike, chain: ClosedChain) -> Array:
    """Return the largest torques, (n,); infinite for no limit."""
    if isinstance(saturation, bool | np.bool_):
        limits = joint_limits(chain).effort if saturation else np.full(chain.joint_count, np.inf)
        if saturation and not np.isfinite(limits).any():
            raise ModelError("sampled: saturation: expected joints with effort limits, got none; try saturation=50.0")
        return limits
    return _positive(saturation, chain.joint_count, "saturation")


def _by_name(given: Mapping[str, ArrayLike] | None, known: Sequence[str], n: int, what: str) -> dict[str, Array]:
    """Return numbers by the names of what they belong to, in the order of `known`."""
    values = {} if given is None else given
    checks.instance(values, Mapping, f"sampled: {what}")
    for name in values:
        if name not in known:
            raise ModelError(f"sampled: {what}: no {checks.short(name)}.{checks.did_you_mean(str(name), known)}")
    sizes = {name: n if name in ("q", "qd", "tau") else 6 for name in known}
    return {name: _positive(values[name], sizes[name], f"{what}: {name}") for name in known if name in values}


def _positive(value: ArrayLike, size: int, what: str) -> Array:
    """Return one number for each entry, (size,), from numbers or one for all."""
    x, low, high = checks.numbers(value, None, f"sampled: {what}"), SMALLEST_SETTING, LARGEST_SETTING
    if x.shape not in ((), (size,)) or not ((x >= low) & (x <= high)).all():
        raise ModelError(
            f"sampled: {what}: expected a number from {low:g} to {high:g}, or ({size},) of them, got"
            f" {checks.short(value)}; leave out what has none"
        )
    return np.full(size, x)


@dataclass(frozen=True, eq=False)
class SampledTorque(Frozen):
    """The torques of a sampled law.

    The memory consists of that of the law, the time of the last sample and the number of samples, the torques that act,
    and those that wait, the newest first.

    Attributes:
        law: the law that is evaluated at samples.
        joint_count: n.
        sample_time: time between two samples [s].
        delay: time from a sample until its torques act [s].
        seed: seed of the noise; None without noise.
    """

    law: ControlLaw
    joint_count: int
    sample_time: float
    delay: float
    seed: int | None

    @property
    def waiting(self) -> int:
        """The number of samples whose torques wait at the same time."""
        return math.ceil(self.delay / self.sample_time - EARLY)

    @property
    def late(self) -> float:
        """The time from a sample until the torques of the oldest sample that waits act [s], less than a sample."""
        rest = self.delay - (self.waiting - 1) * self.sample_time
        return rest if self.waiting and rest < (1.0 - EARLY) * self.sample_time else 0.0

    def memory(self, own: Array) -> Array:
        """Return the initial memory, for that of the law (m,) or of several systems (systems, m)."""
        more = 2 + self.joint_count * (1 + self.waiting)
        return np.concatenate([own, np.zeros((*own.shape[:-1], more))], axis=-1)

    def last_samples(self, memory: Array) -> tuple[Array, Array]:
        """Return the time of the last sample [s] and the number of samples, from memories (systems, m)."""
        size = len(self.law.memory)
        return memory[:, size], memory[:, size + 1]

    def held(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques that act between two samples and the memory, as a law does."""
        begin = len(self.law.memory) + 2
        return memory[begin : begin + self.joint_count], memory

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques that act from a time on, (n,), and the memory; the law is evaluated if a sample is due."""
        size, early = len(self.law.memory), EARLY * self.sample_time
        own, (last, count), torques = memory[:size], memory[size : size + 2], memory[size + 2 :]
        acting, *waiting = torques.reshape(1 + self.waiting, self.joint_count)
        begins, due = count < 0.5, where(count < 0.5, t, last + self.sample_time - early) <= t
        tau, kept = evaluated(self.law, self.joint_count, t, state, own, given)
        new = [tau, *(select(begins, tau, x) for x in waiting)]
        acting = select(due, new[-1], acting)
        own, waiting = select(due, kept, own), [select(due, x, y) for x, y in zip(new, waiting, strict=False)]
        last, count = where(due, t, last), where(due, count + 1.0, count)
        if self.late:
            acting = select(last + self.late - early <= t, waiting[-1], acting)
        return acting, concatenate([own, [last, count], acting, *waiting])


def noise_stream(law: ControlLaw, stream: int) -> ControlLaw:
    """Return a sampled law with another stream of random numbers, such as that of one system of a rollout.

    Args:
        law: a law that `sampled` returned.
        stream: number of the stream, an integer >= 0: that of the system, or of the run of a sweep.

    Raises:
        ModelError: the law has no noise, or there is no such stream.
    """
    checks.instance(law, ControlLaw, "noise_stream: law")
    if not has_noise(law):
        raise ModelError("noise_stream: law: expected a law with noise, got one without; try sampled(..., noise=...)")
    if isinstance(stream, bool) or not isinstance(stream, int | np.integer) or not 0 <= stream < 2**STREAM_BITS:
        raise ModelError(f"noise_stream: stream: expected an integer >= 0, got {checks.short(stream)}")
    return replace(law, memory=initial_memories(law, [stream])[0])


def has_noise(law: ControlLaw) -> bool:
    """Return whether a law draws random numbers."""
    return isinstance(law.torque, SampledTorque) and law.torque.seed is not None


def initial_memories(law: ControlLaw, streams: Sequence[int] | Array) -> Array:
    """Return the initial memories of systems with these streams of random numbers, (systems, m); (m,) without noise."""
    torque = law.torque
    if not isinstance(torque, SampledTorque) or torque.seed is None:
        return law.memory
    own = np.tile(torque.law.memory, (len(streams), 1))
    own[:, -STATE_SIZE:] = stream_states(torque.seed, streams)
    return torque.memory(own)


def within_steps(law: ControlLaw) -> ControlLaw:
    """Return the law that stages inside a step evaluate: the torques of a sampled law are held there."""
    return replace(law, torque=law.torque.held) if isinstance(law.torque, SampledTorque) else law


def require_steps(law: ControlLaw, steps: ArrayLike) -> None:
    """Check that steps end at the samples of a law, and where its torques begin to act.

    Args:
        law: any control law.
        steps: lengths of steps [s].

    Raises:
        StateError: a step does not divide the sample time or the delay; the message proposes steps.
    """
    torque = law.torque
    if not isinstance(torque, SampledTorque):
        return
    for step in np.unique(steps).tolist():
        parts = np.array([torque.sample_time, torque.delay]) / step
        if (np.abs(parts - np.rint(parts)) > EARLY * np.maximum(1.0, parts)).any() or parts[0] < 0.5:
            raise StateError(
                f"step: expected one that divides the sample time {torque.sample_time:g} s and the delay"
                f" {torque.delay:g} s of the law, got {step:g} s; try {_proposed(torque, step)}"
            )


def _proposed(torque: SampledTorque, step: float) -> str:
    """Return the nearest steps that divide the sample time and the delay, in words."""
    part = Fraction(torque.delay / torque.sample_time).limit_denominator(LARGEST_DENOMINATOR)
    longest = torque.sample_time / part.denominator
    parts = sorted({max(1, math.floor(longest / step)), math.ceil(longest / step)})
    return " or ".join(f"{longest / k:.6g} s" for k in parts)
