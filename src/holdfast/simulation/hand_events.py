"""Hands that slide in a run: which take part where modes may change, and which hold, slide or lift afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.decided_modes import Decision, Reached
from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.dynamics.contact.sliding_hands import Hand, may_slide, point_owners, regripped
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactStatus
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.simulation.events import Occurrence
from holdfast.simulation.instant import Instant
from holdfast.simulation.segment import Segment
from holdfast.state import Inputs

SLIDE = "slide"
SAME_TIME = 1e-9  # of the grasp forces: margins that differ by less reach zero together


def require_slidable(chain: ClosedChain, moving: bool, contacts: str | None, adaptive: bool) -> None:
    """Refuse runs in which hands cannot be followed while they slide.

    Raises:
        MethodNotApplicable: the message names what does not go with `on_slip="slide"`.
    """
    reasons = {
        "a chain with branches, loops, couplings or several objects": bool(chain.beyond_serial),
        "arms on a trunk": chain.trunk is not None,
        "bases that move": moving,
        "contacts='steps'": contacts == "steps",
        "an adaptive scheme": adaptive,
    }
    for what, given in reasons.items():
        if given:
            raise MethodNotApplicable(
                f"on_slip: hands that slide are not followed with {what}; try on_slip='release', which opens the grasp"
            )


def require_standing(inputs: Inputs) -> None:
    """Refuse inputs that move bases.

    Raises:
        StateError: a base moves.
    """
    for moved in (inputs.base_twists, inputs.base_accelerations):
        if moved is not None and np.any(moved):
            raise StateError("on_slip: hands that slide are not followed with bases that move; try on_slip='release'")


def spent_grasps(segment: Segment, at: Instant, margins: np.ndarray) -> frozenset[str]:
    """Return the arms whose grasps have no margin left at an instant, if these may slide."""
    chain = segment.environment.chain
    if segment.settings.policy.on_slip != SLIDE:
        return frozenset()
    none = SAME_TIME * float(np.abs(at.result.grasp_wrench).max(initial=0.0))
    able = slidable(segment)
    return frozenset(name for i, name in enumerate(chain.names) if name in able and margins[i] < none)


def slidable(segment: Segment) -> list[str]:
    """Return the arms whose grasps may slide."""
    return [name for name, grasp in segment.environment.chain.grasps.items() if may_slide(grasp)]


class Taking(NamedTuple):
    """The hands that take part in a decision.

    Attributes:
        hands: those that slide, then those that hold so far.
        grasps: the grasps of the latter.
        spent: arms whose grasps have no margin left.
        sticking: arms of hands without grasps that do not slide at present.
    """

    hands: tuple[Hand, ...]
    grasps: dict[str, Grasp]
    spent: frozenset[str]
    sticking: frozenset[str]


def taking_part(segment: Segment, by: Reached | None) -> Taking:
    """Return the hands that may begin to slide, stop, or open at an instant.

    These are all that slide, those whose margins are spent, and all balls and soft fingers, whose impulses have the
    same cones as their forces.
    """
    chain, spent = segment.environment.chain, frozenset[str]() if by is None else by.spent
    nothing = by is None and chain.touching is None and not segment.hands
    if segment.settings.policy.on_slip != SLIDE or nothing:
        return Taking(segment.hands, {}, spent, frozenset())
    held = {}
    for name, grasp in chain.grasps.items():
        if may_slide(grasp) and (name in spent or grasp.of_kind.size != "half_length"):
            held[name] = grasp
    sticking: set[str] = set()
    if segment.contacts is not None:
        owners = point_owners(segment.hands)
        moving = segment.contacts.mode[len(segment.contacts.mode) - len(owners) :] != ContactMode.STICKS
        sliding = {segment.hands[i].arm for i, moves in zip(owners, moving, strict=True) if moves}
        sticking = {hand.arm for hand in segment.hands} - sliding
    hands = (*segment.hands, *(Hand(name, grasp) for name, grasp in held.items()))
    return Taking(hands, held, spent, frozenset(sticking))


def hands_after(
    chain: ClosedChain, found: Decision, taking: Taking, t: float
) -> tuple[dict[str, Grasp], ContactModes, list[Occurrence]]:
    """Return the grasps and the modes from an instant on, and entries for the log.

    A hand that sticks gets a grasp where its tip is. If it shares the load with the world, and forces are not unique,
    as with rigid arms above a table, it stays a contact that sticks: a grasp would take the whole load.

    Args:
        chain: the chain without the hands that took part.
        found: the decision.
        taking: these hands.
        t: time [s].
    """
    modes, owners = found.modes, np.array(point_owners(taking.hands), int)
    of_world = len(modes.mode) - len(owners)
    alone = not (modes.mode[:of_world] != ContactMode.OPEN).any()
    holds, slides, news = [], [], []
    for i, hand in enumerate(taking.hands):
        points = of_world + np.flatnonzero(owners == i)
        mode = modes.mode[points]
        held = hand.arm in taking.grasps or hand.arm in taking.sticking
        impulse = found.impulse[points].sum(axis=0)
        pushed: tuple[float, ...] = tuple(impulse.tolist()) if impulse.any() else ()
        if (mode == ContactMode.STICKS).all():
            grips = (
                alone
                or found.status is ContactStatus.OK
                or (hand.arm in taking.grasps and hand.arm not in taking.spent)
            )
            (holds if grips else slides).append(hand)
            if not held:
                news.append(Occurrence(t, "stick", hand.arm, f"'{hand.arm}' holds again where it is", impulse=pushed))
        elif (mode == ContactMode.OPEN).all():
            text = f"'{hand.arm}' lifts off and is released"
            news.append(Occurrence(t, "release", hand.arm, text, impulse=pushed))
        else:
            slides.append(hand)
            if held:
                news.append(Occurrence(t, "slip", hand.arm, f"'{hand.arm}' slips", impulse=pushed))
    keep = np.array([*range(of_world), *(of_world + k for k, i in enumerate(owners) if taking.hands[i] in slides)], int)
    width = 4 if any(hand.torsion_radius for hand in slides) else 3
    again = {**chain.grasps, **regripped(chain, found.state, holds, taking.grasps)}
    grasps = {name: again[name] for name in chain.names if name in again}
    begins = frozenset(new for new, old in enumerate(keep.tolist()) if old in modes.begins)
    return grasps, ContactModes(modes.mode[keep], modes.slip[keep, :width], tuple(slides), begins), news


def same_hands(a: Sequence[Hand], b: Sequence[Hand]) -> bool:
    """Return whether the same hands slide."""
    return [one.arm for one in a] == [one.arm for one in b]
