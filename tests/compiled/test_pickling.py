"""Compiled chains and results travel: pickled, copied, to another process."""

import copy
import pickle

import numpy as np
import pytest

import holdfast
from holdfast.compiled import CompiledChain
from holdfast.compiled.structure import Options
from holdfast.dynamics import Status
from holdfast.questions.question import QUESTIONS
from tests.compiled import problems
from tests.compiled.problems import chain_named, compiled, numbers, one, outputs
from tests.compiler.programs import all_same_bits
from tests.systems import planar_parallelogram
from tests.systems.as_chain import as_chain


@pytest.mark.parametrize("again", [copy.deepcopy, copy.copy, lambda x: pickle.loads(pickle.dumps(x))])
def test_compiled_chains(again):
    """The copy answers with the same bits, by the same code."""
    chain, fast = chain_named("nine"), compiled("nine")
    other = again(fast)
    assert (
        other is not fast
        and other.forward_dynamics.calls.kernel is fast.forward_dynamics.calls.kernel
        and other.options == fast.options
    )
    given = numbers(chain, 5) | problems.forces(chain, 5)
    assert all_same_bits(outputs(other.forward_dynamics(**given)), outputs(fast.forward_dynamics(**given)))
    single = other.forward_dynamics(**one(given, 2))
    for _ in range(2):
        other.forward_dynamics(**one(given, 2), out=single)
        assert all_same_bits(outputs(single), outputs(fast.forward_dynamics(**one(given, 2))))


def test_generic_rank_travels():
    """What was found out need not be sought again."""
    p = as_chain(planar_parallelogram(0.3))
    fast = holdfast.compile(p.chain)
    expected = fast.forward_dynamics(**problems.given_by(p))
    other = pickle.loads(pickle.dumps(fast))
    assert other.generic_rank == 9
    found = other.forward_dynamics(**problems.given_by(p))
    assert found.status is Status.INDETERMINATE_FORCES and all_same_bits(outputs(found), outputs(expected))


@pytest.mark.parametrize("batch", [None, 0, 3])
def test_results(batch):
    """A result comes back with the same numbers, statuses and parts; it no longer depends on the code."""
    chain, fast = chain_named("nine"), compiled("nine")
    given = one(numbers(chain, 1), 0) if batch is None else numbers(chain, batch)
    result = fast.forward_dynamics(**given)
    for other in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        assert type(other) is type(result) and other.batch == batch
        assert all_same_bits(outputs(other), outputs(result))
        assert np.array_equal(other.status, result.status) and np.array_equal(other.rank, result.rank)
        assert np.array_equal(other["arm3"].qdd, result["arm3"].qdd)
        other.qdd[...] = 0.0
        assert other["arm0"].qdd.base is not None and not other["arm0"].qdd.any()
        assert not batch or result.qdd.any()
    assert type(result.chain).__name__ == "ClosedChain" and result.method == "sequential"


@pytest.mark.parametrize("name", QUESTIONS)
def test_functions(name):
    """A function is that of its question again, and so are its derivatives."""
    chain = chain_named("two")
    of = getattr(CompiledChain(chain, Options(), None), name)
    made = [of, of.derived("vjp", of.question.names[:1], of.question.by[:1])] if of.question.by else [of]
    for function in made:
        for other in (pickle.loads(pickle.dumps(function)), copy.deepcopy(function)):
            assert other is not function and (other.question, other.request) == (function.question, function.request)
            assert other.name == function.name and [*other.externals] == [*function.externals]
