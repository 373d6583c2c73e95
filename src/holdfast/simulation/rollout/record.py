"""The record of a rollout: the arrays of many systems at many times, and the replay of one system as a run.

A replay repeats the steps of one system and computes everything that a run records.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from holdfast import outer
from holdfast.compiled.statuses import system
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.link import Link
from holdfast.names import called
from holdfast.questions.arrays import LINKS, TRUNK_LINKS, link_rows, state_fields
from holdfast.simulation.accounts import accounts_of
from holdfast.simulation.balance import Sums
from holdfast.simulation.environment import Environment
from holdfast.simulation.events import Occurrence
from holdfast.simulation.instant import evaluate
from holdfast.simulation.margins import Signals
from holdfast.simulation.rollout.arguments import kernel_arguments, whole_number
from holdfast.simulation.rollout.systems import RolloutStatus, RolloutSystems, status_summary
from holdfast.simulation.rollout.user_functions import with_wrenches
from holdfast.simulation.sample import sample
from holdfast.simulation.setting import Setting, recorded_base
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Trajectory, joined
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
    samples = [_sample(world, rollout, at)]
    for done in range(0, steps, stride):
        rollout.step(at, arguments.step, steps=min(stride, steps - done), **arguments.options)
        if float(at.t[0]) > samples[-1].t[0]:
            samples.append(_sample(world, rollout, at))
    state = record.systems.status[number]
    stopped, happened, end = None, (), float(record.stopped[number])
    if state is RolloutStatus.UNRESOLVED:
        text = f"{state.value}: by {last.step_error[0]:.3g} rad/s or m/s; try a smaller step"
        happened = (Occurrence(float(at.t[0]), "unresolved", "joints", text),)
    elif state is not RolloutStatus.RUNNING:
        stopped = f"{state.name.lower()} at t = {end:.9g} s: {state.value}"
    run = replace(joined(samples, stopped), occurrences=happened)
    moved = {name: recorded_base(name, motion, run.t) for name, motion in rollout.base_motion.items()}
    options = {"scheme": rollout.scheme, **arguments.options}
    name, duration = f"system {number}", float(record.t[-1] - record.t[0])
    return replace(run, setting=Setting(world.chain, moved, name, duration, arguments.step, options))


def _environment(rollout: Any, systems: RolloutSystems) -> Environment:
    """Return the environment of one system: the chain with the system's parameters, base motions and inputs."""
    inputs, parameters = kernel_arguments(rollout.kernel, systems.call_inputs)
    fields = {name: systems.arrays[name][0] for name in state_fields(rollout.chain)}
    own = rollout.kernel.parameters | parameters
    chain = _with_own_bodies(system(rollout.chain, fields | own, 0)[0], own)
    on_links = {"link_wrenches": inputs.get("link_wrench"), "trunk_link_wrenches": inputs.get("trunk_link_wrench")}
    given = Inputs(inputs["object_wrench"], **on_links)

    def acting(t: float, state: State) -> Inputs:
        return given if rollout.inputs is None else with_wrenches(given, rollout.inputs, chain, t, state)

    return Environment(chain, rollout.base_motion, acting)


def _with_own_bodies(chain: ClosedChain, own: Mapping[str, Array]) -> ClosedChain:
    """Return the chain with the object, gravity and link inertias of a system."""
    held = replace(
        chain.held_object,
        mass=float(own["object_mass"]),
        com=own["object_com"],
        inertia=own["object_inertia"],
        physical=False,
    )
    arms, trunk = dict(chain.arms), chain.trunk
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


def _sample(world: Environment, rollout: Any, at: RolloutSystems) -> Trajectory:
    """Return a sample of a system at its current state, with its current torques."""
    parts = {field: at.arrays[name][0] for name, field in state_fields(rollout.chain).items()}
    tau = np.array(at.tau[0])
    now = evaluate(
        world, lambda *_: (tau, None), float(at.t[0]), State(**parts), None, generic_rank=rollout.generic_rank
    )
    gaps = Gaps(*np.column_stack([at.drift[0], at.gap[0]]))
    sums = Sums(np.array(at.work[0]), 0.0, np.zeros(6))
    accounting = partial(accounts_of, world)
    return sample(world, accounting, now, gaps, sums, np.array([now.t]), Signals(world.chain).of(now)[None])
