"""What happens in a run between its samples, and events at given times: arms that grasp the object or release it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from holdfast.dynamics.impulse import attach
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain, holding_arm
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_rows import row_name
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

OccurrenceKind = Literal[
    "attach", "release", "violation", "recovery", "singular", "stiff", "unresolved",
    "touch", "lift", "slip", "stick", "jam", "rest",
]  # fmt: skip


@dataclass(frozen=True)
class Occurrence:
    """One entry of a run's log, as plain data.

    Attributes:
        t: time [s].
        kind: "attach" or "release" of a grasp; "violation", when a margin becomes negative; "recovery", when it becomes
            positive again; "singular", when the grasp constraint loses rank; "stiff", when steps become linearly
            implicit because explicit steps could not follow the damping or springs; "unresolved", at the run's end,
            when a step of fixed length was too long for some part of the motion. Of contacts with the world: "touch",
            "lift", "slip" and "stick", the last two also of hands; "jam", an impulse without a collision; "rest", when
            rebounds end.
        name: the arm, 'arm/joint', or 'point/shape' of a contact with the world; "grasps" for a singular configuration,
            "joints" for stiff ones and for steps that were too long.
        text: description of the occurrence.
        quantity: limited quantity of a violation or recovery: "grasp", "position", "rate" or "effort".
        lowest: for a recovery, the lowest margin since the violation [N; rad or m; rad/s or m/s; N m or N].
        lowest_time: time of that lowest margin [s].
        impulses: for an attach, (arms, 6) [moment; force] impulse of each arm on the object about its contact
            point, world axes [N m s, N s]; of a chain with branches, the impulses by the rows of the run.
        base_impulses: for an attach, (arms, 6) impulse of the base on each arm about the base origin, world axes.
        trunk_base_impulse: for an attach, (6,) impulse of the base on a trunk about the base origin; empty without a
            trunk.
        energy_change: for an attach, a touch or a jam, the change of the kinetic energy; that of all contacts that
            touch at once stands at the first of them [J].
        impulse: for a touch or a jam, (3,) impulse of the world on the object, world axes; empty without one [N s].
        rebounds_until: for a rest, the time at which ever smaller rebounds would have ended under the acceleration
            there; they are not followed below 1 mm/s [s].
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
    impulse: tuple[float, ...] = ()
    rebounds_until: float | None = None
    rank: int | None = None
    generic_rank: int | None = None
    lost: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the time, the kind and the text."""
        return f"{self.t:.9g} s, {self.kind}: {self.text}"


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
        arm: name of the arm, which must not hold the object at that time, or (arm, frame) of a chain with branches.
        grasp: the grasp to close.
        here: place the grasp at the current pose of the tip (`dynamics.impulse.grasp_here`); otherwise the tip must be
            at the grasp already.
    """

    t: float
    arm: str | tuple[str, str]
    grasp: Grasp
    here: bool = False


@called
@dataclass(frozen=True)
class Release(Frozen):
    """An arm releases the object; velocities stay the same.

    Attributes:
        t: time of the event [s].
        arm: name of the arm, or (arm, frame).
    """

    t: float
    arm: str | tuple[str, str]


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
        _require_key(event.arm, chain, f"{what}: arm")
        name = row_name(event.arm)
        checks.number(event.t, f"{what} of '{name}': t")
        if isinstance(event, Attach):
            checks.instance(event.grasp, Grasp, f"{what} of '{name}': grasp")
            checks.flag(event.here, f"{what} of '{name}': here")
    ordered = sorted(events, key=lambda event: event.t)
    for event in ordered:
        holding = holding_after(event, holding, chain, duration)
    return ordered


def _require_key(key: Any, chain: ClosedChain, what: str) -> None:
    """Refuse what is not the name of an arm, or (arm, frame) of a chain that is answered as a forest."""
    if not (chain.beyond_serial and isinstance(key, tuple) and len(key) == 2):
        checks.instance(key, str, what)
        return
    for one in key:
        checks.instance(one, str, what)
    if key[0] in chain.arms:
        chain.arms[key[0]].frame(key[1], what)


def holding_after(event: Event, holding: frozenset[Any], chain: ClosedChain, duration: float) -> frozenset[Any]:
    """Return the arms, or (arm, frame), that hold an object after an event.

    Args:
        event: the event.
        holding: the arms, or (arm, frame), that hold an object before the event.
        chain: the chain.
        duration: duration of the run [s].

    Raises:
        ModelError: as for `in_order`.
    """
    what = f"{type(event).__name__.lower()} of '{row_name(event.arm)}' at t = {event.t} s"
    arm = holding_arm(event.arm)
    t = checks.number(event.t, f"{what}: t", above=0.0)
    if t > duration:
        raise ModelError(f"{what}: expected a time within the run of {duration:g} s")
    if arm not in chain.arms:
        raise ModelError(f"{what}: no such arm.{checks.did_you_mean(arm, chain.arms)}")
    if isinstance(event, Attach) == (event.arm in holding):
        state = "has a grasp already; try a release before it" if event.arm in holding else "has no grasp then"
        raise ModelError(f"{what}: the arm {state}")
    return holding ^ {event.arm}


Happened = tuple[ClosedChain, State, Occurrence]


def happen(
    event: Event, chain: ClosedChain, state: State, inputs: Inputs, grip: Callable[..., Any] = attach
) -> Happened:
    """Return the chain and the state just after an event, and the entry for the log.

    Releasing a grasp that has opened before (because it slipped) changes nothing; the log entry says so.

    Args:
        event: the event.
        chain: the chain, with its bases at their poses at that time.
        state: the state just before the event.
        inputs: base motion at that time.
        grip: the function by which a grasp closes, `attach` or `forest_attach`.

    Raises:
        ClosureError: the tip of an attached arm is not at the grasp; the message gives the gap.
        ModelError: the attached arm already has a grasp.
    """
    name = row_name(event.arm)
    if isinstance(event, Attach):
        made = grip(chain, state, event.arm, event.grasp, here=event.here, inputs=inputs)
        text = f"'{name}' grips ({event.grasp.kind}); kinetic energy changes by {made.energy_change:.3g} J"
        impulses, base_impulses = (_rows(getattr(made, part, None)) for part in ("impulses", "base_impulses"))
        below = getattr(made, "trunk_base_impulse", None)
        exerted: Any = {"impulses": impulses, "base_impulses": base_impulses}
        exerted |= {"trunk_base_impulse": () if below is None else tuple(below.tolist())}
        grips = Occurrence(event.t, "attach", name, text, **exerted, energy_change=made.energy_change)
        return made.chain, made.state, grips
    if event.arm not in chain.grasps:
        return chain, state, Occurrence(event.t, "release", name, f"'{name}' had let go before")
    return chain.without_grasp(event.arm), state, Occurrence(event.t, "release", name, f"'{name}' lets go")


def _rows(x: Array | None) -> tuple[tuple[float, ...], ...]:
    """Return the rows of an array as plain data; none without an array."""
    return () if x is None else tuple(map(tuple, x.tolist()))
