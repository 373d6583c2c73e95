"""`holdfast.sweep`: many rollouts of one plan, computed by any processes and stored in a folder."""

from __future__ import annotations

import pickle
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from os import PathLike
from typing import Any

from holdfast.control.controller import ControlLaw
from holdfast.errors import HoldfastError
from holdfast.io.files import file_path
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.progress import reporting
from holdfast.simulation.rollout.arguments import whole_number, whole_steps
from holdfast.spatial.frozen import Frozen
from holdfast.state import State
from holdfast.sweeps.chunk import Chunk, parquet_modules
from holdfast.sweeps.plan import OUTPUTS, Plan, find_generic_rank, made_by, plan_of
from holdfast.sweeps.result import Sweep
from holdfast.sweeps.store import Store
from holdfast.sweeps.workers import MOST_WORKERS, computed_chunks, require_workers


@called
@dataclass(frozen=True, eq=False)
class Progress(Frozen):
    """The progress of a sweep; as text it is one line.

    Attributes:
        done: number of runs whose results are in the store, including earlier ones.
        count: number of runs of the sweep.
        status_counts: number of runs computed by this call that ended with each status.
        rate: rate of this call [runs/s].
    """

    done: int
    count: int
    status_counts: Mapping[str, int]
    rate: float

    def __str__(self) -> str:
        """Return the number of finished runs, the rate, the remaining time, and the number of runs with each status."""
        left = (
            f", {(self.count - self.done) / self.rate:.0f} s left" if self.rate > 0 and self.done < self.count else ""
        )
        counts = ", ".join(f"{count} {name.lower()}" for name, count in sorted(self.status_counts.items()))
        return f"{self.done} of {self.count} runs, {self.rate:.0f}/s{left}{f'; {counts}' if counts else ''}"


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
    cluster: str | None = None,
    ahead: int = 16,
    progress: bool | Callable[[Progress], object] | None = None,
    scheme: str = "rk4",
    least_margin: float = -float("inf"),
    stop_at_limits: bool = False,
    largest_drift: float | None = None,
) -> Sweep:
    """Compute many rollouts of one plan and store their results in a folder, or complete a sweep that is there.

    The results of run i depend only on the arguments and on i; no byte of a data file depends on `workers`, on the
    order of computation, or on processes that died. A call with the same arguments and store computes the missing runs.
    Times and processes are recorded in `log.jsonl`. Only the chunks being computed are in memory.

    Args:
        chain: arms, object and grasps.
        law: the control law; without one, the torques are constant and are the parameter `tau`.
        state: initial state of the runs, which is projected onto the grasps of each.
        parameters: parameters of the runs, with the names of `Rollout.start` (q, qd, object_pose, object_twist, the
            law's parameters, object_wrench, gravity, object_mass, object_com, object_inertia, base_pose, grasp_pose).
            Each is a distribution, an array for all runs, or an array with one row per run.
        count: number of runs.
        duration: duration of each run, a whole number of steps [s].
        step: step h [s].
        store: the folder, which is created if it does not exist.
        outputs: names of attributes of `RolloutSystems`, which are stored at the end of each run.
        seed: seed of the random draws, an integer >= 0.
        chunk: number of runs that are computed together and stored in one file.
        workers: number of processes, of one thread each; 1 for this one, which uses threads as `Rollout.step` does. Or
            an executor with the interface of `concurrent.futures`.
        cluster: a Dask cluster: the address of its scheduler, such as "tcp://10.0.0.1:8786", or "local" for `workers`
            processes of this computer. If a scheduler dies, the sweep waits for its successor.
        ahead: number of chunks that are submitted to an executor or a cluster at a time.
        progress: True for a bar, as for `simulate`; or a function that is called after every chunk, such as `print`.
        scheme: `rk4` or `midpoint`.
        least_margin: as for `Rollout.step`; 0 stops slipping runs.
        stop_at_limits: as for `Rollout.step`.
        largest_drift: as for `Rollout.step`.

    Returns:
        The sweep, with summaries of its runs.

    Raises:
        StateError: an argument is invalid, or none of the first runs starts on its grasps.
        ModelError, CompileError: as for `compile_rollout`.
        ResultError: the store belongs to another sweep, is in use or cannot be written; or processes died repeatedly.
        MissingExtra: pyarrow is not installed.
    """
    plan = plan_of(
        chain,
        law,
        state=state,
        parameters=parameters,
        count=count,
        duration=duration,
        step=step,
        outputs=outputs,
        seed=seed,
        chunk=chunk,
        scheme=scheme,
        least_margin=least_margin,
        stop_at_limits=stop_at_limits,
        largest_drift=largest_drift,
    )
    return carry_out(plan, store, workers=workers, cluster=cluster, ahead=ahead, progress=progress)


def carry_out(
    plan: Plan,
    store: str | PathLike[str],
    *,
    workers: int | Executor,
    cluster: str | None,
    ahead: int,
    progress: bool | Callable[[Progress], object] | None,
    files: Mapping[str, bytes] | None = None,
) -> Sweep:
    """Compute the runs of a plan that are missing in a folder; see `sweep`.

    Args:
        plan: the plan.
        store: the folder.
        workers: as for `sweep`.
        cluster: as for `sweep`.
        ahead: as for `sweep`.
        progress: as for `sweep`.
        files: contents of additional files to store, by name.

    Raises:
        StateError, ResultError, MissingExtra: as for `sweep`.
    """
    parquet_modules()
    require_workers(workers, cluster)
    whole_number("ahead", ahead, MOST_WORKERS)
    place = Store(file_path(store, "store"), plan)
    try:
        plan = plan.settled(place.prepare(lambda: find_generic_rank(plan), files or {}).generic_rank)
        missing = [k for k in range(plan.chunk_count) if not place.holds(k)]
        left = sum(end - begin for begin, end in map(plan.bounds, missing))
        computed = computed_chunks(_tasks(plan, place.plan_sha256, missing), workers, cluster, ahead, len(missing))
        start, counts, size = time.perf_counter(), Counter[str](), f"{left} runs"
        with reporting(progress, "sweeping", size, lambda at: (at.done / at.count, str(at)), time_left=False) as tell:
            for one in computed:
                place.keep(one)
                counts += one.status_counts
                done, rate = plan.count - left + counts.total(), counts.total() / (time.perf_counter() - start)
                tell(Progress(done, plan.count, dict(counts), rate))
        return Sweep(plan, place.folder, place.commit())
    except HoldfastError:
        place.withdraw()
        raise
    finally:
        place.close()


def _tasks(plan: Plan, digest: str, missing: Sequence[int]) -> Iterator[Chunk]:
    """Yield chunks on demand, so that few of them are in memory."""
    rollout, drawn = pickle.dumps(plan.rollout), plan.drawn()
    every = whole_steps(plan.duration, plan.step)
    run = {"duration": plan.duration, "step": plan.step, "every": every, "record": (), **plan.options}
    for k in missing:
        begin, end = plan.bounds(k)
        rows = plan.rows(begin, end)
        yield Chunk(k, begin, rollout, rows, drawn, run, plan.outputs, digest, made_by())
