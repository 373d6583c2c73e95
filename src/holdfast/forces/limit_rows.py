"""Limits as cones in the unknowns v of the acceleration map: s = h - G v in K, with the weight by which each gives way.

Per newton of violation, a torque gives way by L, a sliding joint's force and a condition of a grasp by 1 N, and an
acceleration by 1 rad/s^2 or m/s^2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.dynamics.contact.touching_chain import CLOSED
from holdfast.errors import ModelError, StateError
from holdfast.forces.affine_map import AccelerationMap
from holdfast.forces.limits import ForceLimits
from holdfast.forces.margins import conditions
from holdfast.forces.touched_object import contact_names, normal_row, pressing_contacts
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.joint import Joint
from holdfast.model.wrench_condition import NORMAL
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum, sqrt
from holdfast.state import State


class Noun(NamedTuple):
    """The limit to which a condition belongs, and on which side of it it is, if it has sides."""

    limit: str
    side: str = ""


NOUNS = {  # of `Condition.broken`
    "slips": Noun("friction"),
    "lifts off": Noun("pressing"),
    "tips over its edge": Noun("edge"),
    "tips over its front edge": Noun("edge", "front"),
    "tips over its side edge": Noun("edge", "side"),
    "gives way to the force": Noun("force rating"),
    "gives way to the moment": Noun("moment rating"),
}


class Limit(NamedTuple):
    """One limit, s = h - G v in the half line or a second-order cone.

    Attributes:
        of: the joint or arm.
        what: "effort", "friction", ...
        side: "upper", "lower", or nothing.
        weight: by how much s_0 grows when the limit gives way by 1 N.
        G: (r, m) matrix.
        h: (r,) right side.
        unit: its unit, in which prices are given.
        bound: size of an effort limit that a peak multiplies; 0 for other limits.
        by_margin: whether it is a condition of a grasp, to which a margin adds up.
    """

    of: str
    what: str
    side: str
    weight: float
    G: Array
    h: Array
    unit: str = "N"
    bound: float = 0.0
    by_margin: bool = False

    @property
    def name(self) -> str:
        """Its name, such as "left/joint3 effort", which both sides share."""
        return f"{self.of} {self.what}"

    @property
    def words(self) -> str:
        """Its name in a sentence."""
        return f"{self.of} at its {self.side} {self.what} limit" if self.side else f"{self.what} of {self.of}"


def limit_rows(found: AccelerationMap, state: State, limits: ForceLimits) -> list[Limit]:
    """Return all limits at a state: those on torques first, then those on grasps and on accelerations.

    Args:
        found: the map.
        state: positions and rates, for the limits of a sampled controller.
        limits: the limits.

    Raises:
        ModelError, StateError: a name is unknown, or a shape is wrong.
    """
    on_forces = [*_of_grasps(found, limits), *_of_contacts(found, limits)]
    return [*_of_efforts(found, limits), *on_forces, *_of_accelerations(found, state, limits)]


def _of_efforts(found: AccelerationMap, limits: ForceLimits) -> Iterator[Limit]:
    if limits.effort is None:
        return
    for (name, joint), row, at_rest in zip(joint_components(found.chain), found.T, found.t, strict=True):
        bound = limits.effort * joint.effort_limit if math.isfinite(joint.effort_limit) else math.inf
        if math.isfinite(bound):
            weight, unit = (found.length, "N m") if joint.turns else (1.0, "N")
            yield Limit(name, "effort", "upper", weight, row[None], np.array([bound - at_rest]), unit, bound)
            yield Limit(name, "effort", "lower", weight, -row[None], np.array([bound + at_rest]), unit, bound)


def _of_grasps(found: AccelerationMap, limits: ForceLimits) -> Iterator[Limit]:
    chain, size = found.chain, len(found.v0)
    names = () if found.touched is None else contact_names(chain)
    demanded, least, most = (
        limits.of_grasps(name, chain, names) for name in ("least_margin", "least_normal", "most_normal")
    )
    for one in found.grasps:
        name, c, part = one.name, one.contact, one.part
        to_contact, fixed = np.zeros((6, size)), np.zeros(6)
        if one.known is None:
            to_contact[:, part] = _rotated(c.frame.T, c.K.T)
        else:
            fixed = _rotated(c.frame.T, one.known[:, None])[:, 0]
        for k in conditions(c.grasp):
            if not math.isfinite(k.constant):
                continue
            loads = k.loading if np.any(k.loading) else np.zeros((0, 6))
            rows = np.vstack([k.pressing, loads])
            h = rows @ fixed
            h[0] += k.constant - demanded.get(one.key, 0.0)
            what = NOUNS[k.broken]
            yield Limit(name, what.limit, what.side, 1.0, -rows @ to_contact, h, by_margin=True)
        for what, sign, bounds in (("least normal force", 1.0, least), ("most normal force", -1.0, most)):
            if one.key in bounds:
                h = np.array([sign * (NORMAL @ fixed - bounds[one.key])])
                yield Limit(name, what, "", 1.0, -sign * (NORMAL @ to_contact)[None], h, by_margin=True)
        if limits.last_wrench is not None and one.known is None:
            last = checks.numbers(limits.last_wrench, (found.wrench_rows, 6), "limits: last_wrench", StateError)
            per_unit = 1.0 / np.array(c.grasp.of_kind.row_scales(found.length))
            G = np.zeros((1 + len(per_unit), size))
            G[1:, part] = -np.diag(per_unit)
            h = np.r_[limits.wrench_change, -per_unit * (c.K @ last[one.row])]
            yield Limit(name, "wrench change", "", 1.0, G, h)


def _of_contacts(found: AccelerationMap, limits: ForceLimits) -> Iterator[Limit]:
    """Yield the limits of contacts with the world: their modes, and bounds on normal forces by name."""
    touched, size, touching = found.touched, len(found.v0), found.chain.touching
    names = () if touched is None else contact_names(found.chain)
    demanded, least, most = (
        limits.of_contacts(name, names) for name in ("least_margin", "least_normal", "most_normal")
    )
    if touched is None or touching is None:
        return
    for name in demanded:
        if name not in touching.names:
            raise ModelError(f"limits: least_margin: expected one contact, such as '{touching.names[0]}', got '{name}'")
    for one in touched.places:
        sticks = one.mode is ContactMode.STICKS
        G, h = np.zeros((3 if sticks else 1, size)), np.zeros(3 if sticks else 1)
        part = slice(found.touch.start + one.part.start, found.touch.start + one.part.stop)
        G[:, part] = -one.gives[:, [2, 0, 1]].T if sticks else -1.0
        G[0, part] *= one.friction if sticks else 1.0
        h[0] = -demanded.get(one.name, 0.0)
        yield Limit(one.name, "friction" if sticks else "pressing", "", 1.0, G, h)
    for what, sign, bounds in (("least normal force", 1.0, least), ("most normal force", -1.0, most)):
        for name, bound in bounds.items():
            G = np.zeros((1, size))
            G[0, found.touch] = -sign * normal_row(touched, pressing_contacts(found.chain, name, "limits"))
            yield Limit(name, what, "", 1.0, G, np.array([-sign * bound]))


def same_modes(found: AccelerationMap, more: Array) -> list[Limit]:
    """Return the limit sigma >= 0 on an acceleration sigma more, if contacts would do something else with sigma < 0."""
    touched = found.touched
    size = float(more @ more)
    if touched is None or not size or not (touched.rows.C[touched.rows.gap <= CLOSED] @ more).any():
        return []
    G = np.zeros((1, len(found.v0)))
    G[0, found.alpha] = -more / size
    return [Limit("contacts", "direction", "", 1.0, G, np.zeros(1), "share")]


def _rotated(R: Array, columns: Array) -> Array:
    """Return [moment; force] columns (6, k) in other axes."""
    return np.vstack([R @ columns[:3], R @ columns[3:]])


def _of_accelerations(found: AccelerationMap, state: State, limits: ForceLimits) -> Iterator[Limit]:
    ranges = acceleration_ranges(found.chain, state, limits)
    for j, ((name, joint), low, high) in enumerate(zip(joint_components(found.chain), *ranges, strict=True)):
        G = np.zeros((1, len(found.v0)))
        G[0, found.qdd.start + j] = 1.0
        unit = "rad/s^2" if joint.turns else "m/s^2"
        if math.isfinite(high):
            yield Limit(name, "acceleration", "upper", 1.0, G, np.array([high]), unit)
        if math.isfinite(low):
            yield Limit(name, "acceleration", "lower", 1.0, -G, np.array([-low]), unit)


def joint_components(chain: ClosedChain) -> list[tuple[str, Joint]]:
    """Return name and joint for every component of the joints' qd; a spherical joint has three."""
    return [
        (name, joint)
        for name, joint in zip(chain.joint_names(), chain.all_joints, strict=True)
        for _ in range(joint.type.freedoms)
    ]


def acceleration_ranges(chain: ClosedChain, state: State, limits: ForceLimits) -> Array:
    """Return the lowest and highest joint accelerations, (2, n); infinite without a limit.

    Raises:
        ModelError: a joint does not exist.
    """
    names = chain.joint_names()
    for name in limits.acceleration:
        if name not in names:
            raise ModelError(f"limits: acceleration: no joint '{name}'.{checks.did_you_mean(str(name), names)}")
    low, high, at_q, at_v = [], [], 0, 0
    for name, joint in zip(names, chain.all_joints, strict=True):
        q, rates = state.q[at_q], [state.qd[at_v + i] for i in range(joint.type.freedoms)]
        lowest, highest = limits.acceleration.get(name, (-math.inf, math.inf))
        for qd in rates:
            down, up = [-lowest], [highest]
            if limits.sample_time is not None and not joint.type.quaternion:
                first, last = joint.position_limits
                own = joint.rate_limit, limits.sample_time, limits.braking
                down.append(highest_acceleration(math.inf if math.isinf(first) else q - first, -qd, *own))
                up.append(highest_acceleration(math.inf if math.isinf(last) else last - q, qd, *own))
            low.append(-_least(down))
            high.append(_least(up))
        at_q, at_v = at_q + joint.type.position_count, at_v + joint.type.freedoms
    return array([low, high])


def highest_acceleration(way: Scalar, qd: Scalar, rate: float, T: float, braking: float) -> Scalar:
    """Return the highest acceleration x, constant for a period T, after which a joint keeps its limits.

    qd + x T <= rate, q + qd T + x T^2 / 2 <= q_max, and from there it can still stop before q_max with the given
    deceleration, (qd + x T)^2 <= 2 a (q_max - q - qd T - x T^2 / 2) if it moves towards it. Where that takes more, as
    beyond a limit, x is -2 a: a joint that is slightly beyond comes back, and none is thrown back within one period.

    Args:
        way: q_max - q [rad or m]; infinite without a limit.
        qd: its rate.
        rate: largest rate.
        T: period [s].
        braking: a, the deceleration at which it can stop.

    Reference:
        A. Del Prete, Joint position and velocity bounds in discrete-time acceleration/torque control of robot arms,
        IEEE Robotics and Automation Letters, 2018.
    """
    bounds = [] if math.isinf(rate) else [(rate - qd) / T]
    if not _infinite(way):
        root = (braking * T) ** 2 + 8.0 * braking * way - 4.0 * braking * qd * T
        stopping = (-(2.0 * qd + braking * T) + sqrt(maximum(root, 0.0))) / (2.0 * T)
        bounds += [2.0 * (way - qd * T) / T**2, maximum(-qd / T, stopping)]
    return maximum(_least(bounds), -2.0 * braking) if bounds else math.inf


def _least(bounds: Sequence[Scalar]) -> Scalar:
    """Return the smallest of bounds; those that are known to be infinite stay out of the program."""
    return reduce(minimum, [x for x in bounds if not _infinite(x)] or [math.inf])


def _infinite(x: Scalar) -> bool:
    return isinstance(x, float) and math.isinf(x)
