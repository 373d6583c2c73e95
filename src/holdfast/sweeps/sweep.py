"""`holdfast.sweep`: many rollouts of one plan, by any processes, kept in a folder."""

from __future__ import annotations

import pickle
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from os import PathLike
from typing import Any

from holdfast.control.controller import ControlLaw
from holdfast.errors import StateError
from holdfast.io.files import file_path
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.arguments import number, stop_margins, whole_steps
from holdfast.simulation.rollout.compile_rollout import compile_rollout
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.state import State
from holdfast.sweeps.chunk import Computed, Task, pyarrow
from holdfast.sweeps.plan import Plan, bounded, find_generic_rank, parsed_outputs, parsed_samples
from holdfast.sweeps.progress import Progress
from holdfast.sweeps.result import Sweep
from holdfast.sweeps.store import Store
from holdfast.sweeps.workers import computed_by, computed_by_processes, computed_here

OUTPUTS = ("object_pose", "object_twist", "grasp_wrench", "worst_margin")
MOST_WORKERS = 4096
LARGEST_CHUNK = 10**6
LARGEST_SEED = 2**63


def sweep(
    chain: ClosedChain,
    law: ControlLaw | None = None,
    *,
    state: State,
    parameters: Mapping[str, Any],
    count: int,
    duration: float,
    step: float,
    store: str | PathLike[str],
    outputs: Sequence[str] = OUTPUTS,
    seed: int = 0,
    chunk: int = 1000,
    workers: int | Executor = 1,
    ahead: int = 16,
    progress: Callable[[Progress], object] | None = None,
    scheme: str = "rk4",
    least_margin: float = -float("inf"),
    stop_at_limits: bool = False,
    largest_drift: float | None = None,
) -> Sweep:
    """Run many rollouts of one plan and keep what comes of them in a folder, or go on with those already there.

    What belongs to run i is a function of the arguments and i alone: no byte of a data file depends on
    `workers`, on the order of work, or on who died meanwhile. A call with the same arguments and store computes
    what is missing there; times and processes are in `log.jsonl`. Memory is that of the chunks at work.

    Args:
        chain: arms, object and grasps.
        law: torques; without one they are the parameter `tau`, held.
        state: that runs begin at, brought onto the grasps of each.
        parameters: what runs are given, by the names of `Rollout.start` (q, qd, object_pose, object_twist, the law's
            parameters, object_wrench, gravity, object_mass, object_com, object_inertia, base_pose, grasp_pose): a
            distribution, numbers for all runs, or a row for each.
        count: how many runs.
        duration: of each, a whole number of steps [s].
        step: h [s].
        store: the folder; made if need be.
        outputs: names of attributes of `RolloutSystems`, taken at each run's end.
        seed: of what is drawn, an integer >= 0.
        chunk: runs that are one piece of work and one file.
        workers: how many processes, 1 for this one; or an executor of `concurrent.futures`, or one that acts like it.
        ahead: chunks that an executor is given at a time.
        progress: called after every chunk; `print` shows a line.
        scheme: `rk4` or `midpoint`.
        least_margin: as for `Rollout.step`; 0 stops slipping runs.
        stop_at_limits: as for `Rollout.step`.
        largest_drift: as for `Rollout.step`.

    Returns:
        The sweep: summaries, and any run again.

    Raises:
        StateError: arguments that do not fit; no run that begins on its grasps.
        ModelError, CompileError: as for `compile_rollout`.
        ResultError: the store is another sweep's, in use or cannot be written; processes died again and again.
        MissingExtra: pyarrow is not installed.
    """
    pyarrow()
    rollout = compile_rollout(chain, law, scheme=scheme)
    if not isinstance(state, State):
        raise StateError(
            f"state: expected a State, got {type(state).__name__}; try what `close` or `assemble` returned"
        )
    if not isinstance(parameters, Mapping):
        raise StateError(f"parameters: expected a mapping of names, got {type(parameters).__name__}")
    options = {"least_margin": least_margin, "stop_at_limits": stop_at_limits, "largest_drift": largest_drift}
    stop_margins(least_margin, stop_at_limits)
    runs = bounded("count", count)
    length, h = number("duration", duration), number("step", step)
    if h <= 0.0:
        raise StateError(f"step: expected a positive number of seconds, got {step!r}")
    whole_steps(length, h)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < LARGEST_SEED:
        raise StateError(f"seed: expected an integer >= 0, got {seed!r}")
    if not isinstance(workers, Executor) and not hasattr(workers, "submit"):
        bounded("workers", workers, MOST_WORKERS)
    plan = Plan(
        rollout,
        state,
        parsed_samples(rollout, parameters, runs),
        runs,
        bounded("chunk", chunk, LARGEST_CHUNK),
        seed,
        length,
        h,
        parsed_outputs(outputs),
        {name: x if name != "least_margin" else float(x) for name, x in options.items()},  # pyright: ignore[reportArgumentType]
    )
    place = Store(file_path(store, "store"), plan)
    try:
        settled = _settled(plan, place)
        _compute_missing(settled, place, workers, bounded("ahead", ahead, MOST_WORKERS), progress)
    finally:
        place.close()
    return Sweep(settled, place.folder)


def _settled(plan: Plan, place: Store) -> Plan:
    """Return the plan with the generic rank that all chunks take, as the store has it or finds it now."""
    if place.generic_rank is None:
        place.settle(find_generic_rank(plan))
    old = plan.rollout
    parts = (old.base_motion, old.options, old.inputs)
    rollout = Rollout(old.chain, old.law, old.scheme, place.generic_rank, *parts)
    return Plan(**{**vars(plan), "rollout": rollout})


def _compute_missing(
    plan: Plan, place: Store, workers: Any, ahead: int, progress: Callable[[Progress], object] | None
) -> None:
    sizes = {k: end - begin for k in range(plan.chunk_count) for begin, end in [plan.bounds(k)]}
    missing = [k for k, rows in sizes.items() if not place.holds(k, rows)]
    begun, fates = time.perf_counter(), Counter[str]()
    there = plan.count - sum(sizes[k] for k in missing)
    for computed in _computed(_tasks(plan, place.digest, missing), workers, ahead, len(missing)):
        place.keep(computed)
        fates += computed.fates
        if progress is not None:
            rate = fates.total() / (time.perf_counter() - begun)
            progress(Progress(there + fates.total(), plan.count, dict(fates), rate))


def _computed(tasks: Iterator[Task], workers: Any, ahead: int, count: int) -> Iterator[Computed]:
    if not isinstance(workers, int):
        return computed_by(workers, tasks, ahead)
    if workers == 1 or count == 0:
        return computed_here(tasks)
    return computed_by_processes(tasks, workers)


def _tasks(plan: Plan, digest: str, missing: Sequence[int]) -> Iterator[Task]:
    """Yield chunks as they are asked for, so that few of them are in memory."""
    rollout, drawn = pickle.dumps(plan.rollout), plan.drawn()
    for k in missing:
        begin, end = plan.bounds(k)
        rows = plan.rows(begin, end)
        yield Task(k, begin, rollout, rows, drawn, plan.duration, plan.step, plan.options, plan.outputs, digest)
