"""Entries of the distribution of forces: two Pandas that hold a box, beside forward dynamics and other solvers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

import holdfast as hf
from benchmarks.bench.clock import Effort, summary, timed
from benchmarks.bench.entries import LIBRARY, Timed
from benchmarks.bench.systems import facing_pandas
from holdfast.compiled import CompiledChain
from holdfast.compiled.structure import Options
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.forces.elastic_distribution import DISTRIBUTE, programme
from holdfast.questions.arrays import value_of
from holdfast.spatial.scalar import Array

SYSTEMS = 128
AGREED = 1e-5  # relative difference of costs that are the same
SOFT_FINGERS, BOXES = "soft fingers", "rigid"  # the second has limits of joints alone: a quadratic programme
KINDS = {
    SOFT_FINGERS: ("softfinger", hf.Friction(0.8, torsion_radius=0.02), None),
    BOXES: ("rigid", None, None),
    "rigid, rated": ("rigid", None, hf.WrenchLimits(moment=20.0, force=200.0)),
}
STANDS = ("in the world", "on a trunk of 3", "floating", "giving way")  # the last: what is asked may


def chain_of(kind: str, stand: str = STANDS[0]) -> tuple[hf.ClosedChain, hf.State]:
    """Return two Pandas that hold a box, on their stand."""
    name, contact, limits = KINDS[kind]
    chain, state = facing_pandas(name, contact)
    grasps = {arm: replace(grasp, wrench_limits=limits) for arm, grasp in chain.grasps.items()}
    chain, deck = replace(chain, grasps=grasps), hf.Link(60.0, inertia=np.diag([2.0, 2.0, 3.0]))
    if stand == "floating":
        floating = replace(chain, trunk=hf.Trunk(floating=deck), mounts=dict.fromkeys(chain.arms, "base"))
        return floating, replace(state, base_pose=hf.Pose.identity(), base_twist=np.zeros(6))
    if stand == "on a trunk of 3":
        axes = [hf.Joint("prismatic", axis) for axis in np.eye(3)[:2]]
        slide = hf.Link(1.0, inertia=0.01 * np.eye(3))
        trunk = hf.Trunk([*axes, hf.Joint("revolute")], [slide, slide, deck])
        none = np.zeros(3)
        state = replace(state, q=np.r_[none, state.q], qd=np.r_[none, state.qd])
        return replace(chain, trunk=trunk, mounts=dict.fromkeys(chain.arms, 2)), state
    return chain, state


def entries(kind: str, stand: str = STANDS[0]) -> Iterator[Timed]:
    """Yield bound calls of forward dynamics and of the distribution, and then batches of them."""
    chain, state = chain_of(kind, stand)
    further = ("task_weight",) if stand == "giving way" else ()
    fast = hf.compile(chain, parameters=[*further])
    random = np.random.default_rng(0)
    one = [state.q, state.qd, state.object_pose, state.object_twist, np.array([0.3, 0.2, -0.1, 0.5, 0.4, 1.0])]
    many = [np.array([x] * SYSTEMS) for x in one]
    many[0] += 0.01 * random.normal(size=many[0].shape)
    many[4] += random.normal(size=many[4].shape)
    names, torques = DISTRIBUTE.inputs[:4], np.zeros(chain.joint_count)
    base = {"floating_pose": state.base_pose, "floating_twist": state.base_twist} if chain.floats else {}
    given = {name: np.array(x) for name, x in [*zip(names, one, strict=False), *base.items()]}
    bases: dict[str, Any] = {name: np.array([x] * SYSTEMS) for name, x in base.items()}
    yield Timed("forward dynamics, bound", LIBRARY, fast.bind(**given, tau=torques), 1)
    asked: dict[str, Any] = {
        f"{k} iterations": CompiledChain(chain, Options(further=further, iterations=k), None).distribute
        for k in (16, 12, 0)
    }
    for name, function in asked.items():
        yield Timed(f"{name}, bound", LIBRARY, function.bind(**given, acceleration=one[4]), 1)
    zeros = np.zeros((SYSTEMS, chain.joint_count))
    q, qd, pose, twist, _ = many
    out = fast.forward_dynamics(q, qd, zeros, pose, twist, **bases)
    again = partial(fast.forward_dynamics, q, qd, zeros, pose, twist, **bases, out=out, threads=1)
    yield Timed("forward dynamics, batch", LIBRARY, again, SYSTEMS)
    for name, function in asked.items():
        out = function(*many, **bases)
        yield Timed(f"{name}, batch", LIBRARY, partial(function, *many, **bases, out=out, threads=1), SYSTEMS)
    if stand == STANDS[0]:
        yield from by_others(chain, state, one[4])


def by_others(chain: hf.ClosedChain, state: hf.State, acceleration: Array) -> Iterator[Timed]:
    """Yield the installed solvers of the same programme, which is made beforehand: Clarabel, or those without cones."""
    try:
        clarabel: Any = import_module("clarabel")

        from benchmarks.clarabel_peer import arguments, cost, solved
        from benchmarks.quadratic_peers import solvers
    except ImportError:
        return
    own = {name: value_of(name, chain) for name in DISTRIBUTE.own(chain) if name != "acceleration"}
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), hf.Inputs().shaped(chain))
    made = programme(motion, own | {"acceleration": acceleration})
    price = float(own["price"])
    *given, places = arguments(made.blocks, made.e, price)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    yield Timed("Clarabel, without the map", "Clarabel", lambda: clarabel.DefaultSolver(*given, settings).solve(), 1)
    if not any(block.cones for block in made.blocks):
        least = cost(made.blocks, *solved(made.blocks, made.e, price), price)
        for name, solve in solvers(made.blocks, made.e, price):
            x = solve()
            assert abs(cost(made.blocks, [x[place] for place in places], x[-1], price) - least) < AGREED * abs(least)
            yield Timed(f"{name}, without the map", name, solve, 1)


def compare(
    kind: str, effort: Effort, now: Callable[[], float] = time.perf_counter, stand: str = STANDS[0]
) -> list[dict[str, Any]]:
    """Time the distribution, relative to a bound call of forward dynamics of the same chain in the same rounds.

    Args:
        kind: a kind of grasps.
        effort: duration of the measurement.
        now: the clock [s].
        stand: of the arms.
    """
    listed = list(entries(kind, stand))
    seconds = timed(listed, effort, now)
    return [
        {
            "kind": kind,
            "name": entry.name,
            "library": entry.library,
            **summary(seconds[:, k]),
            "ratio": float(np.median(seconds[:, k] / seconds[:, 0])),
        }
        for k, entry in enumerate(listed)
    ]
