"""What happens in a run between its samples, and events at given times: arms that grasp the object or release it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from holdfast.dynamics.impulse import attach
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.state import Inputs, State

OccurrenceKind = Literal["attach", "release", "violation", "recovery", "singular", "stiff", "unresolved"]


@dataclass(frozen=True)
class Occurrence:
    """One entry of a run's log, as plain data.

    Attributes:
        t: time [s].
        kind: "attach" or "release" of a grasp; "violation", when a margin becomes negative; "recovery", when it becomes
            positive again; "singular", when the grasp constraint loses rank; "stiff", when steps become linearly
            implicit because explicit steps could not follow the damping or springs; "unresolved", at the run's end,
            when a step of fixed length was too long for some part of the motion.
        name: the arm, or 'arm/joint'; "grasps" for a singular configuration, "joints" for stiff ones and
            for steps that were too long.
        text: description of the occurrence.
        quantity: limited quantity of a violation or recovery: "grasp", "position", "rate" or "effort".
        lowest: for a recovery, the lowest margin since the violation [N; rad or m; rad/s or m/s; N m or N].
        lowest_time: time of that lowest margin [s].
        impulses: for an attach, (arms, 6) [moment; force] impulse of each arm on the object about its contact
            point, world axes [N m s, N s].
        base_impulses: for an attach, (arms, 6) impulse of the base on each arm about the base origin, world axes.
        trunk_base_impulse: for an attach, (6,) impulse of the base on a trunk about the base origin; empty without a
            trunk.
        energy_change: for an attach, the change of the kinetic energy [J].
        rank: for a singular configuration, the rank of the grasp constraint there.
        generic_rank: for a singular configuration, the rank of the constraint before and after.
        lost: for a singular configuration, in words, the loads that it cannot resist and the directions that arms lose.
    """

    t: float
    kind: OccurrenceKind
    name: str
    text: str
    quantity: str | None = None
    lowest: float | None = None
    lowest_time: float | None = None
    impulses: tuple[tuple[float, ...], ...] = ()
    base_impulses: tuple[tuple[float, ...], ...] = ()
    trunk_base_impulse: tuple[float, ...] = ()
    energy_change: float = 0.0
    rank: int | None = None
    generic_rank: int | None = None
    lost: tuple[str, ...] = ()


def ending(stopped: str | None, occurrences: Iterable[Occurrence]) -> str:
    """Return how a run ended: why it stopped, or that it is complete, with steps that were too long or without."""
    if stopped is not None:
        return stopped
    unresolved = any(one.kind == "unresolved" for one in occurrences)
    return f"complete{', but a step was too long for the motion (see occurrences)' * unresolved}"


@called
@dataclass(frozen=True, eq=False)
class Attach(Frozen):
    """An arm grasps the object. An impulse stops the relative velocity that the grasp does not allow.

    Attributes:
        t: time of the event [s].
        arm: name of the arm, which must not hold the object at that time.
        grasp: the grasp to close.
        here: place the grasp at the current pose of the tip (`dynamics.impulse.grasp_here`); otherwise the tip must be
            at the grasp already.
    """

    t: float
    arm: str
    grasp: Grasp
    here: bool = False


@called
@dataclass(frozen=True)
class Release(Frozen):
    """An arm releases the object; velocities stay the same.

    Attributes:
        t: time of the event [s].
        arm: name of the arm.
    """

    t: float
    arm: str


Event = Attach | Release


def in_order(events: Sequence[Event], chain: ClosedChain, duration: float) -> list[Event]:
    """Return the events in order of time; events at the same time keep their order.

    Raises:
        ModelError: an event lies outside the run, names an unknown arm, attaches an arm that already has a grasp, or
            releases an arm that has none.
    """
    holding = frozenset(chain.grasps)
    if not checks.is_listed(events):
        raise ModelError(f"events: expected a list of Attach and Release, got {type(events).__name__}")
    for event in events:
        if not isinstance(event, Attach | Release):
            raise ModelError(f"events: expected Attach and Release, got {type(event).__name__}")
        what = type(event).__name__.lower()
        checks.instance(event.arm, str, f"{what}: arm")
        checks.number(event.t, f"{what} of '{event.arm}': t")
        if isinstance(event, Attach):
            checks.instance(event.grasp, Grasp, f"{what} of '{event.arm}': grasp")
            checks.flag(event.here, f"{what} of '{event.arm}': here")
    ordered = sorted(events, key=lambda event: event.t)
    for event in ordered:
        holding = holding_after(event, holding, chain, duration)
    return ordered


def holding_after(event: Event, holding: frozenset[str], chain: ClosedChain, duration: float) -> frozenset[str]:
    """Return the names of the arms that hold the object after an event.

    Args:
        event: the event.
        holding: names of the arms that hold the object before the event.
        chain: the chain.
        duration: duration of the run [s].

    Raises:
        ModelError: as for `in_order`.
    """
    what = f"{type(event).__name__.lower()} of '{event.arm}' at t = {event.t} s"
    t = checks.number(event.t, f"{what}: t", above=0.0)
    if t > duration:
        raise ModelError(f"{what}: expected a time within the run of {duration:g} s")
    if event.arm not in chain.arms:
        raise ModelError(f"{what}: no such arm.{checks.did_you_mean(event.arm, chain.arms)}")
    if isinstance(event, Attach) == (event.arm in holding):
        state = "has a grasp already; try a release before it" if event.arm in holding else "has no grasp then"
        raise ModelError(f"{what}: the arm {state}")
    return holding ^ {event.arm}


def happen(event: Event, chain: ClosedChain, state: State, inputs: Inputs) -> tuple[ClosedChain, State, Occurrence]:
    """Return the chain and the state just after an event, and the entry for the log.

    Releasing a grasp that has opened before (because it slipped) changes nothing; the log entry says so.

    Args:
        event: the event.
        chain: the chain, with its bases at their poses at that time.
        state: the state just before the event.
        inputs: base motion at that time.

    Raises:
        ClosureError: the tip of an attached arm is not at the grasp; the message gives the gap.
        ModelError: the attached arm already has a grasp.
    """
    if isinstance(event, Attach):
        made = attach(chain, state, event.arm, event.grasp, here=event.here, inputs=inputs)
        text = f"'{event.arm}' grips ({event.grasp.kind}); kinetic energy changes by {made.energy_change:.3g} J"
        impulses, base_impulses = (tuple(map(tuple, x.tolist())) for x in (made.impulses, made.base_impulses))
        below = () if made.trunk_base_impulse is None else tuple(made.trunk_base_impulse.tolist())
        exerted: Any = {"impulses": impulses, "base_impulses": base_impulses, "trunk_base_impulse": below}
        grips = Occurrence(event.t, "attach", event.arm, text, **exerted, energy_change=made.energy_change)
        return made.chain, made.state, grips
    if event.arm not in chain.grasps:
        return chain, state, Occurrence(event.t, "release", event.arm, f"'{event.arm}' had let go before")
    lets_go = Occurrence(event.t, "release", event.arm, f"'{event.arm}' lets go")
    return chain.without_grasp(event.arm), state, lets_go
