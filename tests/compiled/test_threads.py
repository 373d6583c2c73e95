"""Threads of compiled calls: the same bits for any number, chosen or asked for, of every kind of batch."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from holdfast.compiler import threads as batch_threads
from holdfast.compiler.targets import cpu
from holdfast.control import compile_law
from holdfast.gym.task import BatchFunction
from tests.compiled.problems import chain_named, compiled, forces, numbers
from tests.compiler.programs import all_same_bits
from tests.compiler.started_threads import started_threads
from tests.longer import mostly_slow
from tests.simulation.rollout.problems import problem, started, swinging

COUNT = 5 * cpu.lanes() + 3  # six blocks
Ask = Callable[[int | None], tuple[np.ndarray, ...]]


def forward_dynamics() -> Ask:
    """A question with a status; every parameter differs between systems."""
    chain, fast = chain_named("two"), compiled("two")
    given = numbers(chain, COUNT) | forces(chain, COUNT)
    return lambda threads: (fast.forward_dynamics(**given, threads=threads).memory,)


def kinetic_energy() -> Ask:
    """A question without a status."""
    chain, fast = chain_named("two"), compiled("two")
    given = {name: x for name, x in numbers(chain, COUNT).items() if name != "tau"}
    return lambda threads: (fast.kinetic_energy(**given, threads=threads),)


def gradients() -> Ask:
    """Products with a Jacobian from the left."""
    chain, fast = chain_named("two"), compiled("two")
    given, by = numbers(chain, COUNT), ("q", "tau")

    def ask(threads: int | None) -> tuple[np.ndarray, ...]:
        found = fast.forward_dynamics.vjp(**given, qdd=given["qd"], by=by, threads=threads)
        return tuple(found[name] for name in by)

    return ask


def law() -> Ask:
    """Torques of a control law."""
    chain, state = problem("one")
    fast = compile_law(swinging("one").law, chain)
    q = state.q + 1e-3 * np.random.default_rng(0).normal(size=(COUNT, chain.joint_count))
    rest = (state.qd, state.object_pose, state.object_twist)
    return lambda threads: tuple(fast.torques(0.3, q, *rest, threads=threads))


def rollout() -> Ask:
    """Steps, the projection before the first one included."""
    _, state = problem("one")

    def ask(threads: int | None) -> tuple[np.ndarray, ...]:
        systems = started(swinging("one"), state, COUNT, threads=threads)
        return tuple(swinging("one").step(systems, 2e-3, steps=3, threads=threads).arrays.values())

    return ask


def recorded() -> Ask:
    """A run with a record."""
    _, state = problem("one")
    systems = started(swinging("one"), state, COUNT)
    return lambda threads: (swinging("one").run(systems, 4e-3, 2e-3, record=["q"], threads=threads)["q"],)


def tape() -> Ask:
    """The way back through steps."""
    _, state = problem("one")
    systems = started(swinging("one"), state, COUNT)

    def ask(threads: int | None) -> tuple[np.ndarray, ...]:
        taken = swinging("one").tape(systems, 2e-3, steps=2, threads=threads)
        found = taken.vjp({"q": np.ones_like(systems.q)}, by=["q", "qd"], threads=threads)
        return found["q"], found["qd"]

    return ask


def function_of_a_task() -> Ask:
    """A function of named arrays, as the observations of gym's tasks are."""
    evaluate = BatchFunction(lambda given: {"y": 2.0 * np.sin(given["x"])}, {"x": (3,)}, {"y": (3,)})
    x = np.random.default_rng(0).normal(size=(COUNT, 3))
    return lambda threads: (evaluate(COUNT, {"x": x}, threads)["y"],)


KINDS = [forward_dynamics, kinetic_energy, gradients, law, rollout, recorded, tape, function_of_a_task]


@pytest.mark.parametrize("kind", mostly_slow(KINDS, [*KINDS][:3]))
def test_bits(kind, monkeypatch):
    """One thread, two, five, and as many as a machine of three processors is worth: the same bits."""
    started_here = started_threads(monkeypatch, processors=3, least_work=1)
    ask = kind()
    one = ask(1)
    assert np.isfinite(one[0]).mean() > 0.9
    started_here.clear()
    for threads in (2, 5, None):
        assert all_same_bits(ask(threads), one), threads
        assert started_here, threads
        started_here.clear()
    ask(1)
    assert started_here == []


@pytest.mark.slow
def test_small_batches(monkeypatch):
    """A hundred states of two arms, and a few steps of some systems: on the caller's thread unless told otherwise."""
    started_here = started_threads(monkeypatch, processors=64)
    for kind in KINDS:
        kind()(None)
    assert started_here == []


def test_large_batches(monkeypatch):
    """Many states, or many steps of a few systems: on all three processors."""
    started_here = started_threads(monkeypatch, processors=3)
    chain, fast = chain_named("two"), compiled("two")
    fast.forward_dynamics(**numbers(chain, 10_000))
    assert len(started_here) == 2
    systems = started(swinging("one"), problem("one")[1], COUNT)
    started_here.clear()
    run, shared = batch_threads._run, []
    monkeypatch.setattr(
        batch_threads, "_run", lambda part, blocks, count: (shared.append(count), run(part, blocks, count))
    )
    swinging("one").step(systems, 1e-5, steps=1000)  # in several calls, as some steps are compared with their halves
    assert set(shared) == {3}
    assert len(started_here) == 2 * len(shared)
    started_here.clear()
    fast.forward_dynamics(**numbers(chain, 10_000), threads=1)
    assert not started_here


def one_system(threads: Any) -> Any:
    """Ask for one system."""
    chain = chain_named("two")
    return compiled("two").forward_dynamics(**{name: x[0] for name, x in numbers(chain, 1).items()}, threads=threads)


@pytest.mark.parametrize("threads", [None, 1, np.int64(2)])
def test_accepted(threads):
    """For one system, too, where they have nothing to do."""
    assert all_same_bits((one_system(threads).memory,), (one_system(1).memory,))
