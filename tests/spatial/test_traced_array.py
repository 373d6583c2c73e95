"""A law in NumPy's spelling is the law in the words of `spatial.scalar`: the same code, and the numbers of floats."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiler.errors import CompileError
from holdfast.control import compile_law
from holdfast.control.traced_law import law_program
from holdfast.spatial import scalar
from holdfast.spatial.traced_array import REPLACEMENTS, TracedArray
from tests.control.two_pandas import two_pandas

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
NUMBERS = {  # what has no word of its own
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


@pytest.mark.parametrize("name", [*SAME, *NUMBERS])
def test_same_numbers(name):
    """Those of the function itself, on floats, wherever the state is."""
    f = SAME[name][0] if name in SAME else NUMBERS[name]
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
    with pytest.raises(CompileError, match=r"test_traced_array\.py:\d+"):
        compile_law(law(f), CHAIN)


def test_floats_and_states():
    """On floats a law gets plain arrays; a state keeps the kind that it is given."""
    seen = []
    watching = hf.ControlLaw(lambda t, now, memory, given: (seen.append(type(now.q)), (now.qd, memory))[1])
    watching(0.0, STATE, None)
    law_program(watching, CHAIN)
    assert seen == [np.ndarray, TracedArray]


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
