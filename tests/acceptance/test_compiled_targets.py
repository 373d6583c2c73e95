"""Compiled functions at full size: bits, agreement with the reference, bad systems, damaged code on disk."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from benchmarks.bench import rollout_entries
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.systems import make_system
from benchmarks.circling import PERIOD, circling
from benchmarks.operation_counts import two_pandas

import holdfast
from holdfast import ClosedChain, ControlLaw, compile_rollout
from holdfast.compiler.targets import cpu
from holdfast.dynamics import Status, closure
from tests.acceptance.comparison import disagreement, relative
from tests.acceptance.test_agreement import grasps_for
from tests.compiled import problems
from tests.compiled.problems import FIELDS, STATE, answer, numbers, one, outputs
from tests.compiled.test_functions import EVERY
from tests.compiled.test_functions import disagreement as of_function
from tests.compiler.programs import all_same_bits
from tests.systems import random_system, scaled_condition, two_collinear_stretched_6r, well_conditioned_system
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import CASES, stored
from tests.systems.random_parts import KINDS

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
TOLERANCE = 1e-11
INTERPRETING = 60.0  # [s] for the interpreter, which is slow
LANES = cpu.lanes()


def mixed_chain() -> ClosedChain:
    """Return five arms of three types, every kind of grasp, one arm free."""
    arms = ((7, "rigid"), (5, "hinge"), (7, "rigid"), (4, "softfinger"), (3, "ball"), (3, None))
    return problems.chain_of(arms, 3)


@pytest.mark.parametrize("name", ["two pandas", "mixed"])
def test_same_bits(name, capsys):
    """1,000 random states: single = lanes = tails = threads = as many by the interpreter as fit in a minute."""
    chain = two_pandas() if name == "two pandas" else mixed_chain()
    fast = holdfast.compile(chain, parameters=("link_wrench",))
    given = numbers(chain, 1000) | problems.forces(chain, 1000)
    out = fast.forward_dynamics(**one(given, 0))
    bound = fast.bind()
    singles = []
    for i in range(1000):
        singles.append(outputs(fast.forward_dynamics(**one(given, i))))
        state = [given[k][i] for k in STATE]
        plain = fast.forward_dynamics(*state)
        assert all_same_bits(outputs(fast.forward_dynamics(*state, out=out)), outputs(plain))
        for k in STATE:
            getattr(bound, k)[...] = given[k][i]
        assert bound() is plain.status and all_same_bits(outputs(bound.result), outputs(plain))
    stacked = tuple(np.stack(x) for x in zip(*singles, strict=True))
    for threads in (1, 2, 3, 7):
        assert all_same_bits(outputs(fast.forward_dynamics(**given, threads=threads)), stacked)
    start, size = 0, 1
    while start < 1000:  # tails of every length
        part = slice(start, min(start + size, 1000))
        found = fast.forward_dynamics(**{k: x[part] for k, x in given.items()})
        assert all_same_bits(outputs(found), tuple(x[part] for x in stacked))
        start, size = start + size, size % (2 * LANES + 1) + 1
    begin, done = time.perf_counter(), 0
    while done < 1000 and time.perf_counter() - begin < INTERPRETING:
        assert all_same_bits(singles[done], problems.interpreted(fast, one(given, done)))
        done += 1
    with capsys.disabled():
        print(f"\n{name}: 1,000 states, {done} of them interpreted, {len(stacked)} outputs: all the same bits", end="")
    assert done >= 30


@pytest.mark.parametrize("method", ["recursive", "mass_matrix"])
def test_all_stored_cases(method, capsys):
    """Every stored case with unique forces: all outputs <= 1e-11 of the reference's; planar ones: what is unique."""
    worst, where = 0.0, ""
    for name, case in CASES.items():
        p = stored(name)
        found = answer(p, method=method)
        expected = p.solved()
        if case["tags"]["f_unique"]:
            error = problems.relative_disagreement(found, expected)
        else:
            assert found.status is expected.status is Status.INDETERMINATE_FORCES
            unique = ("qdd", "object_acceleration", "contact_acceleration")
            error = max(relative(getattr(found, k), getattr(expected, k), floor=1.0) for k in unique)
        if error > worst:
            worst, where = error, name
    with capsys.disabled():
        print(f"\n{len(CASES)} cases compiled ({method}) and by the reference: worst {worst:.1e} ({where})", end="")
    assert worst <= TOLERANCE


def test_random_states(capsys):
    """10,000 closed states of 100 random chains, scaled condition < 1e6: all outputs <= 1e-11 of the reference's."""
    worst, worst_condition, states, draws = 0.0, 0.0, 0, 0
    kinds: dict[str, int] = {}
    for index in range(100):
        arm_count = 1 + index % 8
        grasps = grasps_for(index // 8, arm_count)
        method = ("auto", "recursive", "mass_matrix")[index % 3]
        seeds = range(5_000_000 + 1000 * index, 5_001_000 + 1000 * index)
        cases = (random_system(seed, arms=arm_count, grasps=grasps) for seed in seeds)
        case = next(case for case in cases if scaled_condition(case) < 1e4)  # neither locked nor always singular
        problem = as_chain(case)
        # all that is not a parameter is the same from here on
        kept, accepted = holdfast.compile(problem.chain, method=method, parameters=("link_wrench",)), 0
        for k in range(1000):
            judged = copy.deepcopy(case)
            there = problems.closed_again(problem, judged, (index, k))
            draws += 1
            condition = scaled_condition(judged)
            if condition >= 1e6:
                continue
            fast, given = (
                holdfast.compile(there.chain, method=method, parameters=("link_wrench",)),
                problems.given_by(there),
            )
            assert fast.forward_dynamics.calls.kernel is kept.forward_dynamics.calls.kernel
            expected = there.solved(check=False)
            found = fast.forward_dynamics(**given)
            assert found.rank == expected.rank and found.status is expected.status
            worst = max(worst, disagreement(found, expected))
            worst_condition = max(worst_condition, condition)
            states, accepted = states + 1, accepted + 1
            if accepted == 100:
                break
        for kind in set(grasps):
            kinds[kind] = kinds.get(kind, 0) + accepted
    with capsys.disabled():
        print(
            f"\n{states} states of 100 chains ({states / draws:.0%} of the draws; each grasp {kinds}), conditions to"
            f" {worst_condition:.1e}: worst {worst:.1e}",
            end="",
        )
    assert states == 10_000
    assert worst <= TOLERANCE


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("known", [True, False])
def test_bad_systems_in_a_batch(known, threads, capsys):
    """4,096 systems, every 7th singular, not-a-number in every 11th: statuses exact, the others as in a clean batch."""
    count = 4096
    p = as_chain(two_collinear_stretched_6r(1))
    random, given = np.random.default_rng(0), problems.given_by(p)
    every = {name: np.repeat(given[name][None], count, axis=0) for name in STATE}
    every["q"] += random.uniform(-1.0, 1.0, every["q"].shape)
    for name in ("qd", "tau", "object_twist"):
        every[name] += random.normal(size=every[name].shape)
    fast = holdfast.compile(p.chain, generic_rank=12 if known else None)
    clean = fast.forward_dynamics(**every)
    assert set(clean.status) == {Status.OK}

    singular, invalid = np.arange(count) % 7 == 0, np.arange(count) % 11 == 0
    every = {name: x.copy() for name, x in every.items()}
    every["q"][singular] = given["q"]
    names = random.choice(STATE, count)
    for i in np.flatnonzero(invalid):
        x = every[names[i]]
        x[i, random.integers(x.shape[1])] = random.choice([np.nan, np.inf, -np.inf])
    found = fast.forward_dynamics(**every, threads=threads)
    expected = np.where(invalid, Status.INVALID, np.where(singular, Status.SINGULAR, Status.OK))
    wrong = int((found.status != expected).sum())
    bad = singular | invalid
    empty = all(np.isnan(getattr(found, name)[bad]).all() for name in FIELDS)
    same = all(all_same_bits((x[~bad],), (y[~bad],)) for x, y in zip(outputs(found), outputs(clean), strict=True))
    with capsys.disabled():
        print(
            f"\n{count} systems, {bad.sum()} bad (generic rank {'given' if known else 'found'}, {threads} threads):"
            f" {wrong} wrong statuses; the others {'bit-identical' if same else 'CHANGED'}",
            end="",
        )
    assert wrong == 0 and empty and same and fast.generic_rank == 12


def any_problem(seed: int) -> Problem:
    """Return one to four arms of three to seven joints, every kind of grasp, one arm in six without one."""
    random = np.random.default_rng((seed, 12))
    count = int(random.integers(1, 5))
    grasps = [None if k == 5 else KINDS[k % 4] for k in random.integers(0, 6, count)]
    grasps[0] = KINDS[seed % 4]
    joints = random.integers(3, 8, count).tolist()
    return as_chain(well_conditioned_system(seed, joints=joints, grasps=grasps, moving_base=True))


@pytest.mark.parametrize("chunk", range(10))
def test_two_hundred_chains(chunk):
    """All functions, each to 1e-11 of max(1, size)."""
    worst, met = dict.fromkeys(["forward_dynamics", *EVERY], 0.0), Counter()
    for seed in range(20 * chunk, 20 * chunk + 20):
        p = any_problem(seed)
        met.update(grasp.kind for grasp in p.chain.grasps.values())
        assert p.inputs.link_wrenches is not None and p.inputs.base_twists is not None
        worst["forward_dynamics"] = max(worst["forward_dynamics"], disagreement(answer(p), p.solved()))
        for function in EVERY:
            worst[function] = max(worst[function], of_function(p, function, seed))
    print(f"\n20 chains with {dict(met)}: " + ", ".join(f"{name} {x:.1e}" for name, x in worst.items()))
    assert max(worst.values()) <= TOLERANCE
    assert set(met) == set(KINDS)


# Damages entries of a chain's code one after the other; prints a line for each that was rebuilt with the same answer.
DAMAGE = """
import gc
from pathlib import Path
import numpy as np
import holdfast
from holdfast.compiled import kernels
from holdfast.compiler import cache
from holdfast.compiler.targets import cpu
from holdfast.compiler.targets.llvm import builtin
from tests.compiled.problems import chain_of, numbers, one, outputs
from tests.compiler.programs import all_same_bits

compilations = []
compiled = cpu._compiled
cpu._compiled = lambda *given: compilations.append(1) or compiled(*given)
chain = chain_of(((1, "ball"), (2, "softfinger")))
given = numbers(chain, 5)

def answers():
    gc.collect()  # the last chain, and its code
    assert not kernels._made
    builtin._definition.cache_clear(), builtin._code.cache_clear()
    fast = holdfast.compile(chain)
    out = fast.forward_dynamics(**one(given, 0))
    for _ in range(2):
        fast.forward_dynamics(*one(given, 0).values(), out=out)
    return outputs(out) + outputs(fast.forward_dynamics(**given))

expected = tuple(x.copy() for x in answers())
entries = sorted(cache.folder().glob("*.code"))
whole = [path.read_bytes() for path in entries]
assert len(entries) == 4, entries
for trial in range(300):
    random = np.random.default_rng(trial)
    k = trial % 4
    damaged = bytearray(whole[k])
    at = int(random.integers(len(damaged)))
    if trial % 3 == 0:
        del damaged[at:]
    elif trial % 3 == 1:
        zeros = min(int(random.integers(1, 400)), len(damaged) - at)
        damaged[at:at + zeros] = bytes(zeros)
    else:
        damaged[at] ^= 1 << int(random.integers(8))
    if bytes(damaged) == whole[k]:
        damaged[at] ^= 1
    entries[k].write_bytes(damaged)
    before = len(compilations)
    assert all_same_bits(answers(), expected), trial
    assert len(compilations) == before + 1, (trial, len(compilations) - before)
    assert entries[k].read_bytes() == whole[k], trial
    print(trial, flush=True)
"""


def test_damaged_code_on_disk(tmp_path, capsys):
    """300 truncated, zeroed and flipped entries of a compiled chain: each rebuilt, none crashes, none is loaded."""
    env = os.environ | {"HOLDFAST_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", DAMAGE], env=env, capture_output=True, text=True, timeout=900)
    rebuilt = done.stdout.split()
    with capsys.disabled():
        print(f"\n{len(rebuilt)} of 300 damaged entries rebuilt, with the same answers", end="")
    assert done.returncode == 0, f"code {done.returncode} after {rebuilt[-1:]}: {done.stderr}"
    assert rebuilt == [str(k) for k in range(300)]


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
