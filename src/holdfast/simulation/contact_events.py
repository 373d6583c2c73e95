"""Runs whose object touches the world: where modes change, and what the log says about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from holdfast.dynamics.contact.decided_modes import Decision, Reached, decided
from holdfast.dynamics.contact.fixed_modes import (
    STOPPED_SPEED,
    ContactModes,
    RestResponses,
    Touch,
    slip_in_world,
    tangents,
)
from holdfast.dynamics.contact.sliding_hands import Hand, stacked_acceleration, touching_rows, without_hands
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactStatus
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import Sums
from holdfast.simulation.checkpoint import Origin
from holdfast.simulation.contact_signals import CONE, FORCE, OPENING, QUANTITIES, SLIP, ContactSignals
from holdfast.simulation.events import Occurrence, OccurrenceKind
from holdfast.simulation.hand_events import (
    hands_after,
    require_standing,
    same_hands,
    spent_grasps,
    taking_part,
)
from holdfast.simulation.instant import Instant, evaluate
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.segment import Segment, segment_with
from holdfast.spatial.scalar import Array
from holdfast.state import State


@runtime_checkable
class WithoutContacts(Protocol):
    """A stepper that answers what is asked at a change of modes."""

    responses: RestResponses

    def accelerations(self, origin: Origin, state: State) -> Array:
        """Return the acceleration of the object without contact forces, (6,)."""
        ...


EVENTS_WAY, IMPULSES_WAY = "events", "steps"
WAYS = (EVENTS_WAY, IMPULSES_WAY)
VERBS = {"touch": "touches", "lift": "lifts", "stick": "sticks", "slip": "slips"}
MOST_AT_ONCE = 100  # entries of the log within `SAME_INSTANT`
SAME_INSTANT = 1e-9  # s
SAME_LIMIT = 1e-8  # of the friction that contacts can give: less is left to those that slip together


def require_contacts(
    chain: ClosedChain, contacts: Any, scheme: Tableau, on_singular: str, unsupported: Sequence[str]
) -> None:
    """Refuse ways to follow contacts with the world that there are not.

    Args:
        chain: the chain.
        contacts: the argument of `simulate`.
        scheme: the Runge-Kutta scheme.
        on_singular: the argument of `simulate`.
        unsupported: arguments that are given, and are not supported with contacts.

    Raises:
        ModelError: the way is unknown, or the chain has nothing that touches.
        MethodNotApplicable: another argument does not go with contacts; the message names it.
    """
    if contacts is not None and contacts not in WAYS:
        raise ModelError(
            f"simulation: contacts: expected one of {', '.join(WAYS)}, got {checks.short(contacts)}."
            + checks.did_you_mean(str(contacts), WAYS)
        )
    if chain.touching is None:
        if contacts is not None:
            raise ModelError(
                f"simulation: contacts: expected a chain with touching for {contacts!r}, got one without; try"
                " ClosedChain(..., touching=holdfast.world.Touching(points, world))"
            )
        return
    wandering = [one.name for one in chain.touching.candidates if one.feature.wanders]
    if wandering and contacts != IMPULSES_WAY:
        raise MethodNotApplicable(
            f"contacts: expected contacts='steps' for circles such as '{wandering[0].split('.')[0]}', whose two nearest"
            " places change their order in a run"
        )
    if scheme.adaptive:
        raise MethodNotApplicable(f"scheme: expected fixed steps with contacts, got {scheme.name!r}; try 'rk4'")
    if on_singular != "stop":
        raise MethodNotApplicable("on_singular: expected 'stop' with contacts; passing through is not built with them")
    if unsupported:
        raise MethodNotApplicable(
            f"{unsupported[0]}: expected its default in a run with contacts; it is not built there"
        )


def reached(segment: Segment, at: Instant, margins: Array) -> Reached:
    """Return which contacts and hands an event concerns, from the signals (signals,) that are negative there."""
    signals = segment.signals
    touch, slipping = at.touch, {}
    spent = spent_grasps(segment, at, margins)
    if touch is None or not isinstance(signals, ContactSignals):
        return Reached([], [], {}, spent)
    found = margins[signals.of_margins :].reshape(-1, len(QUANTITIES))
    of_contacts, along = found < 0.0, tangents(touch.force)
    beyond = of_contacts[:, CONE]
    if beyond.any():  # redundant contacts reach their limits together
        beyond = found[:, CONE] <= SAME_LIMIT * touch.rows.friction * np.abs(touch.force[:, 2])
    for j in touch.modes.begins:  # and one that has just begun to slip goes on
        if found[j, SLIP] >= 0.0 and np.linalg.norm(touch.velocity[j, along]) <= STOPPED_SPEED:
            slipping[j] = touch.modes.slip[j]
    for j in np.flatnonzero(beyond).tolist():
        t = touch.force[j, along]
        slipping[j] = slip_in_world(touch.rows.axes[j], -t / np.linalg.norm(t))
    touched, lifted = (np.flatnonzero(of_contacts[:, i]).tolist() for i in (OPENING, FORCE))
    return Reached(touched, lifted, slipping, spent)


def with_modes(
    segment: Segment, origin: Origin, sums: Sums, before: Touch | None = None, by: Reached | None = None
) -> tuple[Segment, Origin, Sums, list[Occurrence]]:
    """Return the segment with the contacts' modes from an instant on, the state after impacts, and entries for the log.

    Args:
        segment: the segment; without contacts it is returned unchanged.
        origin: the instant.
        sums: work and impulses so far.
        before: the contacts just before; None at the start of a run.
        by: what an event has located.

    Raises:
        StateError: no impulses or forces satisfy the laws of contact.
    """
    chain, taking = segment.environment.chain, taking_part(segment, by)
    if chain.touching is None and not taking.hands:
        return segment, origin, sums, []
    deciding = segment
    if taking.grasps:
        others = without_hands(chain, taking.grasps).grasps
        deciding = segment_with(segment, others, origin, taking.hands)
    stepper = None if deciding.contacts is None else deciding.stepper
    if isinstance(stepper, WithoutContacts):
        found = decided(
            chain, origin.state, partial(stepper.accelerations, origin), None, by, responses=stepper.responses
        )
    else:
        found = _decided_by_reference(deciding, origin, taking.hands, by)
    names = () if chain.touching is None else chain.touching.names
    news = _log(origin.t, names, None if before is None else before.modes, found)
    sums = sums._replace(impact=sums.impact + found.energy_change, base_impulse=sums.base_impulse + found.outer_impulse)
    origin, modes = replace(origin, state=found.state), found.modes
    if taking.hands:
        grasps, modes, of_hands = hands_after(deciding.environment.chain, found, taking, origin.t)
        news = [*news, *of_hands]
        if {**grasps} != {**chain.grasps} or not same_hands(modes.hands, segment.hands):
            segment = segment_with(segment, grasps, origin, modes.hands)
    if chain.touching is None and not modes.hands:
        return replace(segment, contacts=None, least_gap=None), origin, sums, news
    gap = touching_rows(segment.environment.chain_at(origin.t), origin.state, modes.hands).gap
    least_gap = None if segment.settings.by_impulses else np.minimum(gap, 0.0)
    return replace(segment, contacts=modes, least_gap=least_gap), origin, sums, news


def _decided_by_reference(deciding: Segment, origin: Origin, hands: tuple[Hand, ...], by: Reached | None) -> Decision:
    environment, generic_rank, law = deciding.environment, deciding.generic_rank, deciding.controller
    free = evaluate(environment, law, origin.t, origin.state, origin.memory, generic_rank=generic_rank)
    held = free.result.held
    if hands:
        require_standing(free.inputs)

    def accelerate(state: State) -> Array:
        of = environment, law, origin.t, state, origin.memory
        found = evaluate(*of, generic_rank=generic_rank, held=held).result
        return stacked_acceleration(free.chain, state, hands, found)

    return decided(free.chain, origin.state, accelerate, held, by, hands)


def _log(t: float, names: Sequence[str], before: ContactModes | None, found: Decision) -> list[Occurrence]:
    """Return the entries for the changes of modes and for impulses at an instant."""
    news = []
    old = np.zeros(len(names), int) if before is None else before.mode
    noted = "" if found.status is ContactStatus.OK else f"; {found.status.value}"
    for j, name in enumerate(names):
        now, impulse = int(found.modes.mode[j]), found.impulse[j]
        pushed = bool(impulse.any())
        kind: OccurrenceKind
        if pushed and found.jammed:
            kind, text = "jam", "jams: no forces satisfy the laws of contact, an impulse without a collision does"
        elif pushed:
            kind, text = "touch", "touches" if old[j] == ContactMode.OPEN else "is struck"
        elif old[j] == now:
            continue
        elif now == ContactMode.OPEN:
            kind, text = "lift", "lifts"
        elif old[j] == ContactMode.OPEN:
            kind, text = "touch", "touches"
        elif now == ContactMode.STICKS:
            kind, text = "stick", "sticks"
        else:
            kind, text = "slip", "slips"
        if pushed:
            size = float(np.linalg.norm(impulse))
            text += f", impulse {size:.4g} N s; all impulses change the kinetic energy by {found.energy_change:.3g} J"
            text += "" if now == ContactMode.OPEN else f"; then it {ContactMode(now).name.lower()}"
        exerted: tuple[float, ...] = tuple(impulse.tolist()) if pushed else ()
        news.append(Occurrence(t, kind, name, f"'{name}' {text}{noted}", impulse=exerted))
        if j in found.rocked:
            text = f"'{name}' comes to rest: it rocks too slowly to follow"
            news.append(Occurrence(t, "rest", name, text))
        if left := float(found.rebounding[j]):
            text = f"'{name}' comes to rest: its rebounds, too slow to follow, would end after another {left:.3g} s"
            news.append(Occurrence(t, "rest", name, text, rebounds_until=t + left))
    if news and any(one.kind in ("touch", "jam") for one in news):
        first = next(k for k, one in enumerate(news) if one.kind in ("touch", "jam"))
        news[first] = replace(news[first], energy_change=found.energy_change)
    return news


def changes(before: Instant, after: Instant, names: Sequence[str]) -> list[Occurrence]:
    """Return the entries for contacts whose modes differ between the ends of a step with impulses."""
    assert before.touch is not None and after.touch is not None
    h, pushes = after.t - before.t, after.touch.rows.in_world(after.touch.force)
    news = []
    for j, (old, now) in enumerate(zip(before.touch.modes.mode, after.touch.modes.mode, strict=True)):
        if old == now:
            continue
        kind: OccurrenceKind = "touch" if old == ContactMode.OPEN else "lift"
        if ContactMode.OPEN not in (old, now):
            kind = "stick" if now == ContactMode.STICKS else "slip"
        impulse = tuple((h * pushes[j]).tolist()) if kind == "touch" else ()
        text = f"'{names[j]}' {VERBS[kind]} in the step that ends here"
        news.append(Occurrence(after.t, kind, names[j], text, impulse=impulse))
    return news


def require_progress(occurrences: Sequence[Occurrence]) -> None:
    """Refuse modes that change again and again at one time.

    Raises:
        StateError: naming the contact that changed last.
    """
    if len(occurrences) > MOST_AT_ONCE and occurrences[-1].t - occurrences[-MOST_AT_ONCE].t < SAME_INSTANT:
        one = occurrences[-1]
        raise StateError(
            f"contacts: '{one.name}' and others change their modes {MOST_AT_ONCE} times at t = {one.t:.9g} s; expected"
            " a motion in which every mode lasts; try other points or shapes, or contacts='steps'"
        )
