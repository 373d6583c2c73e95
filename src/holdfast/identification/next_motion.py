"""The motion that would tell most about what is unknown, chosen among exciting ones (D-optimal)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError, StateError
from holdfast.identification.exciting_motion import Coordinates, Limits, Series, largest, within
from holdfast.identification.load_recording import recording_of
from holdfast.identification.machine.fit import information_of
from holdfast.identification.machine.identify_machine import moving, without_object
from holdfast.identification.machine.prior import Prior
from holdfast.identification.machine.unknowns import machine_unknowns, required_kinds
from holdfast.identification.recording import FEWEST_SAMPLES, Recording
from holdfast.identification.rows import rows_of
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit

PER_SHORTEST_PERIOD = 5  # samples in a period of the highest harmonic, at which limits and information are looked at
USUAL_NOISE = 0.05  # of the torques, relative to their rms, if none is given
EXCHANGES = 10  # rounds in which every part is exchanged for a better one


@np.errstate(all="ignore")  # what overflows is beyond a limit
def next_motion(
    chain: ClosedChain,
    state: State,
    unknowns: Sequence[str],
    *,
    recorded: Recording | Sequence[Recording] = (),
    prior: Prior | None = None,
    noise: ArrayLike | None = None,
    duration: float = 10.0,
    parts: int = 5,
    harmonics: int = 4,
    rate: float = 100.0,
    share: float = 0.9,
    turn: float = 0.5,
    shift: float = 0.2,
    tries: int = 60,
    seed: int = 0,
) -> Recording:
    """Return the motion that reduces the volume of the uncertainty most, closed and within limits (D-optimal).

    The motion has parts that begin and end at rest in the given state. In each part every independent coordinate of
    the chain is a finite Fourier series,

        u(t) = sum_k a_k cos(2 pi k t / T) + b_k sin(2 pi k t / T) + a_0,    u = u' = u'' = 0 at both ends,

    as large as the limits of positions, rates and torques allow. Of many random parts, those are chosen, by exchanges
    from a greedy start (Fedorov 1972), that maximise log det(F + L) with the information F of the motion and of what
    was recorded before, and L of the prior. Torques are the smallest that move the model. Collisions are not looked
    at. O(tries samples n^3): some 20 s for two arms of seven joints.

    Args:
        chain: the model, of arms on fixed bases, with rigid, ball, hinge or similar grasps, or none.
        state: a closed state at which the motion begins and ends.
        unknowns: what shall be told from torques, as for `identify` with by="tau".
        recorded: recordings with torques, whose information counts.
        prior: how uncertain the model's values are.
        noise: standard deviations of the torques, (n,) or one number; by default 5 % of their root mean square.
        duration: of the whole motion [s].
        parts: the number of parts.
        harmonics: the highest harmonic of a part, 2 or more.
        rate: samples a second of the result [Hz].
        share: part of the limits of rates and torques that is used, and of the range of positions.
        turn: largest turn of the object from its start [rad].
        shift: largest shift of the object from its start [m].
        tries: number of random parts.
        seed: of the random numbers.

    Returns:
        A `Recording` of the planned motion, with the torques of the model.

    Raises:
        ModelError: an unknown cannot be told by torques, or a number is out of range.
        StateError: the state is not closed, or beyond a limit, or no random part is within the limits.
        MethodNotApplicable: the chain has a floating base, grasps that slip or yield, or an object that moves without
            its joints.

    Reference:
        Swevers, Ganseman, Tukel, De Schutter and Van Brussel 1997 (series); Fedorov 1972 (exchanges).
    """
    checks.instance(chain, ClosedChain, "next_motion: chain")
    held = without_object(chain)
    serial_chain(held, "next_motion: chain")
    kinds = required_kinds(unknowns, "tau", held)
    checks.instance(prior, (Prior, type(None)), "next_motion: prior")
    checks.instance(state, State, "next_motion: state", StateError)
    if held is not chain:
        state = State(state.q, state.qd, np.r_[1.0, np.zeros(6)], np.zeros(6))
    require_fit(held, state)
    before = [recording_of(one, held) for one in ([*recorded] if isinstance(recorded, list | tuple) else [recorded])]
    if any(one.tau is None for one in before):
        raise StateError("next_motion: recorded: expected torques, got none")
    count = _whole(parts, "parts", 1)
    length = checks.number(duration, "next_motion: duration", above=0.0) / count
    highest = _whole(harmonics, "harmonics", 2)
    limits = Limits.of(held, state, share, turn, shift)
    coordinates = Coordinates.of(held, state)
    random = np.random.default_rng(_whole(seed, "seed", 0))
    times = np.arange(0.0, length, length / (PER_SHORTEST_PERIOD * highest))
    series = [Series.random(coordinates.count, length, highest, random) for _ in range(_whole(tries, "tries", 1))]
    series = [largest(coordinates, limits, one, times) for one in series]
    found = [one for one in (within(held, coordinates, limits, one, times) for one in series) if one is not None]
    if not found:
        raise StateError("next_motion: no part could be closed within the limits; try another state, or a larger share")
    made = [one for _, one in found]
    samples = round(checks.number(rate, "next_motion: rate", above=0.0) * length)
    if samples < FEWEST_SAMPLES:
        raise ModelError(f"next_motion: rate: expected {FEWEST_SAMPLES} samples or more in a part, got {samples}")
    F, spread = _information(held, kinds, prior or Prior(), made, before, noise, samples / len(times))
    chosen = most_telling(F[: len(made)] * spread, F[len(made) :].sum(axis=0) * spread + np.eye(len(spread)), count)
    fine = np.arange(samples) / rate
    parts_made = [within(held, coordinates, limits, found[k][0], fine) for k in chosen]
    whole = [one[1] for one in parts_made if one is not None]
    if len(whole) < count:
        raise StateError("next_motion: a part is beyond a limit between its samples; try a smaller share")
    return _joined(whole, length)


def _whole(value: Any, name: str, least: int) -> int:
    """Return a whole number."""
    found = checks.number(value, f"next_motion: {name}", at_least=float(least))
    if found != int(found):
        raise ModelError(f"next_motion: {name}: expected a whole number, got {found:g}")
    return int(found)


def _information(
    chain: ClosedChain,
    kinds: tuple[str, ...],
    prior: Prior,
    made: list[Recording],
    before: list[Recording],
    noise: Any,
    samples: float,
) -> tuple[Array, Array]:
    """Return the information F (recordings, p, p) of planned and of recorded motions, and spread spread^T of the prior.

    Args:
        chain: the model.
        kinds: the unknowns.
        prior: their uncertainty.
        made: planned motions.
        before: recorded ones.
        noise: of the torques.
        samples: the number of samples for which one of a planned motion stands.
    """
    known = moving(chain, before)
    y = np.concatenate([np.asarray(one.tau) for one in made])
    sizes = USUAL_NOISE * np.maximum(np.sqrt((y**2).mean(axis=0)), 1e-3 * np.abs(y).max())
    if noise is not None:
        sizes = np.broadcast_to(checks.numbers(noise, None, "next_motion: noise"), sizes.shape)
        if not (sizes > 0.0).all():
            raise ModelError("next_motion: noise: expected standard deviations > 0")
    duration = max(float(one.t[-1] - one.t[0]) for one in [*made, *known])
    unknowns = machine_unknowns(chain, "tau", kinds, prior, y, np.ones(y.shape[1]), duration)
    found = [
        information_of(rows_of(chain, [one], unknowns), unknowns, unknowns.start, sizes) for one in [*made, *known]
    ]
    counted = np.r_[np.full(len(made), samples), np.ones(len(known))]
    return counted[:, None, None] * np.array(found), np.outer(unknowns.spread, unknowns.spread)


def most_telling(F: Array, known: Array, count: int) -> list[int]:
    """Return which of F (motions, p, p) maximise log det(known + sum F), some perhaps more than once."""

    def best(base: Array) -> int:
        return int(np.argmax(np.linalg.slogdet(base + F)[1]))

    chosen = list[int]()
    for _ in range(count):
        chosen.append(best(known + F[chosen].sum(axis=0)))
    for _ in range(EXCHANGES):
        before = list(chosen)
        for k in range(count):
            chosen[k] = best(known + F[chosen[:k] + chosen[k + 1 :]].sum(axis=0))
        if chosen == before:
            break
    return chosen


def _joined(parts: list[Recording], length: float) -> Recording:
    """Return recordings one after the other."""
    names = ("q", "qd", "qdd", "tau", "object_pose", "object_twist", "object_acceleration")
    t = np.concatenate([one.t + k * length for k, one in enumerate(parts)])
    arrays: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return Recording(t=t, **arrays)
