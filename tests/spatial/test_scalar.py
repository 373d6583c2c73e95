"""The vocabulary of traced functions means the same on floats, on other scalars, and in NumPy's spelling."""

import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiler.errors import CompileError
from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.control import compile_law
from holdfast.control.traced_law import law_program
from holdfast.spatial import scalar
from holdfast.spatial.traced_array import REPLACEMENTS, TracedArray
from tests.control.two_pandas import two_pandas
from tests.spatial.dual import Dual, duals, slopes_of


@pytest.mark.parametrize("x", [0.0, 1e-300, 0.3, 2.0, 1e5])
@pytest.mark.parametrize(
    ("name", "derivative"),
    [("sin", math.cos), ("cos", lambda x: -math.sin(x)), ("sqrt", lambda x: 0.5 / math.sqrt(x))],
)
def test_functions(name, derivative, x):
    """A float gives the C library's value; another scalar its own."""
    assert getattr(scalar, name)(x) == getattr(math, name)(x)
    if name != "sqrt" or x > 0:
        other = getattr(scalar, name)(Dual(x, 2.0))
        assert (other.value, other.tangent) == (getattr(math, name)(x), 2.0 * derivative(x))


def test_root_of_a_negative():
    """A negative radicand is not a number: visible later, no exception inside an algorithm."""
    assert math.isnan(scalar.sqrt(-1e-300))
    assert math.isnan(scalar.sqrt(math.nan))


@pytest.mark.parametrize(("a", "b"), [(1.0, 2.0), (2.0, 1.0), (-0.5, -0.5)])
def test_selection(a, b):
    """Comparisons select without a branch, on any scalar."""
    assert scalar.maximum(a, b) == max(a, b)
    assert scalar.minimum(a, b) == min(a, b)
    assert scalar.maximum(Dual(a), Dual(b)).value == max(a, b)
    assert scalar.minimum(Dual(a), Dual(b)).value == min(a, b)
    assert scalar.where(a < b, "yes", "no") == scalar.where(Dual(a) < Dual(b), "yes", "no")


def test_arrays():
    """Numbers make float arrays, other scalars object arrays, nothing an empty array."""
    assert scalar.array([1.0, 2]).dtype == float
    mixed = scalar.array([1.0, Dual(2.0, 3.0)])
    assert mixed.dtype == object
    np.testing.assert_array_equal(slopes_of(mixed), [0.0, 3.0])
    assert scalar.concatenate([]).shape == (0,)
    np.testing.assert_array_equal(scalar.concatenate(x for x in ([1.0], [2.0, 3.0])), [1.0, 2.0, 3.0])
    assert scalar.concatenate([np.zeros(2), duals([1.0], 1.0)]).dtype == object


NUMBERS = np.array([[-1.5, 0.0, 0.3], [2.0, -0.25, 1e5]])
VOCABULARY = {
    "sin": (scalar.sin, 1),
    "cos": (scalar.cos, 1),
    "sqrt": (scalar.sqrt, 1),
    "exp": (scalar.exp, 1),
    "tanh": (scalar.tanh, 1),
    "arctan2": (scalar.arctan2, 2),
    "clip": (lambda x, y: scalar.clip(x, -0.4, y), 2),
    "reciprocal": (scalar.reciprocal, 1),
    "minimum": (scalar.minimum, 2),
    "maximum": (scalar.maximum, 2),
    "clipped": (lambda x, y: scalar.where(scalar.less(x, y), x, np.multiply(2.0, y)), 2),
    "chosen": (lambda x, y: scalar.where(scalar.less_equal(y, x), x, 0.0), 2),
}
OTHERS = (0.3, np.float64(-0.25), np.array(0.3), np.array([0.0, 0.3, -2.0]), [0.0, 0.3, -2.0], np.array([[0.3], [0.0]]))


@pytest.mark.parametrize("name", VOCABULARY)
@pytest.mark.parametrize("other", OTHERS, ids=str)
def test_entry_by_entry(name, other):
    """On arrays and lists, broadcast as NumPy does it: what a loop over the entries finds, to the bit."""
    function, count = VOCABULARY[name]
    arguments = (NUMBERS, other)[:count]
    found = function(*arguments)
    expected = np.empty(NUMBERS.shape)
    for place, entries in enumerate(zip(*(a.flat for a in np.broadcast_arrays(*arguments)), strict=True)):
        expected.flat[place] = function(*(float(x) for x in entries))
    assert found.dtype == float and found.shape == NUMBERS.shape
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", VOCABULARY)
@pytest.mark.parametrize("other", OTHERS, ids=str)
def test_entry_by_entry_when_traced(name, other):
    """A traced function of arrays computes what it does on floats."""
    function, count = VOCABULARY[name]
    if count == 1:
        program = trace(lambda x: (function(x),), [NUMBERS.shape])
        (found,) = interpret(program, NUMBERS)
        expected = function(NUMBERS)
    else:
        program = trace(lambda x: (function(x, other), function(other, x)), [NUMBERS.shape])
        found = np.array(interpret(program, NUMBERS))
        expected = np.array([function(NUMBERS, other), function(other, NUMBERS)])
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-15)


def test_lists_are_not_compared_as_lists():
    """Python compares lists by their first difference."""
    np.testing.assert_array_equal(scalar.maximum([1.0, 2.0], [0.0, 5.0]), [1.0, 5.0])
    assert scalar.minimum(np.array(2.0), 3.0) == 2.0


def test_the_documented_words():
    """The table of what laws may say has every function of the vocabulary."""
    page = (Path(__file__).parents[2] / "docs" / "how_to" / "rollouts.md").read_text()
    table = page[page.index("| function | arguments") : page.index("If a law does anything else")]
    rows = [row for row in table.splitlines()[2:] if row.startswith("|")]
    told = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    words = {name for name, f in vars(scalar).items() if inspect.isfunction(f) and name[0] != "_"}
    assert told - {"abs"} == words


CHAIN, STATE = two_pandas()
LIMITS = np.linspace(0.2, 2.0, 14)
SAME = {  # NumPy's spelling, and the words'
    "clip": (lambda x: np.clip(x, -LIMITS, LIMITS), lambda x: scalar.clip(x, -LIMITS, LIMITS)),
    "method": (lambda x: x.clip(-1.0, 1.0), lambda x: scalar.clip(x, -1.0, 1.0)),
    "minimum": (lambda x: np.minimum(x, LIMITS), lambda x: scalar.minimum(x, LIMITS)),
    "maximum": (lambda x: np.maximum(LIMITS, x), lambda x: scalar.maximum(LIMITS, x)),
    "where": (lambda x: np.where(x < LIMITS, x, 0.0), lambda x: scalar.where(scalar.less(x, LIMITS), x, 0.0)),
    "not less": (
        lambda x: np.where(x >= LIMITS, 1.0, x),
        lambda x: scalar.where(scalar.less_equal(LIMITS, x), 1.0, x),
    ),
    "parts": (
        lambda x: np.concatenate([np.clip(x[:7], 0.0, 1.0), np.minimum(x[7:].reshape(7, 1), 1.0)[:, 0]]),
        lambda x: np.concatenate([scalar.clip(x[:7], 0.0, 1.0), scalar.minimum(x[7:], 1.0)]),
    ),
}
ENTRIES = {  # what has no word of its own
    "sign": np.sign,
    "hypot": lambda x: np.hypot(x, 0.5),
    "tan": np.tan,
    "degrees": np.radians,
    "largest": lambda x: np.max(np.abs(x)) * x,
    "smallest": lambda x: np.min(x.reshape(2, 7), axis=0)[0] + x,
    "in place": lambda x: _added(x),
    "norm": lambda x: x / scalar.maximum(np.linalg.norm(x), 1.0),
}


def _added(x):
    found = np.zeros(14) + x
    found += 0.5 * x
    return np.clip(found, -1.0, 1.0)


def law(f) -> hf.ControlLaw:
    """Return the law that makes torques of deviations and of a parameter."""
    return hf.ControlLaw(
        lambda t, now, memory, given: (f(given["gain"] * (now.q - STATE.q) - now.qd), memory), parameters={"gain": ()}
    )


@pytest.mark.parametrize("name", SAME)
def test_same_program(name):
    """Instruction by instruction, so that it is the same machine code."""
    in_numpy, in_words = (law_program(law(f), CHAIN) for f in SAME[name])
    assert in_numpy.instructions == in_words.instructions
    assert [x.places for x in in_numpy.outputs] == [x.places for x in in_words.outputs]


@pytest.mark.parametrize("name", [*SAME, *ENTRIES])
def test_same_numbers(name):
    """Those of the function itself, on floats, wherever the state is."""
    f = SAME[name][0] if name in SAME else ENTRIES[name]
    fast = compile_law(law(f).given({"gain": 3.0}), CHAIN)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        state = hf.State(STATE.q + rng.normal(size=14), rng.normal(size=14), STATE.object_pose)
        expected = f(3.0 * (state.q - STATE.q) - state.qd)
        assert fast(0.0, state, None)[0] == pytest.approx(expected, rel=1e-13, abs=1e-14)


def test_words_of_numpy():
    """Every name is one of a function of NumPy."""
    assert all(callable(getattr(np, name)) for name in REPLACEMENTS)


@pytest.mark.parametrize(
    "f", [np.log, np.isfinite, lambda x: x[np.argmax(x)] * x, lambda x: np.linalg.solve(np.eye(14), x)]
)
def test_what_has_no_word(f):
    """It is refused, and the line of the law is named."""
    with pytest.raises(CompileError, match=r"test_scalar\.py:\d+"):
        compile_law(law(f), CHAIN)


def test_floats_and_states():
    """On floats a law gets plain arrays; a state keeps the kind that it is given."""
    seen = []
    watching = hf.ControlLaw(lambda t, now, memory, given: (seen.append(type(now.q)), (now.qd, memory))[1])
    watching(0.0, STATE, None)
    law_program(watching, CHAIN)
    assert seen == [np.ndarray, TracedArray]


@pytest.mark.slow
def test_wrenches_of_a_rollout():
    """External wrenches of the state may be in NumPy's spelling, too: as large as those in the words."""

    def drag(word):
        return lambda t, now: hf.Inputs(object_wrench=word(-30.0 * now.object_twist - 0.1, -1.0, 1.0))

    tau = hf.holding_torques(CHAIN, STATE, internal_force=20.0)
    at = (STATE.q, STATE.qd, STATE.object_pose, STATE.object_twist)
    ends = []
    for word in (np.clip, scalar.clip):
        rollout = hf.compile_rollout(CHAIN, inputs=drag(word))
        ends.append(rollout.step(rollout.start(*at, tau=tau), 1e-3, steps=5).q)
    assert np.array_equal(*ends) and not np.array_equal(ends[0][0], STATE.q)
