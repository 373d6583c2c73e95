"""Runs whose controllers damp joints with random gains: is every step that is too long for its gain named, no other?

The gain is a multiple of the largest that the scheme follows (`simulation.stability`): from 0.5 to 20 times, and, as
runs of which nothing should be said, from 0.003 to 0.25 times. Each run, of `simulate` and as a system of a rollout, is
compared with one of shorter steps by rk4. Missed: a run that completes without a word, with a velocity off by more than
1 % of the largest. False: one of which something is said although no velocity is off by more than 0.5 %.

Midpoint is a scheme of second order: a run may sum up its errors to more than 1 % though none of its steps differs by
as much from its halves. Such runs are counted apart, as summed (by midpoint).

python benchmarks/unresolved_steps.py [--runs 100] [--first 0]
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.systems import STATES, make_system
from holdfast.simulation.rollout.systems import RolloutStatus
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.simulation.stability import fastest_decay
from holdfast.spatial.scalar import Array, sin

STEPS = 120
STATE = ("q", "qd", "object_pose", "object_twist")
RANGES = {"too high": (0.5, 20.0), "low": (0.003, 0.25)}
LONGEST, ALLOWED, NO_ERROR = 24, 0.01, 0.005
ENDS = ("ended", "named", "silent", "summed", "missed", "false")


class Drawn(NamedTuple):
    """A random controller: its parameters, with a step, a scheme, and the multiple of what the scheme follows."""

    given: dict[str, Any]
    step: float
    scheme: str
    multiple: float
    moving: float


def drawn(random: np.random.Generator, chain: hf.ClosedChain, state: hf.State, range_: tuple[float, float]) -> Drawn:
    """Return a random controller that holds a chain near a state, which may be moving, and sways it."""
    n, moving = chain.joint_count, float(random.random() < 0.5)
    gains = random.uniform(0.3, 1.0, n) * (random.random(n) < random.uniform(0.1, 1.0))
    gains[random.integers(n)] = 1.0
    step, scheme = 10 ** random.uniform(-3.3, -2.5), "rk4" if random.random() < 0.7 else "midpoint"
    multiple = float(np.exp(random.uniform(*np.log(range_))))
    rate = fastest_decay(chain, state, np.hstack([np.diag(gains), np.zeros((n, 6))])).rate
    damping = gains * multiple * scheme_of(scheme).stability_interval / (step * rate)
    given: dict[str, Any] = {"damping": damping, "stiffness": damping * random.uniform(0.0, 5.0)}
    given |= {"drive": random.uniform(0.1, 5.0) * random.normal(size=n), "frequency": random.uniform(1.0, 10.0)}
    given |= {"rest": state.q, "hold": hf.holding_torques(chain, state.at_rest())}
    return Drawn(given, step, scheme, multiple, moving)


def torque(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
    """Return the torques of such a controller."""
    sway = given["drive"] * sin(given["frequency"][()] * t)
    return given["hold"] - given["stiffness"] * (state.q - given["rest"]) - given["damping"] * state.qd + sway, memory


def case(seed: int, lowest: float, highest: float) -> tuple[hf.ClosedChain, hf.State, Any, float, str, float]:
    """Return a random chain, its state, a controller, a step, a scheme, and the multiple of what the scheme follows."""
    random = np.random.default_rng(seed)
    system = make_system(int(random.integers(1, 3)), int(random.integers(6, 8)), 1, seed)
    at = hf.State(system.q[0], system.qd[0], system.object_pose[0], system.object_twist[0])
    one = drawn(random, system.chain, at, (lowest, highest))
    given = {name: np.asarray(x) for name, x in one.given.items()}
    state = replace(at, qd=one.moving * at.qd, object_twist=one.moving * at.object_twist)

    def controller(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        return torque(t, now, memory, given)

    return system.chain, state, controller, one.step, one.scheme, one.multiple


def verdict(seed: int, lowest: float, highest: float) -> str:
    """Return what became of one run: the word for its column."""
    chain, state, controller, step, scheme, multiple = case(seed, lowest, highest)
    run = hf.simulate(chain, state, controller, STEPS * step, step, scheme=scheme)
    if run.stopped is not None:
        return "ended"
    parts = int(np.clip(np.ceil(3 * multiple + 1), 2, LONGEST))
    fine = hf.simulate(chain, state, controller, STEPS * step, step / parts).qd[::parts]
    named = any(one.kind == "unresolved" for one in run.occurrences)

    def of_step(k: int) -> float:
        law = lambda t, now, memory: controller(t + k * step, now, memory)  # noqa: E731
        halves = hf.simulate(chain, run.state(k), law, step, step / 2, scheme=scheme)
        return float(np.abs(halves.qd[-1] - run.qd[k + 1]).max())

    return judged(run.qd, fine, named, lambda: max(map(of_step, range(STEPS))))


def judged(qd: Array, fine: Array, named: bool, of_steps: Callable[[], float]) -> str:
    """Return the word for a complete run, of its rates and those of shorter steps, (steps + 1, n).

    Args:
        qd: the joint rates at all samples.
        fine: those of the run of shorter steps.
        named: whether something is said of the run's steps.
        of_steps: returns the largest difference between a step and its halves.
    """
    count = min(len(fine), len(qd))
    largest = max(np.abs(fine).max(), 1e-3)
    off = np.abs(qd[:count] - fine[:count]).max() / largest
    if named:
        return "false" if off <= NO_ERROR else "named"
    if off <= ALLOWED:
        return "silent"
    return "summed" if of_steps() <= ALLOWED * largest else "missed"


def verdicts_of_rollouts(runs: int, first: int, range_: tuple[float, float]) -> list[str]:
    """Return what became of systems of rollouts: an equal number of one and two arms of six and seven joints."""
    found = []
    for number, (arms, joints) in enumerate(product((1, 2), (6, 7))):
        system = make_system(arms, joints, STATES, number)
        batches: dict[str, list[tuple[hf.State, Drawn]]] = {"rk4": [], "midpoint": []}
        for seed in range(first + number, first + runs, 4):
            i, random = seed % STATES, np.random.default_rng(seed)
            at = hf.State(system.q[i], system.qd[i], system.object_pose[i], system.object_twist[i])
            one = drawn(random, system.chain, at, range_)
            batches[one.scheme].append((at, one))
        for scheme, batch in batches.items():
            found += _of_batch(system.chain, scheme, batch) if batch else []
    return found


def _of_batch(chain: hf.ClosedChain, scheme: str, batch: list[tuple[hf.State, Drawn]]) -> list[str]:
    """Return what became of systems of one chain by one scheme."""
    law = hf.ControlLaw(torque, parameters={name: np.shape(x) for name, x in batch[0][1].given.items()})
    given: Any = {name: np.array([one.given[name] for _, one in batch]) for name in law.parameters}
    h, moving = (np.array([getattr(one, name) for _, one in batch]) for name in ("step", "moving"))
    q, qd, pose, twist = (np.array([getattr(at, name) for at, _ in batch]) for name in STATE)
    start = (q, moving[:, None] * qd, pose, moving[:, None] * twist)
    rollout, finer = (hf.compile_rollout(chain, law, scheme=name) for name in (scheme, "rk4"))
    systems, fine = (one.start(*start, **given) for one in (rollout, finer))
    rates, of_fine, differences = [systems.qd.copy()], [fine.qd.copy()], []
    for _ in range(STEPS):
        halves = rollout.step(systems.copy(), h / 2, steps=2)
        rollout.step(systems, h)
        finer.step(fine, h / LONGEST, steps=LONGEST)
        differences.append(np.abs(halves.qd - systems.qd).max(axis=1))
        rates.append(systems.qd.copy())
        of_fine.append(fine.qd.copy())
    rates, of_fine, most = np.array(rates), np.array(of_fine), np.max(differences, axis=0)
    named = systems.status == RolloutStatus.UNRESOLVED
    words = [judged(rates[:, i], of_fine[:, i], bool(named[i]), lambda i=i: most[i]) for i in range(len(batch))]
    return [word if on else "ended" for word, on in zip(words, systems.running, strict=True)]


def main() -> None:
    """Print how many runs of each range ended, were named, or completed in silence, and how many of these wrongly."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=100, help="number of runs of each range")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    chosen = parser.parse_args()
    print(f"{'':10}{'gains':10}" + "".join(f"{kind:>8}" for kind in ENDS))
    for what, range_ in RANGES.items():
        seeds = range(chosen.first, chosen.first + chosen.runs)
        for by, words in (
            ("rollout", verdicts_of_rollouts(chosen.runs, chosen.first, range_)),
            ("simulate", [verdict(seed, *range_) for seed in seeds]),
        ):
            found = Counter(words)
            print(f"{by:10}{what:10}" + "".join(f"{found[kind]:8}" for kind in ENDS), flush=True)


if __name__ == "__main__":
    main()
