"""What a step of 1 ms of `simulate` costs, everything recorded and verified, in F, beside its bar and MuJoCo's step.

F is the time of one bound forward dynamics of two arms with seven joints that hold a box rigidly. All rows alternate
with it in one process; times are medians of processor time, code is compiled before. MuJoCo steps the same robots
under constant torques by its Python API, one call a step, and records positions, velocities, accelerations, energies
and constraint forces. Run it with HOLDFAST_COMPILE unset, on a quiet machine.

python benchmarks/simulate_speed.py [--steps 1000] [--rounds 5]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module, util
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from examples.benchmarks.n_four_bar import n_four_bar

import holdfast as hf
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.entries import LIBRARY, Timed, bind
from benchmarks.bench.systems import facing_pandas, make_system, serial_arm
from benchmarks.bench.trunks import BOX, HANDS
from holdfast.cli.doctor import processor
from holdfast.control import GravityCompensation, ObjectTracking, RestToRest
from holdfast.dynamics import tip_pose
from holdfast.interop import to_mjcf
from holdfast.robots import HOME

ROOT = Path(__file__).parents[1]
STEP, PUSH, MANY = 1e-3, 40.0, 256
RUBBER = hf.Friction(mu=0.8, torsion_radius=0.02)
SOFT = "soft fingers with friction"
TURN = 0.02  # s that an entry runs in a round at least
COLD, CACHED = 3.0, 0.05  # s, bars of compiling
# Two runs in a new process, in processor time; what the first takes longer is compiling, or loading of the code. A run
# of another chain comes before, because loading modules is not compilation.
FIRST_RUN = """
import json, time
import llvmlite.binding
import holdfast as hf
from benchmarks.bench.systems import facing_pandas, make_system
other = make_system(1, 6, 1)
state = hf.State(other.q[0], other.qd[0], other.object_pose[0], other.object_twist[0])
hf.simulate(other.chain, state, hf.control.GravityCompensation(other.chain), 0.1, 1e-3)
chain, state = facing_pandas("softfinger", hf.Friction(mu=0.8, torsion_radius=0.02))
law = hf.control.GravityCompensation(chain, 40.0, 0.1)
times = []
for _ in range(2):
    begin = time.process_time()
    hf.simulate(chain, state, law, 0.1, 1e-3)
    times.append(time.process_time() - begin)
print(json.dumps(times[0] - times[1]))
"""


@dataclass(frozen=True, eq=False)
class Row:
    """A row of the table.

    Attributes:
        name: what is run.
        entry: runs it; an evaluation is one step of one system.
        bar: the most that it may take [F], or a row and a factor to it; None without a bar.
        less: entries whose times are subtracted: the start of a run, and what is not ours.
        peer: MuJoCo's entry; None if there is no comparable model.
    """

    name: str
    entry: Timed
    bar: float | tuple[str, float] | None = None
    less: tuple[Timed, ...] = ()
    peer: Timed | None = None


def entry(name: str, call: Callable[[], object], steps: int, library: str = LIBRARY) -> Timed:
    """Return a call that takes so many steps."""
    return Timed(name, library, call, steps)


def simulated(
    name: str,
    bar: float | None,
    peer: Timed | None,
    given: tuple[Any, Any, Any],
    steps: int,
    *less: Timed,
    **options: Any,
) -> Row:
    """Return the row of a run of `simulate`, which must reach its end, without its start.

    The time of a run of half as many steps is subtracted, and an evaluation is one of the remaining steps.

    Args:
        name: what is run.
        bar: the most that a step may take [F].
        peer: MuJoCo's entry.
        given: chain, state and law.
        steps: number of steps.
        *less: further entries whose times are subtracted.
        **options: options of `simulate`.
    """
    half = max(1, steps // 2)

    def run(count: int) -> None:
        found = hf.simulate(*given, count * STEP, STEP, **options)
        assert found.stopped is None, found.stopped

    whole, start = (entry("simulate", partial(run, count), half) for count in (2 * half, half))
    return Row(name, whole, bar, (start, *less), peer)


def mobile_arms() -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms of seven joints on a lift and a mobile base, TIAGo's 18 joints, that hold a box at rest."""
    x, y, z = np.eye(3)
    joints = [hf.Joint("prismatic", x), hf.Joint("prismatic", y), hf.Joint("revolute", z), hf.Joint("prismatic", z)]
    slide = hf.Link(1.0, inertia=0.01 * np.eye(3))
    links = [slide, slide, hf.Link(70.0, [0, 0, 0.2], np.diag([4.0, 4.0, 5.0]))]
    trunk = hf.Trunk(joints, [*links, hf.Link(15.0, [0, 0, 0.5], np.diag([0.8, 0.7, 0.3]))])
    arm, home = serial_arm(7), np.array(HOME["panda"])
    arms = {hand: arm.at(BOX @ frame @ tip_pose(arm, home).inverse()) for hand, frame in HANDS.items()}
    grasps = {hand: hf.Grasp("rigid", frame) for hand, frame in HANDS.items()}
    box = hf.HeldObject.box(3.0, 0.4, 0.3, 0.2)
    chain = hf.ClosedChain(arms, box, grasps, trunk=trunk, mounts=dict.fromkeys(arms, 3))
    return chain, hf.State(np.concatenate([np.zeros(4), home, home]), np.zeros(18), BOX)


def mujoco_steps(chain: hf.ClosedChain, state: hf.State, steps: int, *, recording: bool = True) -> Timed | None:
    """Return steps of MuJoCo under the torques that hold the chain; None if it is not installed.

    Args:
        chain: the chain.
        state: its state at the start.
        steps: number of steps.
        recording: whether every step is a call, after which arrays are recorded; otherwise one call takes all steps.
    """
    if util.find_spec("mujoco") is None:
        return None
    mujoco: Any = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(to_mjcf(chain, state, visuals=False))
    model.opt.timestep = STEP
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    if recording:
        model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, tau = mujoco.MjData(model), holding(chain, state)
    kept = [("qpos", model.nq), ("qvel", model.nv), ("qacc", model.nv), ("energy", 2), ("qfrc_constraint", model.nv)]

    def run() -> None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.ctrl[:] = tau
        if not recording:
            mujoco.mj_step(model, data, steps)
            return
        record = [(getattr(data, name), np.empty((steps, size))) for name, size in kept]
        for k in range(steps):
            mujoco.mj_step(model, data)
            for now, array in record:
                array[k] = now

    return entry("mj_step", run, steps, "mujoco")


def holding(chain: hf.ClosedChain, state: hf.State) -> Any:
    """Return torques that hold the chain with a push of every arm, or none if its joints move freely."""
    if state.qd.any():
        return np.zeros(chain.joint_count)
    return hf.holding_torques(chain, state, internal_force=PUSH)


def rows(steps: int) -> list[Row]:
    """Return all rows but those of compiling."""
    rigid, state = facing_pandas()
    gripped, at = facing_pandas("softfinger", RUBBER)
    mobile, start = mobile_arms()
    windows, falling = n_four_bar()
    hold = holding(rigid, state)

    def springs(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        return hold + 200.0 * (state.q - now.q) - 0.5 * now.qd, memory

    def asked() -> None:
        for _ in range(steps):
            springs(0.0, state, None)

    def track(chain: hf.ClosedChain, frame: hf.Pose) -> ObjectTracking:
        return ObjectTracking(chain, RestToRest(frame, [0.0, 0.0, 0.05], duration=1.0), PUSH)

    free = hf.ControlLaw(lambda t, now, memory, given: (0.0 * now.qd, memory))
    calm, grip = (GravityCompensation(chain, PUSH, 0.1) for chain in (rigid, gripped))
    by_rollout = hf.compile_rollout(gripped, grip)
    one, many = (by_rollout.start(np.tile(at.q, (n, 1)), at.qd, at.object_pose, at.object_twist) for n in (1, MANY))
    record = by_rollout.run(one, steps * STEP, STEP)
    few = max(1, steps // 20)
    own = entry("the law itself", asked, steps)
    peers = [mujoco_steps(*of, steps) for of in ((rigid, state), (gripped, at), (mobile, start), (windows, falling))]
    alone = mujoco_steps(gripped, at, steps, recording=False)
    single = "a rollout of one system, recorded"
    return [
        simulated("two Pandas, rigid, GravityCompensation", 60.0, peers[0], (rigid, state, calm), steps),
        simulated("two Pandas, rigid, ObjectTracking", 60.0, peers[0],
                  (rigid, state, track(rigid, state.object_frame)), steps),
        simulated(SOFT, 150.0, peers[1], (gripped, at, grip), steps),
        simulated("the same, sampled at 1 kHz with delay", 1.05 * 150.0, peers[1], (gripped, at, grip), steps,
                  sample_time=STEP, delay=STEP),
        simulated("two arms on a lift and a mobile base", 300.0, peers[2],
                  (mobile, start, track(mobile, start.object_frame)), steps),
        simulated("Python law at 1 kHz, less its own time", 100.0, peers[0], (rigid, state, springs), steps, own,
                  sample_time=STEP),
        simulated("Python law, not sampled", None, peers[0], (rigid, state, springs), max(1, steps // 4)),
        simulated("N-four-bar, rk4, through singular configurations", 150.0, peers[3], (windows, falling, free), steps,
                  on_singular="continue"),
        Row(single, entry("run", lambda: by_rollout.run(one, steps * STEP, STEP), steps), peer=alone),
        Row("its record.trajectory(0)", entry("trajectory", lambda: record.trajectory(0), steps), (single, 1.0)),
        Row(f"a rollout of {MANY} systems, each of them",
            entry("step", lambda: by_rollout.step(many.copy(), STEP, steps=few), few * MANY), peer=alone),
    ]  # fmt: skip


def measured(all_rows: Sequence[Row], effort: Effort) -> tuple[float, dict[int, float]]:
    """Return F, and the time of every entry by its id [s]."""
    system = make_system(2, 7)
    unit = bind(system, hf.compile(system.chain))
    every = [unit, *(one for row in all_rows for one in (row.entry, *row.less, row.peer) if one is not None)]
    entries = list({id(one): one for one in every}.values())
    medians = np.median(timed(entries, effort, time.process_time), axis=0)
    return float(medians[0]), {id(one): float(x) for one, x in zip(entries, medians, strict=True)}


def first_runs(count: int) -> tuple[float, float]:
    """Return how much longer the first run of a new process takes than the second [s].

    Args:
        count: number of processes, of which the median is taken.

    Returns:
        The time without a cache of machine code, and with that of an earlier process.
    """
    found = []
    for _ in range(count):
        with tempfile.TemporaryDirectory(prefix="holdfast-speed-") as cache:
            found.append([_first_run(cache) for _ in range(2)])
    cold, cached = np.median(found, axis=0).tolist()
    return cold, cached


def _first_run(cache: str) -> float:
    env = os.environ | {"HOLDFAST_CACHE": cache, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    found = subprocess.run([sys.executable, "-c", FIRST_RUN], env=env, cwd=ROOT, capture_output=True, check=True)
    return float(json.loads(found.stdout))


def table(steps: int, effort: Effort) -> str:
    """Return the table as Markdown."""
    all_rows = rows(steps)
    F, seconds = measured(all_rows, effort)
    lines = ["| steps of 1 ms, everything recorded | a step | in F | bar | MuJoCo |", "|---|---|---|---|---|"]
    cost: dict[str, float] = {}
    for row in all_rows:
        cost[row.name] = (seconds[id(row.entry)] - sum(seconds[id(one)] for one in row.less)) / F
        bar = row.bar[1] * cost[row.bar[0]] if isinstance(row.bar, tuple) else row.bar
        peer = "-" if row.peer is None else f"{1e6 * seconds[id(row.peer)]:.3g} us"
        limit = "-" if bar is None else f"{bar:.4g} F{'' if cost[row.name] <= bar else ', missed'}"
        lines.append(f"| {row.name} | {1e6 * F * cost[row.name]:.4g} us | {cost[row.name]:.4g} | {limit} | {peer} |")
    first, half = all_rows[0], all_rows[0].less[0]
    before = half.evaluations * (seconds[id(half)] - F * cost[first.name])
    lines.append(f"| the start of such a run | {1e3 * before:.3g} ms | - | - | - |")
    compiling = [("compiling, cold", COLD), ("compiled code, from disk", CACHED)]
    for (name, bar), taken in zip(compiling, first_runs(effort.rounds), strict=True):
        missed = "" if taken <= bar else ", missed"
        lines.append(f"| {SOFT}: {name} | {1e3 * taken:.4g} ms | - | {1e3 * bar:g} ms{missed} | - |")
    without = "" if util.find_spec("mujoco") else "; MuJoCo is not installed"
    note = f"F is {1e6 * F:.3g} us; one thread, {processor()[0]}{without}."
    return "\n".join([*lines, "", note])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--steps", type=int, default=1000, help="steps of a run")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each row")
    chosen = parser.parse_args()
    print(table(chosen.steps, Effort(TURN, chosen.rounds)))


if __name__ == "__main__":
    main()
