"""<joint> elements."""

from __future__ import annotations

import math

import numpy as np

from holdfast.model import checks
from holdfast.model.joint import UNBOUNDED
from holdfast.robots.urdf import attributes
from holdfast.robots.urdf.document import Element, quoted
from holdfast.robots.urdf.robot import MOVING, UNSUPPORTED, Mimic, UrdfJoint
from holdfast.robots.urdf.vocabulary import read_words

_PARTS = ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic")


def read_joint(element: Element) -> UrdfJoint:
    """Return a joint; axis, limits and friction of one that cannot move mean nothing and are not read."""
    notes = list(read_words(element))
    for part in element.children:
        notes += read_words(part) if part.tag in _PARTS else ()
    kind = _kind(element)
    moving = kind in MOVING
    position_limits, rate_limit, effort_limit = _limits(element, kind, notes) if moving else (UNBOUNDED, np.inf, np.inf)
    damping, friction = _losses(element) if moving else (0.0, 0.0)
    return UrdfJoint(
        name=attributes.name(element),
        kind=kind,
        parent=attributes.name(element.required("parent"), "link"),
        child=attributes.name(element.required("child"), "link"),
        origin=attributes.pose(element.first("origin")),
        axis=_axis(element, notes) if moving else np.array([1.0, 0.0, 0.0]),
        position_limits=position_limits,
        rate_limit=rate_limit,
        effort_limit=effort_limit,
        damping=damping,
        friction=friction,
        mimic=_mimic(element) if moving else None,
        element=element,
        notes=tuple(notes),
    )


def _kind(element: Element) -> str:
    """Return the joint's type, one that URDF or its dialects know."""
    kind = attributes.name(element, "type")
    known = (*MOVING, "fixed", *UNSUPPORTED)
    if kind not in known:
        raise element.refuse(
            f"type: expected one of {', '.join(known)}, got {quoted(kind)}.{checks.did_you_mean(kind, known)}"
        )
    return kind


def _axis(element: Element, notes: list[str]) -> np.ndarray:
    """Return the unit axis; x where none is given, as the format says."""
    if (axis := element.first("axis")) is not None:
        return attributes.axis(axis)
    notes.append(element.said("no <axis>, taken as 1 0 0"))
    return np.array([1.0, 0.0, 0.0])


def _losses(element: Element) -> tuple[float, float]:
    """Return viscous damping and Coulomb friction."""
    if (dynamics := element.first("dynamics")) is None:
        return 0.0, 0.0
    damping, friction = (attributes.number(dynamics, key, 0.0, at_least=0.0) for key in ("damping", "friction"))
    return damping, friction


def _mimic(element: Element) -> Mimic | None:
    """Return which joint this one follows, if it does."""
    if (mimic := element.first("mimic")) is None:
        return None
    followed = attributes.name(mimic, "joint")
    multiplier, offset = attributes.number(mimic, "multiplier", 1.0), attributes.number(mimic, "offset", 0.0)
    return Mimic(followed, multiplier, offset)


def _limits(element: Element, kind: str, notes: list[str]) -> tuple[tuple[float, float], float, float]:
    """Return limits of position, rate and effort, infinite where the file gives none.

    Programs that write URDF fill in zeros for what they do not know. A joint that may not
    move at all would be a fixed one, so a rate, an effort or a range of zero counts as not
    given, and is noted.
    """
    limit = element.first("limit")
    if limit is None:
        if kind != "continuous":
            notes.append(element.said("no <limit>, taken as unlimited"))
        return UNBOUNDED, math.inf, math.inf
    rate, effort = (_bound(limit, key, notes) for key in ("velocity", "effort"))
    lower, upper = attributes.limit(limit, "lower"), attributes.limit(limit, "upper")
    if kind == "continuous":
        if lower is not None or upper is not None:
            notes.append(limit.said("lower, upper: not read, since a continuous joint has none"))
        return UNBOUNDED, rate, effort
    low, high = lower or 0.0, upper or 0.0  # one alone: the format says 0 for the other
    if low == high == 0.0:
        notes.append(limit.said("lower, upper: a range of 0, taken as unlimited"))
        return UNBOUNDED, rate, effort
    if low > high:
        raise limit.refuse(f"expected lower <= upper, got {low:g} and {high:g}")
    return (low, high), rate, effort


def _bound(limit: Element, key: str, notes: list[str]) -> float:
    """Return the largest rate or effort; infinite for none and for zero."""
    value = attributes.limit(limit, key)
    if value is None or value == 0.0:
        notes.append(limit.said(f"{key}: {'missing' if value is None else '0'}, taken as unlimited"))
        return math.inf
    if value < 0:
        raise limit.refuse(f"{key}: expected >= 0, got {value!r}")
    return value
