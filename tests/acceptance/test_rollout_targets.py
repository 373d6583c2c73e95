"""Rollouts at full size: a million steps stay closed; steps a second against MuJoCo's."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest
from benchmarks.bench import rollout_entries
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.systems import make_system
from benchmarks.circling import PERIOD, circling

from holdfast import ControlLaw, compile_rollout
from holdfast.dynamics import closure

pytestmark = pytest.mark.long

SYSTEMS, STEPS, AT_ONCE = 8, 1_000_000, 997  # 997 ms and the period have no common multiple soon
STEP = 1e-3


def test_a_million_steps(capsys):
    """Eight pairs of Pandas carry a box round for 1,000 s, each at another phase, and never rest: closed to 1e-11."""
    motion = circling()

    def torque(t, state, memory, given):
        return motion.torque(t + given["phase"][()], state.q, state.qd), memory

    rollout = compile_rollout(motion.chain, ControlLaw(torque, parameters={"phase": ()}))
    phase = PERIOD * np.arange(SYSTEMS) / SYSTEMS
    states = [motion.state(t) for t in phase]
    given = {name: np.array([getattr(s, name) for s in states]) for name in ("q", "qd", "object_pose", "object_twist")}
    systems = rollout.start(**given, phase=phase)
    done, position, velocity, slowest, fastest = 0, 0.0, 0.0, np.inf, 0.0
    begin, worked = time.perf_counter(), time.process_time()
    while done < STEPS:
        some = min(AT_ONCE, STEPS - done)
        rollout.step(systems, STEP, steps=some, phase=phase)
        done += some
        rate = np.abs(systems.qd).max(axis=1)
        slowest, fastest = min(slowest, rate.min()), max(fastest, rate.max())
        position, velocity = max(position, systems.gap[:, 0].max()), max(velocity, systems.gap[:, 1].max())
    wall, busy = time.perf_counter() - begin, time.process_time() - worked
    gaps = [gap for row in range(SYSTEMS) for gap in closure(motion.chain, systems.state(row)).values()]
    last = max(float(np.abs(gap.position).max()) for gap in gaps)
    with capsys.disabled():
        print(
            f"\n{STEPS:,} steps of {1e3 * STEP:g} ms of {SYSTEMS} systems: fastest joint {slowest:.2f} to {fastest:.2f}"
            f" rad/s; grasps open at most {position:.1e} m or rad, {velocity:.1e} m/s or rad/s, {last:.1e} m or rad at"
            f" the end by the reference; {1e6 * busy / STEPS / SYSTEMS:.2f} us of a core a step, {wall:.0f} s",
            end="",
        )
    assert systems.running.all() and np.allclose(systems.t, STEPS * STEP, rtol=1e-12)
    assert slowest >= 0.5 and fastest <= 3.0
    assert max(position, last) <= 1e-11 and velocity <= 1e-11


def test_steps_a_second(capsys):
    """2 x 7, RK4 and projection: >= 400,000 steps a second of one core, >= 4 times those of the fastest mj_step."""
    pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")
    system = make_system(2, 7)
    ours = [rollout_entries.rollout(system, "rk4", size) for size in (64, 512)]
    rivals = [rollout_entries.mj_step(system, "Euler", welds) for welds in ("hardest", "default")]
    ways, load = [*ours, *rivals], os.getloadavg()[0]
    seconds = timed([way.entry for way in ways], Effort(turn=0.05, rounds=31), now=time.process_time)
    rates = 1.0 / np.median(seconds, axis=0)
    ratios = [min(float(np.median(seconds[:, j] / seconds[:, k])) for j in (2, 3)) for k in (0, 1)]
    with capsys.disabled():
        print(f"\nsteps a second of one core, medians of 31 rounds (load {load:.1f} on {os.cpu_count()} cores):")
        for way, rate in zip(ways, rates, strict=True):
            print(f"  {way.entry.library} {way.entry.name}: {rate:,.0f}; grasps open {way.gap():.0e}")
        print(f"  fastest mj_step / ours: {ratios[0]:.2f} (64 systems), {ratios[1]:.2f} (512)", end="")
    assert max(way.gap() for way in ours) <= 1e-12
    assert max(rates[:2]) >= 400_000
    assert max(ratios) >= 4.0
