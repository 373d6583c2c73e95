"""A law that depends on more than its arguments is refused where it would become machine code, and in runs."""

import itertools
import time

import numpy as np
import pytest

import holdfast as hf
from holdfast import ControlLaw
from holdfast.control import compile_law
from holdfast.errors import ModelError
from tests.control.two_pandas import two_pandas

CHAIN, STATE = two_pandas()
N = CHAIN.joint_count
COUNTER, CLOCK, GLOBAL = itertools.count(), time.perf_counter, {"gain": 1.0}


def changing_global(t, state, memory, given):
    """Return torques with a gain that every call changes."""
    GLOBAL["gain"] *= 1.1
    return -GLOBAL["gain"] * state.qd, memory


def one_more_term(t, state, memory, given):
    """Return torques of as many terms as calls so far."""
    return sum((state.qd for _ in range(next(COUNTER))), -state.qd), memory


NO_FUNCTIONS = {
    "random numbers": lambda t, state, memory, given: (np.random.normal(size=N) - state.qd, memory),
    "random memory": lambda t, state, memory, given: (-state.qd, memory + np.random.uniform()),
    "a clock": lambda t, state, memory, given: (np.sin(CLOCK()) * state.q, memory),
    "a counter": lambda t, state, memory, given: ((1.0 + next(COUNTER)) * -state.qd, memory),
    "a global that changes": changing_global,
    "another number of operations": one_more_term,
}
FUNCTIONS = {
    "random numbers of a seed": lambda t, state, memory, given: (
        np.random.default_rng(0).normal(size=N) - state.qd,
        memory,
    ),
    "not-a-number": lambda t, state, memory, given: (np.full(N, np.nan) * state.qd, memory),
    "noise as a parameter": lambda t, state, memory, given: (given["noise"] - state.qd, memory),
}


@pytest.mark.parametrize("what", NO_FUNCTIONS)
@pytest.mark.parametrize("use", ["compile_law", "compile_rollout", "simulate"])
def test_refused(use, what):
    """Before anything is computed, with the advice to give noise as a parameter."""
    law = ControlLaw(NO_FUNCTIONS[what], memory=np.zeros(1))
    uses = {
        "compile_law": lambda: compile_law(law, CHAIN),
        "compile_rollout": lambda: hf.compile_rollout(CHAIN, law),
        "simulate": lambda: hf.simulate(CHAIN, STATE, law, 0.002, 0.001),
    }
    with pytest.raises(ModelError, match=r"expected a function of its arguments alone, .* parameters={'noise'"):
        uses[use]()


@pytest.mark.parametrize("what", FUNCTIONS)
def test_accepted(what):
    """Constants may come from anywhere, as long as every call gives the same ones."""
    law = ControlLaw(FUNCTIONS[what], memory=np.zeros(1), parameters={"noise": (N,)})
    assert repr(compile_law(law, CHAIN)).startswith("<CompiledLaw")


def noisy_motion(t):
    """Return a base that trembles at random."""
    return CHAIN.arms["left"].base, np.zeros(6), np.random.normal(size=6)


SURROUNDINGS = {
    "base motion of 'left'": {"base_motion": {"left": noisy_motion}},
    "inputs": {"inputs": lambda t, state: hf.Inputs(object_wrench=np.random.normal(size=6))},
}


@pytest.mark.parametrize("what", SURROUNDINGS)
def test_surroundings_of_rollouts(what):
    """Motions of bases and external wrenches become machine code, too, and are refused alike."""
    with pytest.raises(ModelError, match=f"{what}: expected a function of its arguments alone"):
        hf.compile_rollout(CHAIN, **SURROUNDINGS[what])
