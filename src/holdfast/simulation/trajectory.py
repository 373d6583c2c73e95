"""Simulated runs: their samples, and the interpolated state at any time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NoReturn, Self

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from holdfast.errors import ModelError, StateError
from holdfast.forces.wrist import WRISTS
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import grasp_rows
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called
from holdfast.questions.arrays import ARRAYS, RAD, RATE, TORQUE, Row
from holdfast.simulation.balance import WORK_TERMS, imbalance, momentum_imbalance
from holdfast.simulation.events import Occurrence, ending
from holdfast.simulation.interpolant import Knot, interpolant
from holdfast.simulation.margins import JOINT_QUANTITIES
from holdfast.simulation.run_outputs import RunOutputs
from holdfast.simulation.setting import Setting
from holdfast.spatial.frozen import NOT_GIVEN, Frozen, read_only
from holdfast.spatial.scalar import Array
from holdfast.state import State

# Lowest values since the sample before, and what tells when and where these were.
LOWEST = {
    "lowest_margin": ("lowest_margin_time",),
    "lowest_joint_margin": ("lowest_joint_margin_time", "lowest_joint"),
}
# of a floating base, and of any trunk; results of 0.1 have no such arrays
BASE_FIELDS = ("base_pose", "base_twist", "base_acceleration")
TRUNK_FIELDS = (*BASE_FIELDS, "trunk_base_wrench")
TOUCH_FIELDS = ("touch_force", "touch_gap", "touch_mode", "touch_margin", "touch_status")
# arrays that a run without trunk, couplings and contacts with the world need not give; results of 0.1 lack them
EMPTY_FIELDS = (*TRUNK_FIELDS, "coupling_force", *TOUCH_FIELDS)
# what a run of a chain with branches, loops, couplings or several objects does not determine
NOT_OF_FORESTS = (
    "internal_wrench", "load_share", "wrist_wrench", "base_wrench", "spin", "best_margin", "worst_margin", "momentum",
    "momentum_rate", "base_impulse", "trunk_base_wrench",
)  # fmt: skip


class ArrayNotRecorded(StateError):
    """A run does not contain an array."""


class NotRecorded(NDArrayOperatorsMixin):
    """Stands for an array that a run does not contain; whatever is asked of it raises an error that names the array."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __repr__(self) -> str:
        return f"<'{self._name}' was not recorded>"

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        never = " (runs of chains with branches never have it)" if self._name in NOT_OF_FORESTS else ""
        raise ArrayNotRecorded(
            f"run: '{self._name}' was not recorded{never}; try simulate(..., record=[..., '{self._name}']), or record="
            '"everything"'
        )

    __array__ = __array_ufunc__ = __array_function__ = __getitem__ = __len__ = __iter__ = __float__ = _refuse

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # of copies and pickles
            raise AttributeError(name)
        self._refuse()


@called
@dataclass(frozen=True, eq=False)
class Trajectory(Frozen, RunOutputs):
    """The samples of a run; the first axis of every array is the sample.

    The rows of grasp_wrench, holding and margins are the arms. Those of a chain with branches, loops, couplings or
    several objects are its grasps and then its loops, with the names `rows`.

    There is a sample at the end of every step, unless `every` says otherwise. Shapes are those of one sample: a single
    sample has the same fields without the first axis. Arrays of a trunk or of a floating base have the shape (0,)
    without one. Times increase. If torques, inputs or grasps jump, there are two samples whose times differ by 1e-15 s
    or by one unit in the last place. `RUN_ARRAYS` lists the arrays as data. An array that was not recorded raises a
    `StateError` when it is used.

    Attributes:
        every: number of steps between two samples.
        stopped: None for a run that reached its end, otherwise the reason why it ended.
        occurrences: the log in order of time: grasps that closed or opened, limits that were passed, and so on.
        setting: chain, base motions and arguments of the run; None for a run that was assembled from arrays.
    """

    t: Array
    q: Array = NOT_GIVEN
    qd: Array = NOT_GIVEN
    qdd: Array = NOT_GIVEN
    tau: Array = NOT_GIVEN
    object_pose: Array = NOT_GIVEN
    object_twist: Array = NOT_GIVEN
    object_acceleration: Array = NOT_GIVEN
    grasp_wrench: Array = NOT_GIVEN
    internal_wrench: Array = NOT_GIVEN
    load_share: Array = NOT_GIVEN
    wrist_wrench: Array = NOT_GIVEN
    base_wrench: Array = NOT_GIVEN
    holding: Array = NOT_GIVEN
    spin: Array = NOT_GIVEN
    margin: Array = NOT_GIVEN
    best_margin: Array = NOT_GIVEN
    worst_margin: Array = NOT_GIVEN
    lowest_margin: Array = NOT_GIVEN
    lowest_margin_time: Array = NOT_GIVEN
    lowest_joint_margin: Array = NOT_GIVEN
    lowest_joint_margin_time: Array = NOT_GIVEN
    lowest_joint: Array = NOT_GIVEN
    position_gap: Array = NOT_GIVEN
    velocity_gap: Array = NOT_GIVEN
    kinetic: Array = NOT_GIVEN
    potential: Array = NOT_GIVEN
    work: Array = NOT_GIVEN
    impact: Array = NOT_GIVEN
    momentum: Array = NOT_GIVEN
    momentum_rate: Array = NOT_GIVEN
    base_impulse: Array = NOT_GIVEN
    condition: Array = NOT_GIVEN
    base_pose: Array = NOT_GIVEN
    base_twist: Array = NOT_GIVEN
    base_acceleration: Array = NOT_GIVEN
    trunk_base_wrench: Array = NOT_GIVEN
    coupling_force: Array = NOT_GIVEN
    touch_force: Array = NOT_GIVEN
    touch_gap: Array = NOT_GIVEN
    touch_mode: Array = NOT_GIVEN
    touch_margin: Array = NOT_GIVEN
    touch_status: Array = NOT_GIVEN
    every: int = 1
    stopped: str | None = None
    occurrences: tuple[Occurrence, ...] = ()
    setting: Setting | None = None

    def __post_init__(self) -> None:
        missing = [name for name in array_names() if getattr(self, name) is None]
        nothing, complete = np.zeros((*np.shape(self.t), 0)), set(missing) <= set(EMPTY_FIELDS)
        for name in missing:
            empty = complete or (name not in TRUNK_FIELDS and name in EMPTY_FIELDS)
            object.__setattr__(self, name, nothing if empty else NotRecorded(name))
        super().__post_init__()

    @classmethod
    def on_disk(cls, names: Sequence[str], read: Callable[[str], Array]) -> Self:
        """Return a run whose arrays are read when they are first used.

        Args:
            names: the arrays that there are.
            read: returns the array of a name.
        """
        nothing: dict[str, Any] = dict.fromkeys(names, np.zeros(0))
        run = cls(**nothing)
        for name in names:
            del run.__dict__[name]
        run.__dict__["_read"] = read
        return run

    def __getattr__(self, name: str) -> Any:
        if "_read" not in self.__dict__ or name not in array_names():
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        self.__dict__[name] = found = read_only(self.__dict__["_read"](name))
        return found

    @property
    def recorded(self) -> list[str]:
        """The names of the arrays that the run contains."""
        held = self.__dict__
        return [name for name in array_names() if not isinstance(held.get(name), NotRecorded)]

    @property
    def has_every_array(self) -> bool:
        """Whether everything was recorded that a run of its chain determines."""
        forest = self.setting is not None and bool(self.setting.chain.beyond_serial)
        return {*array_names()} - {*self.recorded} <= {*(NOT_OF_FORESTS if forest else ())}

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        """Return the name, the length and the end of the run, on one line."""
        return f"<Trajectory {text_of(self)}>"

    def whole_run(self) -> Trajectory:
        """Return the run itself."""
        return self

    def require_setting(self) -> Setting:
        """Return the setting of the run.

        Raises:
            StateError: the run has no setting.
        """
        if self.setting is None:
            raise StateError(
                "run: expected one that knows its chain, as simulate and load_result return it, got one put together"
                " from arrays; try dataclasses.replace(run, setting=hf.simulation.setting.Setting(chain))"
            )
        return self.setting

    @property
    def rows(self) -> list[str]:
        """The names of the rows of grasp_wrench, holding and margins.

        Raises:
            StateError: the run has no setting.
        """
        return [row.name for row in self.require_setting().rows]

    def state(self, k: int) -> State:
        """Return the state of sample k."""
        base = (self.base_pose[k], self.base_twist[k]) if self.base_pose.shape[1] else ()
        return State(self.q[k], self.qd[k], self.object_pose[k], self.object_twist[k], *base)

    def state_at(self, t: float) -> State:
        """Return the state at any time of the run, interpolated by quintics between samples; see `interpolant`.

        At a jump of the grasps or velocities, the state after the jump is returned.

        Args:
            t: time [s].

        Raises:
            StateError: the time is before the first sample or after the last.
            MethodNotApplicable: the run is of a chain that is answered as a forest.
        """
        if self.setting is not None:
            serial_chain(self.setting.chain, "run: state_at")
        t = float(checks.numbers(t, (), "run: t", StateError))
        if not self.t[0] <= t <= self.t[-1]:
            raise StateError(f"run: t: expected {self.t[0]:.9g} to {self.t[-1]:.9g} s, got {t:.9g} s")
        k = int(np.searchsorted(self.t, t, side="right")) - 1
        return self.state(k) if self.t[k] == t else interpolant(self._knot(k), self._knot(k + 1))(t)

    def _knot(self, k: int) -> Knot:
        accelerations = np.concatenate([self.qdd[k], self.object_acceleration[k], self.base_acceleration[k]])
        return Knot(float(self.t[k]), self.state(k), accelerations)

    @property
    def imbalance(self) -> Array:
        """(samples,) change of energy that no work explains [J]."""
        return imbalance(self.kinetic, self.potential, self.work, self.impact)

    @property
    def momentum_imbalance(self) -> Array:
        """(samples, 6) change of [angular; linear] momentum that no wrench explains [N m s, N s].

        Raises:
            StateError: there is not a sample at every step, so that wrenches cannot be integrated.
        """
        if self.every > 1:
            raise StateError(
                f"momentum_imbalance: expected a sample at every step, got one every {self.every} steps; try every=1"
            )
        return momentum_imbalance(self.t, self.momentum, self.momentum_rate, self.base_impulse)


def text_of(run: Trajectory) -> str:
    """Return a short description of a run: its name and arms, its length, and how it ended."""
    if np.ndim(run.t) == 0:
        return f"one sample at t = {float(run.t):g} s"
    if not len(run):
        return "without samples"
    of = "" if run.setting is None else f" '{run.setting.name}' of {', '.join(run.setting.chain.names)}"
    end = ending(run.stopped, run.occurrences)
    return f"run{of}: {len(run)} sample{'' if len(run) == 1 else 's'}, {run.t[0]:g} to {run.t[-1]:g} s, {end}"


def joined(runs: Sequence[Trajectory], stopped: str | None = None) -> Trajectory:
    """Return successive parts of a run, one or more, as one."""
    return _combined(np.concatenate, runs, stopped)


def stacked(samples: Sequence[Trajectory], stopped: str | None = None) -> Trajectory:
    """Return a run made of single samples."""
    return _combined(np.stack, samples, stopped)


def _combined(how: Callable[[list[Array]], Array], runs: Sequence[Trajectory], stopped: str | None) -> Trajectory:
    arrays: dict[str, Any] = {name: how([getattr(run, name) for run in runs]) for name in runs[0].recorded}
    happened = tuple(one for run in runs for one in run.occurrences)
    return Trajectory(**arrays, every=runs[0].every, stopped=stopped, occurrences=happened)


def part_of(run: Trajectory, k: Any, occurrences: tuple[Occurrence, ...] = ()) -> Trajectory:
    """Return the samples of a run at an index or a slice; a number gives one sample, without the sample axis."""
    arrays = {name: getattr(run, name)[k] for name in run.recorded}
    return Trajectory(**arrays, every=run.every, occurrences=occurrences)


def require_run_of(chain: Any, run: Any) -> None:
    """Check that `run` is a run of `chain`.

    Raises:
        ModelError: `chain` is not a ClosedChain.
        StateError: `run` is not a run, has no samples, or has other arms.
    """
    if not isinstance(chain, ClosedChain):
        raise ModelError(f"chain: expected a ClosedChain, got a {type(chain).__name__}")
    if not isinstance(run, Trajectory):
        inside = "; try its .trajectory" if hasattr(type(run), "trajectory") else ""
        raise StateError(f"run: expected a Trajectory, as simulate returns it, got a {type(run).__name__}{inside}")
    if not len(run):
        raise StateError("run: expected samples, got none")
    rows = len(grasp_rows(chain) if run.setting is None else run.setting.rows)
    sizes = ("q", chain.position_count, "joints"), ("grasp_wrench", rows, "grasps" if chain.beyond_serial else "arms")
    for name, size, what in sizes:
        if name in run.recorded and (got := getattr(run, name).shape[1]) != size:
            raise StateError(f"run: expected one of this chain with {size} {what}, got {got}")


GAPS = ("before", "after")
_RUN_ROWS = (
    Row("internal_wrench", ("arms", 6), "N m, N", "the part of grasp_wrench that does not move the object"),
    Row("load_share", ("arms",), "", "part of the net force that each arm carries; all 0 where there is no net force"),
    Row("holding", ("arms",), "", "whether each arm has a grasp"),
    Row("spin", ("arms",), "rad", "turn of each soft finger's contact about its normal; 0 for other grasps"),
    Row("margin", ("arms",), "N", "how far each grasp is from giving way; infinite where nothing limits it"),
    Row("best_margin", ("arms",), "N", "the largest margin that internal forces of no effect on the motion allow"),
    Row("worst_margin", ("arms",), "N", "the smallest such margin; minus infinity where they have no bound"),
    Row("lowest_margin", ("arms",), "N", "the lowest margin of each grasp since the sample before"),
    Row("lowest_margin_time", ("arms",), "s", "when that was"),
    Row("lowest_joint_margin", (3,), f"{RAD}, {RATE}, {TORQUE}", "the lowest margins of position, rate and effort of"
        " any joint since the sample before; infinite where nothing limits them", labels=JOINT_QUANTITIES),
    Row("lowest_joint_margin_time", (3,), "s", "when that was", labels=JOINT_QUANTITIES),
    Row("lowest_joint", (3,), "", "which joint that was, by place in q", labels=JOINT_QUANTITIES),
    Row("position_gap", (2,), "m or rad", "position gap of the worst grasp, before and after projection", labels=GAPS),
    Row("velocity_gap", (2,), "m/s or rad/s", "velocity gap of the worst grasp, before and after projection",
        labels=GAPS),
    Row("kinetic", (), "J", "kinetic energy"),
    Row("potential", (), "J", "potential energy of gravity and of all springs"),
    Row("work", (4,), "J", "work since the start of drives, damping and friction, bases, external wrenches",
        labels=WORK_TERMS),
    Row("impact", (), "J", "energy that impulses have added since the start"),
    Row("momentum", (6,), "N m s, N s", "[angular; linear] momentum of links and object about the world's origin, world"
        " axes"),
    Row("momentum_rate", (6,), "N m, N", "[moment; force] of bases, weights and external wrenches about the world's"
        " origin, world axes"),
    Row("coupling_force", ("couplings",), "N m or N", "forces of the couplings; a coupling acts on each of its joints"
        " with c times this"),
    Row("base_impulse", (6,), "N m s, N s", "[angular; linear] impulses of the bases and of the world that the object"
        " touches, in impacts since the start, about the world's origin, world axes"),
    Row("touch_force", ("touches", 3), "N", "force of the world on the object at each contact, world axes",
        labels=("x", "y", "z")),
    Row("touch_gap", ("touches",), "m", "gap of each contact"),
    Row("touch_mode", ("touches",), "", "what each contact does: 0 open, 1 sticks, 2 slips, 3 closed without friction"),
    Row("touch_margin", ("touches",), "N", "by how much each force keeps that: mu f_n - |f_t| where the contact sticks,"
        " f_n where it slips; infinite where it is open"),
    Row("touch_status", (), "", "place in `ContactStatus`: 0 forces are unique, 1 contacts share the load in several"
        " ways, by the rank of their wrenches alone"),
)  # fmt: skip
_KNOWN_ROWS = {
    **ARRAYS,
    **{row.field: row for row in ARRAYS.values() if row.field},
    "wrist_wrench": WRISTS.rows["wrist_wrenches"],
    **{row.name: row for row in _RUN_ROWS},
}
# the arrays of a trajectory, in order
RUN_ARRAYS: Mapping[str, Row] = {one.name: _KNOWN_ROWS[one.name] for one in fields(Trajectory) if one.type == "Array"}
_SECTION = "    Attributes:\n"
Trajectory.__doc__ = (Trajectory.__doc__ or "").replace(
    _SECTION, _SECTION + "".join(f"        {name}: {row.text}.\n" for name, row in RUN_ARRAYS.items())
)

for _name in RUN_ARRAYS:  # their defaults, so that an array on disk is asked for
    if _name in vars(Trajectory):
        delattr(Trajectory, _name)


def array_names() -> list[str]:
    """Return the names of a trajectory's arrays."""
    return list(RUN_ARRAYS)
