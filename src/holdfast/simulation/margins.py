"""The margins of a run: how they are computed, what happens when one is violated, and since when each is violated.

All margins of an instant form one array of signals, whose layout does not depend on the grasps: first one margin per
arm for its grasp [N], then the margins of all joints for position [rad or m], rate [rad/s or m/s] and effort [N m or
N]. A margin is infinite if there is no limit, and negative if the limit is violated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self, get_args

import numpy as np

from holdfast.dynamics.result import Status
from holdfast.errors import ModelError
from holdfast.forces.margin_interval import margin_range
from holdfast.forces.margins import JointLimits, conditions, joint_limits, margins_of_joints
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.simulation.bracket import crossing
from holdfast.simulation.events import Occurrence
from holdfast.simulation.instant import Instant
from holdfast.simulation.verification import CROSSING, MarginCurves, StepMargins
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate

Quantity = Literal["grasp", "position", "rate", "effort", "gap", "normal force", "friction", "slip"]
JOINT_QUANTITIES: tuple[Quantity, ...] = ("position", "rate", "effort")
SAME_MARGIN = 1e-9  # relative to the wrench: margins that differ by less reach zero together


@dataclass(frozen=True, eq=False)
class Signals:
    """The layout and evaluation of a chain's margins.

    Attributes:
        chain: the chain with its current grasps.
    """

    chain: ClosedChain

    def __len__(self) -> int:
        return len(self.chain.arms) + 3 * self.chain.joint_count

    @cached_property
    def names(self) -> list[str]:
        """Name of each signal: the arms, then three times the joints as 'arm/joint'."""
        return [*self.chain.names, *3 * self.chain.joint_names()]

    @cached_property
    def quantities(self) -> list[Quantity]:
        """The quantity that each signal limits."""
        n = self.chain.joint_count
        grasps: list[Quantity] = ["grasp"] * len(self.chain.arms)
        return grasps + [quantity for quantity in JOINT_QUANTITIES for _ in range(n)]

    @cached_property
    def limited(self) -> Array:
        """Indices of the signals that have a limit; only these have to be evaluated."""
        chain = self.chain
        grasps = [name in chain.grasps and bool(conditions(chain.grasps[name])) for name in chain.names]
        return np.flatnonzero(np.array([*grasps, *joint_limits(chain).limited.flat]))

    @property
    def logged(self) -> Array:
        """Indices of the signals whose violations are logged."""
        return self.limited

    def of(self, at: Instant) -> Array:
        """Return all margins at an instant, (arms + 3 n,); see `of_each`."""
        return self.of_each([at])[0]

    def of_each(self, instants: Sequence[Instant]) -> Array:
        """Return all margins at several instants, (instants, arms + 3 n).

        If the grasp forces are not unique, a negative margin counts as a violation only if no internal force holds
        every grasp. The margin that the smallest forces give is then replaced by the best one (`margin_range`), which
        takes a tenth of a second.
        """
        q, qd, tau = (np.array(of_joints) for of_joints in zip(*(at.joints for at in instants), strict=True))
        grasps = np.full((len(instants), len(self.chain.arms)), np.inf)
        if self.grasps_limited:
            grasps = np.array([self._of_grasps(at) for at in instants])
        return np.concatenate([grasps, *margins_of_joints(self.joint_limits, q, qd, tau)], axis=1)

    def of_arrays(self, x: Mapping[str, Array]) -> Array:
        """Return all margins of systems with unique forces, (..., arms + 3 n), from their arrays by name."""
        grasps = np.full((*x["q"].shape[:-1], len(self.chain.arms)), np.inf)
        if self.grasps_limited:
            grasps = by_arm(self.chain, x["margin"])
        of_joints = margins_of_joints(self.joint_limits, x["q"], x["qd"], x["drive"])
        return np.concatenate([grasps, *of_joints], axis=-1)

    def undecided(self, x: Mapping[str, Array]) -> Array | bool:
        """Return of which systems `of_each` alone finds the margins, (...)."""
        return self.grasps_limited and x["rank"] != self.chain.constraint_row_count

    def _of_grasps(self, at: Instant) -> Array:
        """Return the margins of the grasps by arm, (arms,)."""
        given = at.grasp_margins
        if (given < 0).any() and at.result.status is Status.INDETERMINATE_FORCES:
            given = np.where(given < 0, margin_range(at.chain, at.state, at.result).together, given)
        return by_arm(self.chain, given)

    @cached_property
    def joint_limits(self) -> JointLimits:
        """The limits of the joints."""
        return joint_limits(self.chain)

    @cached_property
    def grasps_limited(self) -> bool:
        """Whether a grasp has a limit."""
        return any(conditions(grasp) for grasp in self.chain.grasps.values())

    def description(self, at: Instant, signal: int) -> str:
        """Return a sentence on what happens when the margin reaches zero."""
        name, quantity = self.names[signal], self.quantities[signal]
        if quantity != "grasp":
            return f"joint '{name}' reaches its {quantity} limit"
        grasp = self.chain.grasps[name]
        wrench = unrotate(at.state.object_frame.R @ grasp.frame.R, at.grasp_wrenches[signal])
        return f"grasp '{name}' {giving_way(grasp, wrench)}"


def freedom_names(chain: ClosedChain) -> list[str]:
    """Return 'arm/joint' names in the order of qd; that of a spherical joint occurs three times."""
    pairs = zip(chain.joint_names(), chain.all_joints, strict=True)
    return [name for name, joint in pairs for _ in range(joint.type.freedoms)]


def by_arm(chain: ClosedChain, margins: Array) -> Array:
    """Return the margins of the grasps by arm, (..., arms) for (..., grasps); infinite for an arm without a grasp."""
    found = np.full((*margins.shape[:-1], len(chain.arms)), np.inf)
    found[..., [chain.names.index(name) for name in chain.grasps]] = margins
    return found


def giving_way(grasp: Grasp, wrench: Array) -> str:
    """Return in words how a grasp fails under a wrench (6,) in contact axes that it cannot hold."""
    must = conditions(grasp)
    margins = [condition.margin(wrench) for condition in must]
    least = min(margins)
    if grasp.contact is not None and margins[1] <= least + SAME_MARGIN * float(np.abs(wrench).max()):
        return "lifts off"  # the other limits vanish with the normal force
    return must[margins.index(least)].broken


OnSlip = Literal["stop", "record", "release", "slide"]
OnLimit = Literal["record", "stop", "clip"]
OnSingular = Literal["stop", "continue"]


@dataclass(frozen=True)
class Policy:
    """What a run does at violations and at singular configurations.

    Attributes:
        on_slip: what to do when a grasp cannot hold: "stop" ends the run there; "record" logs it and continues as if
            the grasp held; "release" opens the grasp, and the arm continues without it; "slide" lets a hand that holds
            by friction slide on the object until it holds again or lifts off.
        on_limit: what to do when a joint exceeds a limit: "record" logs it; "stop" ends the run; "clip" clips torques
            to the effort limits (the margin is then 0) and records the other limits.
        on_singular: what to do at a configuration where the constraint loses rank: "stop" ends the run before it;
            "continue" passes through it if exactly one motion with continuous velocities leads through.
    """

    on_slip: OnSlip = "stop"
    on_limit: OnLimit = "record"
    on_singular: OnSingular = "stop"

    def __post_init__(self) -> None:
        for name, choices in (("on_slip", OnSlip), ("on_limit", OnLimit), ("on_singular", OnSingular)):
            given, known = getattr(self, name), get_args(choices)
            if given not in known:
                raise ModelError(
                    f"simulation: {name}: expected one of {', '.join(known)}, got {checks.short(given)}."
                    + checks.did_you_mean(str(given), known)
                )

    def acting(self, signals: Signals) -> Array:
        """Return the indices of the signals that end the step when they become negative."""
        acts = {"grasp": self.on_slip != "record"}
        acts |= dict.fromkeys(("gap", "normal force", "friction", "slip"), True)  # there, contacts change their modes
        return np.array(
            [i for i in signals.limited if acts.get(signals.quantities[i], self.on_limit == "stop")], dtype=int
        )


@dataclass(frozen=True, eq=False)
class ViolationTracker:
    """The margins of a run so far; every array has one entry per signal of `Signals`.

    Attributes:
        lowest: the lowest margin so far; infinite without a limit.
        since: time at which the present violation began [s]; infinite if there is none.
        depth: the lowest margin of the present violation; infinite if there is none.
        depth_time: time of that lowest margin [s].
    """

    lowest: Array
    since: Array
    depth: Array
    depth_time: Array

    @classmethod
    def blank(cls, signals: int) -> Self:
        """Return the tracker for the start of a run."""
        return cls(*(np.full(signals, np.inf) for _ in range(4)))

    @property
    def beyond(self) -> Array:
        """Whether a recorded violation goes on, (signals,)."""
        return np.isfinite(self.since)

    def at(self, t: float, margins: Array, signals: Signals, now: Any) -> tuple[Self, list[Occurrence]]:
        """Return the tracker after an instant that begins a stretch, and the occurrences to report.

        Args:
            t: time [s].
            margins: (signals,) at that time.
            signals: signals of the chain at that time.
            now: the instant, as `Signals.description` takes it.
        """
        if not (margins < 0.0).any() and np.isinf(self.since).all():
            return replace(self, lowest=np.minimum(self.lowest, margins)), []
        here = np.array([t]), margins[None]
        return self.followed([(i, *here) for i in signals.logged], signals, lambda _, i: signals.description(now, i))

    def after(self, found: StepMargins, curves: MarginCurves, signals: Signals) -> tuple[Self, list[Occurrence]]:
        """Return the tracker after a step, and the occurrences in it with refined zeros."""
        if not (found.margins < 0.0).any() and np.isinf(self.since).all():
            return replace(self, lowest=np.minimum(self.lowest, found.margins.min(axis=0))), []
        entries = []
        for i in signals.logged:
            entries.append((i, *self._with_zeros(int(i), found, curves)))
        return self.followed(entries, signals, lambda t, i: _description(curves, signals, t, i))

    def without(self, signal: int) -> Self:
        """Return the tracker with the present violation of a signal removed, because its limit no longer exists."""
        kept = {name: getattr(self, name).copy() for name in ("since", "depth", "depth_time")}
        for array in kept.values():
            array[signal] = np.inf
        return replace(self, **kept)

    def sized(self, signals: int) -> Self:
        """Return the tracker for another number of signals, the first of which are the same."""
        if signals == len(self.lowest):
            return self
        return type(self)(*(np.append(x, np.full(signals, np.inf))[:signals] for x in vars(self).values()))

    def _with_zeros(self, i: int, found: StepMargins, curves: MarginCurves) -> tuple[Array, Array]:
        """Return the times and margins of a signal during a step, with its changes of sign refined."""
        m = found.margins[:, i]
        # margins before the start belong to the last step, unless a dip before the start was found only in this step
        first = found.start if (m[0] < 0.0) != (m[found.start] < 0.0) else 0
        times, m = found.times[first:], m[first:]
        for k in np.flatnonzero(np.diff(m < 0.0)):
            ends = float(times[k]), float(m[k]), float(times[k + 1]), float(m[k + 1])
            crossing(curves.signal(i), *ends, CROSSING)
        evaluated, margins = curves.table()
        inside = (evaluated >= times[0]) & (evaluated <= times[-1])
        return evaluated[inside], margins[inside]

    def followed(
        self, entries: list[tuple[int, Array, Array]], signals: Signals, describe: Callable[[float, int], str]
    ) -> tuple[Self, list[Occurrence]]:
        """Return the tracker after times (k,) and margins (k, signals) for some signals, and the occurrences."""
        lowest, since, depth, when = (getattr(self, f).copy() for f in ("lowest", "since", "depth", "depth_time"))
        happened = []
        for i, times, margins in entries:
            name, quantity = signals.names[i], signals.quantities[i]
            for t, m in zip(times.tolist(), margins[:, i].tolist(), strict=True):
                lowest[i] = min(lowest[i], m)
                if m < 0.0 and np.isinf(since[i]):
                    since[i] = t
                    happened.append(Occurrence(t, "violation", name, describe(t, i), quantity))
                elif m >= 0.0 and np.isfinite(since[i]):
                    past = f"within limits again after {t - since[i]:.3g} s, at worst {depth[i]:.4g}"
                    lowest_at = float(depth[i]), float(when[i])
                    happened.append(Occurrence(t, "recovery", name, past, quantity, *lowest_at))
                    since[i] = depth[i] = when[i] = np.inf
                if m < min(depth[i], 0.0):
                    depth[i], when[i] = m, t
        happened.sort(key=lambda one: one.t)
        return replace(self, lowest=lowest, since=since, depth=depth, depth_time=when), happened


def _description(curves: MarginCurves, signals: Signals, t: float, i: int) -> str:
    reached = curves.advances.get(t)
    if reached is None or reached.instant is None:  # the time lies in the previous step
        return f"{signals.quantities[i]} margin of '{signals.names[i]}' is negative"
    return signals.description(reached.instant, i)
