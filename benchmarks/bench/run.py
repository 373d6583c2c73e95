"""A run of the benchmark: its plan, and the document with all measurements, ready for JSON."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import holdfast
from benchmarks.bench import acceptance, derivative_entries, distribution_entries, entries, machine, peers, trunks
from benchmarks.bench.clock import Effort, summary, timed
from benchmarks.bench.compile_times import compile_times
from benchmarks.bench.distribution_entries import SOFT_FINGERS
from benchmarks.bench.entries import ACCURATE, LIBRARY, relative_error
from benchmarks.bench.measure import measure_system, reference
from benchmarks.bench.rollout_entries import MUJOCO, SCHEMES, STEP, STEPS, mj_step, rollout
from benchmarks.bench.systems import System, make_system
from benchmarks.bench.trunks import FLOATING, TORSO

Size = tuple[int, int]  # number of arms, joints per arm


@dataclass(frozen=True)
class Plan:
    """The sizes and the effort of a run.

    Attributes:
        mode: name of the mode.
        systems: sizes at which libraries are compared.
        batch_sizes: numbers of states per call.
        batch_of: size of the system for batches.
        growth: pairs (larger, smaller) of sizes whose times are compared in the same rounds.
        compiled: sizes whose compile time is measured.
        compile_runs: number of new processes for each compile time.
        effort: duration of every timing.
        rollout_sizes: numbers of systems of size `batch_of` that one call steps.
        trunks: names of systems with a trunk.
        derivatives: sizes whose derivatives are timed.
        jacobians: those of them whose Jacobian is timed, too.
        distribution: kinds of grasps for which the distribution of forces is timed.
    """

    mode: str
    systems: tuple[Size, ...]
    batch_sizes: tuple[int, ...]
    growth: tuple[tuple[Size, Size], ...]
    compiled: tuple[Size, ...]
    compile_runs: int
    effort: Effort
    batch_of: Size = (2, 7)
    rollout_sizes: tuple[int, ...] = ()
    trunks: tuple[str, ...] = ()
    derivatives: tuple[Size, ...] = ()
    jacobians: tuple[Size, ...] = ((2, 7),)
    distribution: tuple[str, ...] = ()


QUICK = Plan(
    "quick",
    ((2, 7), (4, 7), (2, 24)),
    (512,),
    (),
    ((2, 7),),
    1,
    Effort(turn=0.02, rounds=5),
    rollout_sizes=(512,),
    trunks=(TORSO, FLOATING),
    derivatives=((2, 7),),
    distribution=(SOFT_FINGERS,),
)
FULL = Plan(
    "full",
    (
        *((arms, 7) for arms in (2, 3, 4, 8, 16, 32, 64)),
        *((2, joints) for joints in (6, 12, 24, 48, 96)),
    ),
    (1, 8, 64, 512, 4096, 16384),
    (((64, 7), (16, 7)), ((2, 96), (2, 24))),
    ((2, 7), (64, 7), (2, 96)),
    3,
    Effort(turn=0.03, rounds=15),
    rollout_sizes=(8, 64, 512, 4096),
    trunks=(TORSO, FLOATING),
    derivatives=((2, 7), (4, 7), (16, 7)),
    jacobians=((2, 7), (16, 7)),
    distribution=tuple(distribution_entries.KINDS),
)


def name_of(size: Size) -> str:
    """Return "l x N"."""
    return f"{size[0]} x {size[1]}"


FORMAT = 1  # version of the document
Report = Callable[[str, float], None]


def run(plan: Plan, report: Report = lambda _doing, _part: None) -> dict[str, Any]:
    """Carry out the plan and return the document.

    Args:
        plan: `QUICK`, `FULL` or another.
        report: function that is called with the current activity and the completed fraction.

    Raises:
        HoldfastError: a chain cannot be compiled.
    """
    # read by the threading library when the first peer loads it, so that all use one thread
    os.environ["OMP_NUM_THREADS"] = "1"
    work = Work(plan)
    steps = [
        *((f"{name_of(size)} joints", work.compare, (size,)) for size in plan.systems),
        ("batches", work.batches, ()),
        ("rollouts", work.rollouts, ()),
        *((name, work.trunk, (name,)) for name in plan.trunks),
        *((f"derivatives of {name_of(size)}", work.derivatives, (size,)) for size in plan.derivatives),
        *((f"forces of {kind}", work.distribution, (kind,)) for kind in plan.distribution),
        *((f"growth to {name_of(larger)}", work.growth, (larger, smaller)) for larger, smaller in plan.growth),
        *((f"compiling {name_of(size)}", work.compiling, (size,)) for size in plan.compiled),
    ]
    for k, (doing, step, arguments) in enumerate(steps):
        report(doing, k / len(steps))
        step(*arguments)
    report("done", 1.0)
    return work.document | {"bars": acceptance.checked(work.document)}


class Work:
    """The steps of a run; each adds to the document.

    Attributes:
        document: the measurements so far.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._systems: dict[Size, tuple[System, Any]] = {}
        self.document: dict[str, Any] = {
            "format": FORMAT,
            "mode": plan.mode,
            "accuracy": ACCURATE,
            "rounds": plan.effort.rounds,
            "machine": machine.description(),
            "peers": peers.found(),
            "systems": [],
            "batches": {"system": name_of(plan.batch_of), "sizes": []},
            "rollouts": {"system": name_of(plan.batch_of), "step": STEP, "steps": STEPS, "entries": []},
            "trunks": [],
            "derivatives": [],
            "distribution": [],
            "growth": [],
            "compile": [],
        }

    def system(self, size: Size) -> tuple[System, Any]:
        """Return a system and its machine code, which are created once."""
        if size not in self._systems:
            made = make_system(*size)
            self._systems[size] = made, holdfast.compile(made.chain)
        return self._systems[size]

    def compare(self, size: Size) -> None:
        """Compare this library with every peer at one size."""
        made, fast = self.system(size)
        ways = peers.candidates(made, self.document["peers"])
        self.document["systems"].append(measure_system(made, fast, ways, self.plan.effort))

    def batches(self) -> None:
        """Time batches, per state, beside the fastest entries of the peers in a loop over the same states."""
        made, fast = self.system(self.plan.batch_of)
        record = next(r for r in self.document["systems"] if r["name"] == made.name)
        best = [entry["name"] for peer in self.document["peers"] if (entry := acceptance.fastest(record, peer))]
        truth = reference(made)
        rivals = [way.build(truth) for way in peers.candidates(made, self.document["peers"]) if way.name in best]
        ours = [entries.batch(made, fast, size) for size in self.plan.batch_sizes]
        seconds = timed([*ours, *rivals], self.plan.effort)
        for k, (size, entry) in enumerate(zip(self.plan.batch_sizes, ours, strict=True)):
            got = entry.answers().qdd
            row = {
                "size": size,
                **summary(seconds[:, k]),
                "error": relative_error(got, np.resize(truth.qdd, got.shape)),
                "ratios": {
                    rival.name: float(np.median(seconds[:, j] / seconds[:, k]))
                    for j, rival in enumerate(rivals, len(ours))
                },
            }
            self.document["batches"]["sizes"].append(row)

    def rollouts(self) -> None:
        """Time integration steps, per system, for batches of every size and scheme and for MuJoCo."""
        if not self.plan.rollout_sizes:
            return
        made, _ = self.system(self.plan.batch_of)
        ways = [rollout(made, scheme, size) for scheme in SCHEMES for size in self.plan.rollout_sizes]
        if "version" in self.document["peers"]["mujoco"]:
            ways += [mj_step(made, *settings) for settings in MUJOCO]
        seconds = timed([way.entry for way in ways], self.plan.effort)
        ours = [k for k, way in enumerate(ways) if way.entry.library == LIBRARY]
        for k, way in enumerate(ways):
            row = {
                "name": way.entry.name,
                "library": way.entry.library,
                "note": way.entry.note,
                **summary(seconds[:, k]),
                "steps_per_second": float(1.0 / np.median(seconds[:, k])),
                "gap": way.gap(),
                "ratios": {ways[j].entry.name: float(np.median(seconds[:, k] / seconds[:, j])) for j in ours},
            }
            self.document["rollouts"]["entries"].append(row)

    def trunk(self, name: str) -> None:
        """Compare this library with Pinocchio on a trunk, and with itself without one."""
        here = "version" in self.document["peers"]["pinocchio"]
        plain = self.system(self.plan.batch_of)
        self.document["trunks"].append(trunks.compare(name, plain, self.plan.effort, pinocchio=here))

    def derivatives(self, size: Size) -> None:
        """Time derivatives relative to forward dynamics, and Pinocchio's relative to ours."""
        here, matrix = "version" in self.document["peers"]["pinocchio"], size in self.plan.jacobians
        found = derivative_entries.compare(*self.system(size), self.plan.effort, matrix=matrix, pinocchio=here)
        self.document["derivatives"] += found

    def distribution(self, kind: str) -> None:
        """Time the distribution of forces relative to forward dynamics of the same chain."""
        self.document["distribution"] += distribution_entries.compare(kind, self.plan.effort)

    def growth(self, larger: Size, smaller: Size) -> None:
        """Time a larger system relative to a smaller one."""
        seconds = timed([entries.public(*self.system(size)) for size in (larger, smaller)], self.plan.effort)
        ratio = float(np.median(seconds[:, 0] / seconds[:, 1]))
        self.document["growth"].append({"larger": name_of(larger), "smaller": name_of(smaller), "ratio": ratio})

    def compiling(self, size: Size) -> None:
        """Time the compilation at one size."""
        times = compile_times(*size, self.plan.compile_runs)
        self.document["compile"].append({"system": name_of(size), **times})
