"""The systems of a rollout between two steps, and their status."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import Enum
from typing import Any

import numpy as np

from holdfast.compiled.parameters import parameters_of
from holdfast.errors import FrozenError, StateError
from holdfast.forces.margins import joint_coordinates, joint_limits, margins_of_joints
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.questions.arrays import state_fields
from holdfast.simulation.resolution import least_difference
from holdfast.simulation.rollout.kernel import Systems
from holdfast.simulation.rollout.traced_step import RUNNING, UNRESOLVED
from holdfast.simulation.stability import cell, fastest_passive
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array
from holdfast.state import State


class RolloutStatus(Enum):
    """Whether a system is running, or why it has stopped at its last good state."""

    RUNNING = "goes on"
    SLIPPED = "a grasp's margin falls below the least allowed within the next step"
    SINGULAR = "the grasp constraint is singular, or its condition passes 1e12, here or within the next step"
    OPEN = "a grasp that closes is not there; or the next step, too long, leaves one open by more than 1e-2 (m or rad)"
    BROKEN = "its inputs are invalid, or the next step is not finite"
    TOO_LONG = "its steps are too long: it diverges, or the next shows a slip, limit or singularity that halves do not"
    LIMITED = "a joint passes a limit of its position, rate or effort within the next step"
    UNRESOLVED = "goes on, but a step was too long: its halves differ by more than 1 % of the largest velocity so far"
    UNLAWFUL = "no impulses that satisfy the laws of contact are found in the next step, nor in parts of it"


_ATTRIBUTES = ("chain", "arrays", "begin", "step_length", "call_inputs", "under", "started_from")
_STATUSES = np.array(list(RolloutStatus))


def _carried(key: str, meaning: str) -> Any:
    """Return a property for a carried array of the machine code; it has no columns if the chain has no such array."""

    def read(systems: RolloutSystems) -> Array:
        return read_only(systems.arrays.get(key, np.zeros((len(systems), 0))))

    return property(read, doc=meaning)


# arrays of systems whose steps may be too long: the fastest passive rate, and where in the space of joints it was found
PASSIVE_RATE, PASSIVE_CELL = PASSIVE = "passive_rate", "passive_cell"


@called
class RolloutSystems:
    """Many systems of one chain, advanced in place by `Rollout.step`.

    The first axis of every array is the system. The arrays are updated by the steps and are read-only; use
    `Rollout.start` for other states. A system that has stopped keeps its last good state, and its `status` gives the
    reason.

    Attributes:
        chain: the chain.
        arrays: the carried arrays of the machine code, by name.
        begin: (systems,) time from which the steps are counted [s].
        step_length: (systems,) length of these steps [s].
        call_inputs: the arguments of calls so far, with the names of the machine code, (1 or systems, ...) each. An
            argument acts until a call replaces it.
        under: the law and the wrenches with which the slopes were evaluated.
        started_from: the states before their projection at the start, by name; None after the first step.
    """

    q: Array = _carried("q", "(systems, n) joint positions [rad or m].")
    qd: Array = _carried("qd", "(systems, n) joint rates.")
    qdd: Array = _carried("qdd", "(systems, n) joint accelerations.")
    tau: Array = _carried("drive", "(systems, n) torques of the drives [N m or N].")
    object_pose: Array = _carried("object_pose", "(systems, 7) wxyz_xyz of the object frame.")
    object_twist: Array = _carried("object_twist", "(systems, 6) [omega; v of C], world axes.")
    object_acceleration: Array = _carried(
        "object_acceleration", "(systems, 6) [omega_dot; v_dot of C], true, world axes."
    )
    floating_pose: Array = _carried(
        "floating_pose", "(systems, 7) wxyz_xyz of a trunk's floating base; without columns where there is none."
    )
    floating_twist: Array = _carried("floating_twist", "(systems, 6) [omega; v of that frame's origin], world axes.")
    floating_acceleration: Array = _carried("floating_acceleration", "(systems, 6) its true acceleration.")
    trunk_base_wrench: Array = _carried(
        "trunk_base_wrench", "(systems, 6) [moment; force] of the base on a trunk about the base origin, world axes."
    )
    grasp_wrench: Array = _carried(
        "grasp_wrench",
        "(systems, arms, 6) [moment; force] of each arm on the object about the contact, world axes; where the forces"
        " are not unique, one solution. Of a chain with branches (systems, grasps and loops, 6).",
    )
    coupling_force: Array = _carried(
        "coupling_force",
        "(systems, couplings) forces of couplings, see `MechanismResult`; as unique as `grasp_wrench`.",
    )
    touch_force: Array = _carried(
        "touch_force",
        "(systems, k, 3) mean force of the world on the object at every candidate of `touching` in the last step, world"
        " axes [N]; with it the next step begins to look for its own.",
    )
    touch_gap: Array = _carried("touch_gap", "(systems, k) distances between the candidates and their shapes [m].")
    touch_mode: Array = _carried("touch_mode", "(systems, k) numbers of `ContactMode` in the last step.")
    memory: Array = _carried("memory", "(systems, m) what the control law carries on.")
    margin: Array = _carried(
        "margin",
        "(systems, grasps) margin of every grasp now [N], see `dynamics.margins`; infinite if nothing limits it.",
    )
    worst_margin: Array = _carried(
        "worst_margin", "(systems, grasps) the least margin at the end of any step so far [N]."
    )
    worst_time: Array = _carried("worst_time", "(systems, grasps) when that was [s].")
    work: Array = _carried(
        "work", "(systems, 4) work so far of drives, damping and friction, bases, external wrenches [J]."
    )

    def __init__(self, chain: ClosedChain, arrays: Systems, begin: Array, step_length: Array) -> None:
        self.chain, self.arrays, self.begin, self.step_length = chain, arrays, begin, step_length
        self.call_inputs: dict[str, Array] = {}
        self.under: tuple[object, ...] = ()
        self.started_from: dict[str, Array] | None = None

    def __len__(self) -> int:
        return len(self.begin)

    def __repr__(self) -> str:
        """Return the number of systems, their times and their status, on one line."""
        times = f"{self.t.min():g} s" if np.ptp(self.t) == 0 else f"{self.t.min():g} to {self.t.max():g} s"
        return f"<RolloutSystems: {len(self)} at t = {times}; {status_summary(self)}>"

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse assignments without effect: to the arrays of the machine code, and to unknown names."""
        if isinstance(getattr(type(self), name, None), property):
            raise FrozenError(
                f"systems: {name}: expected what the last step found to stay, as the next one begins with it; try"
                " `start` for other states"
            )
        if name not in _ATTRIBUTES:
            known = [n for n, x in vars(type(self)).items() if isinstance(x, property)]
            raise FrozenError(f"systems: no attribute '{name}'.{checks.did_you_mean(name, known)}")
        object.__setattr__(self, name, value)

    def state(self, system: int) -> State:
        """Return the state of one system, for `simulate` and other functions of a single state.

        Args:
            system: number of the system, from 0.

        Raises:
            StateError: there is no such system, or its inputs were invalid.
        """
        if isinstance(system, bool) or not isinstance(system, int | np.integer) or not 0 <= system < len(self):
            raise StateError(f"system: expected a number from 0 to {len(self) - 1}, got {checks.short(system)}")
        return State(**{field: self.arrays[name][system] for name, field in state_fields(self.chain).items()})

    @property
    def t(self) -> Array:
        """(systems,) time of each system [s], computed from the number of steps so that rounding does not add up."""
        return self.begin + self.arrays["count"] * self.step_length

    @property
    def joint_margin(self) -> Array:
        """(systems, 3, n) margins of position, rate and effort, see `joint_margins`; infinite without a limit."""
        q, qd, drive = (self.arrays[name] for name in ("q", "qd", "drive"))
        found = margins_of_joints(joint_limits(self.chain), joint_coordinates(self.chain, q), qd, drive)
        return read_only(np.stack(found, axis=1))

    @property
    def gap(self) -> Array:
        """(systems, 2) the largest gap of any grasp, in position [m or rad] and in velocity."""
        return read_only(self.arrays["gaps"][:, 2:])

    @property
    def drift(self) -> Array:
        """(systems, 2) the largest gap of any grasp after the last step, before projection."""
        return read_only(self.arrays["gaps"][:, :2])

    @property
    def step_error(self) -> Array:
        """(systems,) largest difference of velocities so far between a step and its halves [rad/s or m/s].

        Only steps that may not follow the motion are compared with their halves, and differences that do not count are
        left out.
        """
        return read_only(resolution_of(self)[-1].copy())

    @property
    def status(self) -> Array:
        """(systems,) status of each system, a `RolloutStatus`."""
        return _STATUSES[status_codes(self)]

    @property
    def running(self) -> Array:
        """(systems,) whether each system is running."""
        return self.arrays["code"] == 0.0

    def set_step_length(self, step: Array) -> None:
        """Set the length of the next steps, (systems,) [s]."""
        if step is not self.step_length and (changed := self.step_length != step).any():
            self.begin = np.where(changed, self.t, self.begin)
            self.arrays["count"][changed] = 0.0
            self.step_length = step

    def keep_inputs(self, given: Mapping[str, Array], *under: object) -> bool:
        """Store the arguments of a call until they are replaced; return whether the inputs may have changed.

        Args:
            given: arrays with the names of the machine code, (1 or systems, ...) each.
            under: the law and the additional wrenches.
        """
        new = {name: np.array(x) for name, x in given.items() if not np.array_equal(x, self.call_inputs.get(name, ()))}
        changed = bool(new) or [*map(id, self.under)] != [*map(id, under)]
        self.call_inputs, self.under = self.call_inputs | new, under
        return changed

    def copy(self, rows: Any = None) -> RolloutSystems:
        """Return a copy of the systems, or of some of them, selected by numbers or by a boolean mask.

        Raises:
            StateError: there are no such systems.
        """
        which = slice(None) if rows is None else self._rows(rows)
        arrays = {name: x[which].copy() for name, x in self.arrays.items()}
        made = RolloutSystems(self.chain, arrays, self.begin[which].copy(), self.step_length[which].copy())
        made.call_inputs = {name: x if len(x) == 1 else np.array(x[which]) for name, x in self.call_inputs.items()}
        made.under = self.under
        if self.started_from is not None:
            made.started_from = {name: x[which].copy() for name, x in self.started_from.items()}
        return made

    def _rows(self, rows: Any) -> Any:
        """Return which systems, as an index that keeps the first axis."""
        if isinstance(rows, slice):
            return rows
        with suppress(IndexError, ValueError, TypeError):
            which = np.atleast_1d(rows) if np.size(rows) else np.zeros(0, dtype=int)
            if which.ndim == 1 and np.empty(len(self))[which].ndim == 1:
                return which
        raise StateError(
            f"rows: expected numbers from 0 to {len(self) - 1} or {len(self)} truth values, got {checks.short(rows)}"
        )

    def freed(self, rows: Array) -> RolloutSystems:
        """Return copies of some systems with the status running."""
        found = self.copy(rows)
        found.arrays["code"][...] = 0.0
        return found

    def put(self, rows: Array, other: RolloutSystems) -> None:
        """Replace the systems with the given numbers by other systems; arrays that these lack become NaN."""
        for name, x in self.arrays.items():
            x[rows] = other.arrays.get(name, np.nan)
        self.begin[rows], self.step_length[rows] = other.begin, other.step_length

    def reset(self, rows: Any, other: RolloutSystems) -> None:
        """Set some systems to others that `Rollout.start` returned, with the arguments that it was given. O(rows).

        An argument that it was not given keeps its value in these rows; accelerations and forces are those of the start
        until the next step. An argument that was common to all systems, and differs for the new ones, gets a row for
        each system.

        Args:
            rows: the systems to replace, as numbers or as a boolean mask.
            other: as many systems of the same rollout.

        Raises:
            StateError: there are no such systems, the numbers of systems differ, or `other` belongs to another rollout.
        """
        checks.instance(other, RolloutSystems, "reset: other", StateError)
        which = np.arange(len(self))[self._rows(rows)]
        if len(which) != len(other):
            raise StateError(f"reset: expected {len(which)} systems for as many rows, got {len(other)}")
        here, there = self.arrays.keys(), other.arrays.keys()
        alike = all(self.arrays[name].shape[1:] == other.arrays[name].shape[1:] for name in here & there)
        if not alike or (here ^ there) - {*PASSIVE}:
            raise StateError("reset: expected systems of the same rollout, got others; try its `start`")
        mine_alone = self.call_inputs.keys() - other.call_inputs.keys()
        theirs_alone = other.call_inputs.keys() - self.call_inputs.keys()
        for name in sorted(name for name in mine_alone | theirs_alone if name.startswith("control.")):
            own, called = ("these", "the fresh `start`") if name in mine_alone else ("the fresh", "these systems'")
            raise StateError(
                f"reset: {own} systems have their own {name.removeprefix('control.')}; pass it to {called} too"
            )
        self.put(which, other)  # an array that only one of them has is in PASSIVE, and is computed again
        if mine_alone:
            self.under = ()  # the slopes of these rows were evaluated with other values
        chains = parameters_of(self.chain, None) if theirs_alone else {}
        for name, x in other.call_inputs.items():
            mine = self.call_inputs.get(name)
            if mine is None:
                mine = self.call_inputs[name] = np.array(chains.get(name, np.zeros(x.shape[1:])))[None]
            if len(mine) == 1 and not (len(x) == 1 and np.array_equal(x, mine)):
                mine = self.call_inputs[name] = np.repeat(mine, len(self), axis=0)
            if len(mine) == len(self):
                mine[which] = x
        if self.started_from is not None and other.started_from is not None:
            for name, x in other.started_from.items():
                self.started_from[name][which] = x
        else:
            self.started_from = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without the law, which may be a function that cannot be pickled."""
        return vars(self) | {"under": ()}


def resolution_of(systems: RolloutSystems) -> Array:
    """Return the numbers of `simulation.resolution.Resolution`, (4, systems); zeros for implicit steps."""
    return systems.arrays.get("resolution", np.zeros((len(systems), 4))).T


def status_codes(systems: RolloutSystems) -> Array:
    """Return the number of each system's status, (systems,)."""
    largest, _, _, off = resolution_of(systems)
    code = systems.arrays["code"].astype(int)
    return np.where((code == RUNNING) & (off > least_difference(largest)), UNRESOLVED, code)


def require_recorded(names: Any) -> None:
    """Refuse names that are not those of arrays of systems.

    Raises:
        StateError: there is such a name; the message gives the first.
    """
    if not checks.is_listed(names):
        raise StateError(f"record: expected names of arrays, got {checks.short(names)}")
    known = [name for name, x in vars(RolloutSystems).items() if isinstance(x, property)]
    for name in names:
        if name not in known:
            raise StateError(f"record: no array {checks.short(name)}.{checks.did_you_mean(str(name), known)}")


def status_summary(systems: RolloutSystems) -> str:
    """Return the number of systems with each status, in words."""
    names, counts = np.unique([status.name.lower() for status in systems.status], return_counts=True)
    return ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))


def passive_rates(
    systems: RolloutSystems, located: Callable[[RolloutSystems, int], tuple[ClosedChain, State]]
) -> Array:
    """Return the fastest passive rate of each system [1/s], recomputed for systems whose joints have moved far.

    Args:
        systems: the systems; their rates are stored among their arrays.
        located: returns the chain of one system, its grasps and bases those of the system, and its state.
    """
    cells, count = cell(systems.q), len(systems)
    known = systems.arrays.setdefault(PASSIVE_CELL, np.full(cells.shape, np.nan))
    rates = systems.arrays.setdefault(PASSIVE_RATE, np.zeros(count))
    for row in np.flatnonzero(systems.running & (known != cells).any(axis=1)).tolist():
        rates[row] = fastest_passive(*located(systems, row))[0].rate
        known[row] = cells[row]
    return rates
