"""Time of contacts as machine code, in units of F, the bound forward dynamics of two 7-joint arms.

    python -m benchmarks.contact_speed [--contacts 4] [--runs]

cold    the path, then Newton's steps: 15 + 4
warm    two of Newton's steps from the last forces
batch   cold, for each of 512 systems in one call

Then the same of forward dynamics of two Pandas whose box stands on a table, with at most four contacts (its corners);
warm are three of Newton's steps. At last the time of a step of a rollout with these contacts, for each of 512 systems
with slightly different torques, after they have landed, beside that of the midpoint rule without contacts; and the
processor time of a step of `simulate` while two Pandas lay a box flat on a table, of its sample, and how many steps the
reference takes; and that of a step by events while no contact is closed, while four stick, while four slip, and while
four carry a box on a slope that is nearly too steep, where the shares of least norm would slip.
`--runs` prints these alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
from tests.compiler.programs import ArrayKernel
from tests.control.two_pandas import two_pandas
from tests.simulation.contacts.two_pandas import lowering

import holdfast as hf
from benchmarks.contact_bars import Drawn, drawn
from holdfast.compiled.traced_chain import traced
from holdfast.compiler.schedule import External
from holdfast.dynamics.contact.contact_forces import RESOLVED, cold_forces, contact_problem, found_forces
from holdfast.dynamics.contact.proximal_newton import polished
from holdfast.simulation.impulse_stepper import ImpulseStepper
from holdfast.simulation.segment import Segment
from holdfast.spatial.scalar import Array
from holdfast.world import HalfSpace, Touching, corners

BATCH = 512
WARM = (1e-3, 1e-4)


def cold_kernel(k: int) -> tuple[ArrayKernel, int]:
    """Return machine code of the cold solver and the number of its operations."""

    def asked(P: Array, C: Array, b: Array, mu: Array) -> tuple[Array, ...]:
        problem = contact_problem(P, C, b, mu, np.zeros(k), np.zeros((k, 2)), False)
        found = found_forces(problem, cold_forces(problem)[0])
        return found.force, found.wrench, found.residual

    return kernel_of(asked, {"P": (6, 6), "C": (k, 3, 6), "b": (k, 3), "mu": (k,)}, k)


def warm_kernel(k: int) -> tuple[ArrayKernel, int]:
    """Return machine code of the warm solver, which takes forces [n, t1, t2] as well, and its operations."""

    def asked(P: Array, C: Array, b: Array, mu: Array, start: Array) -> tuple[Array, ...]:
        problem = contact_problem(P, C, b, mu, np.zeros(k), np.zeros((k, 2)), False)
        found = found_forces(problem, polished(problem.contacts, list(start), WARM)[0])
        return found.force, found.wrench, found.residual

    return kernel_of(asked, {"P": (6, 6), "C": (k, 3, 6), "b": (k, 3), "mu": (k,), "start": (k, 3)}, k)


def kernel_of(
    asked: Callable[..., tuple[Array, ...]], shapes: dict[str, tuple[int, ...]], k: int
) -> tuple[ArrayKernel, int]:
    """Return machine code of a function of arrays, and the number of its operations."""
    results = {"force": (k, 3), "wrench": (6,), "residual": ()}
    externals = {name: External(shape, "input") for name, shape in shapes.items()}
    externals |= {name: External(shape, "output") for name, shape in results.items()}

    def named(given: Mapping[str, Array]) -> dict[str, Array]:
        return dict(zip(results, asked(*(given[name] for name in shapes)), strict=True))

    schedule = traced(externals, named)
    return ArrayKernel(externals, lambda: schedule), schedule.operation_count


def time_of(run: Callable[[], object], repeats: int = 2000) -> float:
    """Return the least time of a call, of 20 rounds [s]."""
    best = np.inf
    for _ in range(20):
        start = time.perf_counter()
        for _ in range(repeats // 20):
            run()
        best = min(best, (time.perf_counter() - start) / (repeats // 20))
    return best


def beside(bound: Any, run: Callable[[], object], repeats: int = 1000, systems: int = 1) -> str:
    """Return the time of a call for one of its systems, and its ratio to F in the same moments; medians, in words."""
    rounds = []
    for _ in range(10):
        F, each = time_of(bound.run, 1000), time_of(run, repeats) / systems
        rounds.append((1e6 * each, each / F))
    spent, ratio = np.median(rounds, axis=0)
    return f"{spent:.2f} us = {ratio:.1f} F"


def main() -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--contacts", type=int, default=4)
    parser.add_argument("--runs", action="store_true", help="only steps of `simulate`")
    asked = parser.parse_args()
    if asked.runs:
        of_runs()
        return
    k = asked.contacts
    chain, state = two_pandas()[:2]
    bound = hf.compile(chain).bind()
    for name in ("q", "qd", "object_pose", "object_twist"):
        bound.arrays[name][...] = getattr(state, name)
    print(f"F = {1e6 * time_of(bound.run):.2f} us")
    rng = np.random.default_rng(3)
    many = [drawn(rng, k, 0.5) for _ in range(BATCH)]
    for name, (kernel, count) in {"cold": cold_kernel(k), "warm": warm_kernel(k)}.items():
        given = [*many[0]] if name == "cold" else [*many[0], start_of(many[0])]
        single = kernel.bind()
        for array, x in zip(single.arrays.values(), given, strict=False):
            array[...] = x
        single.prepare()
        print(f"{name}: {count} operations, {beside(bound, single.run)}")
        if name == "cold":
            stacked = [np.array([getattr(one, field) for one in many]) for field in Drawn._fields]
            each = beside(bound, lambda: kernel(*stacked), 20, BATCH)  # noqa: B023
            left = int((kernel(*stacked)[2] > RESOLVED).sum())
            print(f"batch: {each} a system; {left} of {BATCH} left")
    of_chains(min(k, 4), bound)
    of_rollouts(min(k, 4), bound)
    of_runs()


def of_chains(k: int, of_F: Any) -> None:
    """Print the times of forward dynamics with contacts."""
    chain, state = two_pandas()[:2]
    below = [x for name, x in corners(0.3, 0.2, 0.2).items() if name[2] == "-"]
    lowest = min((state.object_frame.R @ x + state.object_frame.p)[2] for x in below)
    points = {f"corner {i}": x for i, x in enumerate(below[:k])}
    touching = Touching(points, {"table": HalfSpace(offset=lowest, friction=0.5)})
    tau = hf.holding_torques(replace(chain, held_object=hf.HeldObject.box(2.0, 0.3, 0.2, 0.2)), state)
    chain = replace(chain, touching=touching)
    given = [state.q, state.qd, tau, state.object_pose, state.object_twist]
    cold, warm = hf.compile(chain), hf.compile(chain, parameters=["touch_start"])
    start = {"touch_start": cold.forward_dynamics(*given).touch_force}
    for name, compiled, further in (("cold", cold, {}), ("warm", warm, start)):
        bound = compiled.bind(**further)
        for array, x in zip(("q", "qd", "tau", "object_pose", "object_twist"), given, strict=True):
            bound.arrays[array][...] = x
        count = compiled.operation_count
        print(f"forward dynamics, {k} contacts, {name}: {count} operations, {beside(of_F, bound.run)}")
    many = [np.repeat(x[None], BATCH, axis=0) for x in given]
    out = cold.forward_dynamics(*many)
    each = beside(of_F, lambda: cold.forward_dynamics(*many, out=out), 20, BATCH)
    print(f"forward dynamics, {k} contacts, batch: {each} a state")


def of_rollouts(k: int, bound: Any) -> None:
    """Print the times of steps of a rollout."""
    chain, state = two_pandas()[:2]
    below = [x for name, x in corners(0.3, 0.2, 0.2).items() if name[2] == "-"]
    lowest = min((state.object_frame.R @ x + state.object_frame.p)[2] for x in below)
    points = {f"corner {i}": x for i, x in enumerate(below[:k])}
    touching = Touching(points, {"table": HalfSpace(offset=lowest - 1e-5, friction=0.5)})
    tau = hf.holding_torques(replace(chain, held_object=hf.HeldObject.box(2.0, 0.3, 0.2, 0.2)), state)
    taus = tau * (1.0 + 0.002 * np.random.default_rng(0).normal(size=(BATCH, len(tau))))
    given = [np.repeat(x[None], BATCH, axis=0) for x in (state.q, state.qd, state.object_pose, state.object_twist)]
    for name, of in (("contacts", replace(chain, touching=touching)), ("none", chain)):
        rollout = hf.compile_rollout(of, scheme="midpoint")
        systems = rollout.start(*given, tau=taus)
        rollout.step(systems, 1e-3, steps=20)
        rounds = []
        for _ in range(10):
            F, start = time_of(bound.run, 1000), time.perf_counter()
            rollout.step(systems, 1e-3, steps=20)
            each = (time.perf_counter() - start) / (20 * BATCH)
            rounds.append((1e6 * each, each / F))
        spent, ratio = np.median(rounds, axis=0)
        going = int(systems.running.sum())
        print(f"rollout, {name}: {spent:.2f} us a step = {ratio:.1f} F; {going} of {BATCH} go on")


def of_runs() -> None:
    """Print the processor time of a step of `simulate` and of its sample, and how many steps the reference takes."""
    chain, state, law = lowering([0.0, 0.0, -0.1])
    taken: list[float] = []
    samples: list[float] = []
    surely, sample = ImpulseStepper.advance, Segment.sample

    def counted(stepper: ImpulseStepper, now: Any, ends: Any) -> Any:
        taken.append(now.t)
        return surely(stepper, now, ends)

    def timed(*of: Any) -> Any:
        begin = time.process_time()
        found = sample(*of)
        samples.append(1e3 * (time.process_time() - begin))
        return found

    with mock.patch.object(ImpulseStepper, "advance", counted), mock.patch.object(Segment, "sample", timed):
        for doing, duration in (("compiling", 0.45), ("above the table", 0.15), ("until they land", 0.45)):
            taken.clear()
            samples.clear()
            begin = time.process_time()
            steps = len(hf.simulate(chain, state, law, duration, 1e-3, contacts="steps")) - 1
            step = 1e3 * (time.process_time() - begin) / steps
            one = float(np.median(samples))
            print(
                f"simulate, {doing}: {step:.1f} ms a step, {one:.2f} ms of it its sample; {len(taken)} by the reference"
            )
    of_events("above the table", lowering([0.0, 0.0, -0.1]), 0.0)
    of_events("at rest on it", lowering([0.0, 0.0, -0.1]), 0.2)
    of_events("sliding on it", lowering([0.15, 0.0, -0.13]), 0.2)
    of_events("at rest on a slope", box_on_a_slope(0.36, 0.4), 0.0)


def box_on_a_slope(angle: float, friction: float) -> tuple[hf.ClosedChain, hf.State, hf.ControlLaw]:
    """Return a box of 2 kg at rest on a slope, whose angle is given in radians."""
    frame = hf.Pose.from_rpy(0.0, angle, 0.0)
    slope = HalfSpace(normal=frame.R[:, 2], offset=-0.05, friction=friction)
    touching = Touching(corners(0.2, 0.2, 0.1), {"slope": slope})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.2, 0.2, 0.1), {}, touching=touching)
    none = hf.ControlLaw(lambda t, state, memory, given: (np.zeros(0), memory))
    return chain, hf.State([], [], frame, np.zeros(6)), none


def of_events(doing: str, run: tuple[hf.ClosedChain, hf.State, Any], begin: float) -> None:
    """Print the processor time of a step by events after a time [s], from runs with 150 and with 50 steps."""
    kept, found = list[Any]([None]), None
    if begin:
        hf.simulate(*run, begin, 1e-3, contacts="events", on_checkpoint=kept.append)
    spent: dict[int, list[float]] = {150: [], 50: []}
    for _ in range(8):  # the first compiles
        for steps, all_of in spent.items():
            now = time.process_time()
            found = hf.simulate(*run, begin + steps * 1e-3, 1e-3, contacts="events", start=kept[-1])
            all_of.append(1e3 * (time.process_time() - now))
    assert found is not None
    closed = int((found.touch_mode[-1] != 0).sum())
    each = (min(spent[150]) - min(spent[50])) / 100
    print(f"simulate by events, {doing}, {closed} closed: {each:.2f} ms a step")


def start_of(one: Drawn) -> Array:
    """Return the forces of a problem, axes [n, t1, t2]."""
    k = len(one.free)
    problem = contact_problem(*one, np.zeros(k), np.zeros((k, 2)), False)
    with np.errstate(all="ignore"):
        return np.array(cold_forces(problem)[0])


if __name__ == "__main__":
    main()
