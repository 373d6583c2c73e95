"""The record of a rollout: the arrays of many systems at many times, and the replay of one system as a run.

A replay repeats the steps of one system and computes everything that a run records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from holdfast import outer
from holdfast.compiled.statuses import system
from holdfast.control.sampled import SampledTorque
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.link import Link
from holdfast.names import called
from holdfast.questions.arrays import LINKS, TRUNK_LINKS, link_rows, state_fields
from holdfast.simulation.accounts import accounts_of
from holdfast.simulation.balance import Sums
from holdfast.simulation.contact_events import IMPULSES_WAY
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.environment import Environment
from holdfast.simulation.events import Occurrence
from holdfast.simulation.impulse_stepper import touch_of
from holdfast.simulation.instant import evaluate
from holdfast.simulation.margins import Signals
from holdfast.simulation.rollout.arguments import kernel_arguments, stop_margins, whole_number
from holdfast.simulation.rollout.between_steps import ACCOUNTS
from holdfast.simulation.rollout.fused_stepper import systems_at
from holdfast.simulation.rollout.systems import RolloutStatus, RolloutSystems, status_summary
from holdfast.simulation.rollout.user_functions import with_wrenches
from holdfast.simulation.sample import Samples, recorded, sample, with_kept_modes
from holdfast.simulation.setting import Setting, recorded_base
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Trajectory, array_names, joined, part_of
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class RolloutArguments(Frozen):
    """The arguments from which a record was made.

    Attributes:
        rollout: the `Rollout`.
        systems: the systems at the start.
        step: step h [s].
        every: number of steps between two records.
        options: options of `Rollout.step`.
        duration: requested duration [s].
    """

    rollout: Any
    systems: RolloutSystems
    step: float
    every: int
    options: Mapping[str, Any]
    duration: float


@called
@dataclass(frozen=True, eq=False)
class RolloutRecord(Frozen):
    """The recorded arrays of a rollout; the first axis of every array is the time, the second the system.

    Attributes:
        t: (records,) [s].
        arrays: the recorded arrays by name, (records, systems, ...); a stopped system keeps its last good state. Of a
            record in a folder they are read when they are first used.
        systems: the systems at the end.
        stopped: (systems,) time at which each system stopped [s], infinite if it did not; the time of a slip is refined
            within its step.
        arguments: the arguments of the rollout; None for a record that was assembled from arrays.
        note: what is missing, in words; empty for a complete record.
    """

    t: Array
    arrays: Mapping[str, Array]
    systems: RolloutSystems
    stopped: Array
    arguments: RolloutArguments | None = None
    note: str = ""

    def __repr__(self) -> str:
        """Return the number of systems, the recorded times and arrays, and the status of the systems, on one line."""
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if len(self.t) else "no time"
        what = f"{len(self.systems)} systems at {len(self.t)} times, {span}: {', '.join(self.arrays)}"
        return f"<RolloutRecord of {what}; {'; '.join(filter(None, (status_summary(self.systems), self.note)))}>"

    def trajectory(self, system: int, every: int | None = None) -> Trajectory:
        """Return one system as a run, with everything that `simulate` records and all methods of a run.

        The steps are repeated with identical bits; the samples are at the recorded times, or closer together. Margins
        are evaluated at the samples only. The run of a system that stopped ends there, and `stopped` gives the reason.

        Args:
            system: number of the system, from 0.
            every: number of steps between two samples; by default as recorded.

        Raises:
            StateError: there is no such system, the record was assembled from arrays, or the first state of the system
                is invalid.
        """
        return replayed_run(self, system, every)

    def parts(self) -> Iterator[RolloutRecord]:
        """Yield the record piece by piece in the order of time, for records larger than memory.

        A record in a folder has the pieces in which it was written, of which one at a time is in memory; another record
        has one. Systems and `stopped` of each are those of the whole record.

        Raises:
            ResultError: the folder has changed since it was opened.
        """
        return outer.parts_of_record(self)

    def save(self, folder: str | PathLike[str], overwrite: bool = False) -> Path:
        """Write the record as a folder, which `holdfast.io.load_record` reads, and return the folder.

        Args:
            folder: the folder to write; it is created if it does not exist.
            overwrite: replace an earlier record in this folder; it is kept until the new one is complete.

        Raises:
            ResultError: the folder is in use or cannot be written.
        """
        return outer.save_record(self, folder, overwrite)

    def to_pandas(self) -> Any:
        """Return the record as a pandas DataFrame with one row per system and time, which form its index.

        Raises:
            MissingExtra: pandas is not installed.
        """
        return outer.frame_of_record(self)

    def to_xarray(self) -> Any:
        """Return the record as an xarray Dataset: arrays over `t` and `system`, with joints and arms by name.

        Raises:
            MissingExtra: xarray is not installed.
        """
        return outer.data_set_of_record(self)

    def __getitem__(self, name: str) -> Array:
        """Return a recorded array."""
        if name not in self.arrays:
            raise KeyError(f"'{name}' was not recorded.{checks.did_you_mean(name, self.arrays)}")
        return self.arrays[name]


def replayed_run(record: RolloutRecord, number: int, every: int | None = None) -> Trajectory:
    """Return one system of a record as a run; see `RolloutRecord.trajectory`."""
    if record.arguments is None:
        raise StateError(
            "record: expected one that `Rollout.run` returned, got one put together from arrays;"
            " of a saved one try io.load_record(folder, rollout=...)"
        )
    arguments, count = record.arguments, len(record.systems)
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < count:
        raise StateError(f"system: expected a number from 0 to {count - 1}, got {checks.short(number)}")
    stride = arguments.every if every is None else whole_number("every", every)
    rollout, at, last = arguments.rollout, arguments.systems.copy([number]), record.systems.copy([number])
    at.call_inputs, at.under = last.call_inputs, ()  # the arguments of `run` act from the start
    world = _environment(rollout, last)
    steps = round((float(record.t[-1]) - float(record.t[0])) / arguments.step)
    sampled = isinstance(rollout.law.torque, SampledTorque)
    rows, before_jumps = [_row(at)], []
    advance = _advancing(rollout, at, arguments)
    for done in range(0, steps, stride):
        count, acting = min(stride, steps - done), None
        if sampled:  # both sides of a jump of the torques are samples
            if count > 1:
                advance(count - 1)
            count, acting = 1, at.tau.copy()
        advance(count)
        if at.t[0] > rows[-1]["t"][0]:
            rows.append(_row(at))
            if acting is not None and not np.array_equal(acting, at.tau):
                before_jumps.append({**rows[-1], "t": np.nextafter(at.t, 0.0), "drive": acting})
    state = record.systems.status[number]
    stopped, happened = None, ()
    if state is RolloutStatus.UNRESOLVED:
        text = f"{state.value}: by {last.step_error[0]:.3g} rad/s or m/s; try a smaller step"
        happened = (Occurrence(float(at.t[0]), "unresolved", "joints", text),)
    elif state is not RolloutStatus.RUNNING:
        stopped = f"{state.name.lower()} at t = {float(record.stopped[number]):.9g} s: {state.value}"
    parts = rollout.kind.samples(world, rollout, last, rows, before_jumps)
    order = np.argsort(np.concatenate([part.t for part in parts]))
    run = joined(parts)
    run = replace(part_of(run, order, happened), stopped=stopped, every=stride)
    moved = {name: recorded_base(name, motion, run.t) for name, motion in rollout.base_motion.items()}
    options = {"scheme": rollout.scheme, **arguments.options}
    options |= {} if rollout.chain.touching is None else {"contacts": IMPULSES_WAY}
    name, duration = f"system {number}", float(record.t[-1] - record.t[0])
    return replace(run, setting=Setting(world.chain, moved, name, duration, arguments.step, options))


def _advancing(rollout: Any, at: RolloutSystems, arguments: RolloutArguments) -> Callable[[int], object]:
    """Return the function that takes a number of steps in place; only the first call checks the arguments."""
    least = stop_margins(arguments.options["least_margin"], arguments.options["stop_at_limits"])
    limit, begun = arguments.options["largest_drift"], False

    def advance(count: int) -> None:
        nonlocal begun
        if begun:
            rollout.advance(at, count, least, limit, 1)
        else:
            rollout.step(at, arguments.step, steps=count, **arguments.options)
        begun = True

    return advance


def _environment(rollout: Any, systems: RolloutSystems) -> Environment:
    """Return the environment of one system: the chain with the system's parameters, base motions and inputs."""
    inputs, parameters = kernel_arguments(rollout.kernel, systems.call_inputs)
    on_links = {"link_wrenches": inputs.get("link_wrench"), "trunk_link_wrenches": inputs.get("trunk_link_wrench")}
    given, chain = Inputs(inputs.get("object_wrench"), **on_links), rollout.kind.chain(rollout, systems, parameters)

    def acting(t: float, state: State) -> Inputs:
        return given if rollout.inputs is None else with_wrenches(given, rollout.inputs, chain, t, state)

    return Environment(chain, rollout.base_motion, acting)


def _row(at: RolloutSystems) -> dict[str, Array]:
    """Return a copy of the arrays of one system, with its time."""
    return {**{name: x.copy() for name, x in at.arrays.items()}, "t": np.array(at.t)}


def serial_samples(
    world: Environment,
    rollout: Any,
    last: RolloutSystems,
    rows: Sequence[Mapping[str, Array]],
    before_jumps: Sequence[Mapping[str, Array]],
) -> list[Trajectory]:
    """Return parts of the run of one system whose arrays at the samples are given; see `ChainKind`.

    Forces at the start are those under the arguments of `start`, and those before jumps are not known.
    """
    alone = [{name: x[0] for name, x in row.items()} for row in (rows[0], *before_jumps)]
    parts = [_sample(world, rollout, row) for row in alone]
    return parts + ([_recorded(world, rollout, last, rows[1:])] if len(rows) > 1 else [])


def serial_chain_of(rollout: Any, systems: RolloutSystems, parameters: Mapping[str, Array]) -> ClosedChain:
    """Return the chain with the parameters of one system."""
    fields = {name: systems.arrays[name][0] for name in state_fields(rollout.chain)}
    own = rollout.kernel.parameters | parameters
    return with_own_bodies(system(rollout.chain, fields | own, 0)[0], own)


def with_own_bodies(chain: ClosedChain, own: Mapping[str, Array]) -> ClosedChain:
    """Return the chain with the object, gravity and link inertias of a system."""
    arms, trunk, held = dict(chain.arms), chain.trunk, chain.held_object
    if "object_mass" in own:
        mass, com, inertia = (own[f"object_{what}"] for what in ("mass", "com", "inertia"))
        held = replace(held, mass=float(mass), com=com, inertia=inertia, physical=False)
    if "link_mass" in own:
        links = _bodies(own, LINKS)
        arms = {name: chain.arms[name].of(links=links[rows]) for name, rows in link_rows(chain).items()}
    if trunk is not None and "trunk_link_mass" in own:
        named = zip(_bodies(own, TRUNK_LINKS), trunk.bodies, strict=True)  # arms are mounted by name
        floating, links = trunk.split([replace(body, name=earlier.name) for body, earlier in named])
        trunk = replace(trunk, links=links, floating=floating)
    return replace(chain, held_object=held, gravity=own["gravity"], arms=arms, trunk=trunk)


def _bodies(own: Mapping[str, Array], names: Sequence[str]) -> list[Link]:
    """Return links with the named masses, mass centres and inertias."""
    masses, coms, inertias = (own[name] for name in names)
    rows = zip(masses.tolist(), coms, inertias, strict=True)
    return [Link(mass, com, inertia, physical=False) for mass, com, inertia in rows]


def _recorded(
    world: Environment, rollout: Any, last: RolloutSystems, rows: Sequence[Mapping[str, Array]]
) -> Trajectory:
    """Return the run of one system whose arrays at the samples are given."""
    x = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    signals, sums = Signals(world.chain), Sums(np.zeros(4), 0.0, np.zeros(6))
    if signals.grasps_limited and (x["rank"] < world.chain.constraint_row_count).any():  # whose margins are intervals
        return joined(
            [_sample(world, rollout, {name: array[k] for name, array in x.items()}) for k in range(len(rows))]
        )
    inputs, parameters = kernel_arguments(rollout.kernel, last.call_inputs)
    now = {**inputs, "begin": x["t"], "step": np.array(0.0), "held": np.array(1.0)}
    if TOUCH_WRENCH in x:
        now["object_wrench"] = inputs["object_wrench"] + x[TOUCH_WRENCH]
        x["touch_mode"] = x["touch_mode"].astype(int)
        x = with_kept_modes(world.chain, x)
    rollout.kernel.choose_forces({name: x[name] for name in rollout.kernel.carried}, now, parameters)
    margins, t = signals.of_arrays(x), x["t"]
    of_grasps = margins[:, : len(world.chain.arms)]

    def accounting(t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        return rollout.kernel.ask(ACCOUNTS, systems_at(rollout.kernel, arrays), now, parameters)

    allowed, times = (of_grasps, of_grasps, of_grasps), np.repeat(t[:, None], margins.shape[1], axis=1)
    return recorded(
        world, accounting, Samples(t, x, allowed, x["gaps"], x["work"], margins, times), sums, array_names()
    )


def _sample(world: Environment, rollout: Any, x: Mapping[str, Array]) -> Trajectory:
    """Return a sample of a system with the given arrays, with its current torques."""
    state, tau = State(**{field: x[name] for name, field in state_fields(rollout.chain).items()}), x["drive"]
    contacts = None if "touch_force" not in x else partial(touch_of, x["touch_force"], x["touch_mode"].astype(int))
    how: Any = {"generic_rank": rollout.generic_rank, "contacts": contacts}
    now = evaluate(world, lambda *_: (tau, None), float(x["t"]), state, None, **how)
    gaps, sums = Gaps(*x["gaps"].reshape(2, 2).T), Sums(x["work"], 0.0, np.zeros(6))
    margins = Signals(world.chain).of(now)[None]
    return sample(world, partial(accounts_of, world), now, gaps, sums, np.array([now.t]), margins, array_names())
