"""Every law of the kit is one text: as machine code, bound, in batches, rollouts, sampled, and in C."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import holdfast as hf
from holdfast.codegen.export import files_of
from holdfast.codegen.functions import exported_law
from holdfast.compiler.targets import OBJECT_TARGETS
from holdfast.control import compile_law, sampled
from tests.codegen.exported import built, outputs, require
from tests.compiler.programs import same_bits
from tests.control.kit import CHAIN, LAWS, STATE, N, moving
from tests.longer import mostly_long, mostly_slow

laws = pytest.mark.parametrize("name", LAWS)
# as `test_machine_code` compares every law, most are run and compiled from C by `make acceptance` only
some_laws = pytest.mark.parametrize("name", mostly_long(LAWS, ("impedance", "hybrid, limits", "observer", "ramp")))


def remembered(law, seed):
    """Return some memory of a law, as if it had run."""
    return law.memory + 0.1 * np.random.default_rng(seed).normal(size=law.memory.shape)


@pytest.mark.parametrize("name", mostly_slow(LAWS, ("impedance", "hybrid, limits")))
def test_machine_code(name):
    """Called, bound and in a batch: the torques and the memory of the text; the three have the same bits."""
    law, given = LAWS[name]
    fast, states = compile_law(law, CHAIN), [moving(seed) for seed in range(5)]
    fields = [np.array([getattr(x, field) for x in states]) for field in ("q", "qd", "object_pose", "object_twist")]
    memory = np.array([remembered(law, seed) for seed in range(5)])
    every_time = np.linspace(0.0, 1.2, 5)
    every = fast.torques(every_time, *fields, memory=memory if memory.size else None, **given)
    bound = fast.bind(**given)
    for k, state in enumerate(states):
        tau, kept = law.given(given).on_floats(every_time[k], state, memory[k])
        np.testing.assert_allclose(every.tau[k], tau, rtol=0.0, atol=1e-10 * np.abs(tau).max())
        np.testing.assert_allclose(every.memory[k], kept, rtol=0.0, atol=1e-9 * max(1.0, np.abs(kept).max(initial=0.0)))
        bound.t[...], bound.q[...], bound.qd[...] = every_time[k], state.q, state.qd
        bound.object_pose[...], bound.object_twist[...] = state.object_pose, state.object_twist
        if memory.size:
            bound.memory[...] = memory[k]
        one = fast.torques(every_time[k], *(x[k] for x in fields), memory=memory[k] if memory.size else None, **given)
        assert same_bits(bound(), one.tau) and same_bits(one.tau, every.tau[k])
    times = fast.torques(
        np.array([0.9]), *(x[3:4] for x in fields), memory=memory[3:4] if memory.size else None, **given
    )
    assert same_bits(times.tau[0], every.tau[3]) and same_bits(times.memory[0], every.memory[3])


@some_laws
@pytest.mark.slow
def test_rollouts_are_runs(name):
    """A rollout and `simulate` move the arms alike, with the law asked all along and once per sample."""
    for wrap in (lambda law: law, lambda law: sampled(law, CHAIN, sample_time=2e-3, delay=1e-3)):
        law, given = wrap(LAWS[name][0]), LAWS[name][1]
        rollout = hf.compile_rollout(CHAIN, law)
        start = moving(3)
        arrays = [x[None] for x in (start.q, start.qd, start.object_pose, start.object_twist)]
        record = rollout.run(rollout.start(*arrays, **given), 0.01, 1e-3, record=["q", "tau"])
        run = hf.simulate(CHAIN, start, law, 0.01, 1e-3, parameters=given)
        np.testing.assert_allclose(record.systems.q[0], run.q[-1], rtol=0.0, atol=1e-11)


@laws
def test_is_known(name):
    """Its machine code is found again on disk by a key, and it goes to other processes."""
    law, given = LAWS[name]
    again = pickle.loads(pickle.dumps(law))
    assert law.key and again.key == law.key
    for one in (law, again):
        tau = one.given(given)(0.2, STATE, None)[0]
        assert same_bits(tau, law.given(given)(0.2, STATE, None)[0])


@pytest.mark.slow
@some_laws
def test_in_c(name, tmp_path):
    """C source computes the same bits."""
    require("gcc")
    law, given = LAWS[name]
    fast = compile_law(law, CHAIN)
    function = exported_law("law", law, hf.compile(CHAIN))
    made = files_of("part", [function], OBJECT_TARGETS["x86-64-v3"], source=True)
    for file, content in made.files.items():
        (tmp_path / file).write_bytes(content)
    program = built(tmp_path, "part", made.functions, "gcc", "x86-64-v3", "-march=x86-64-v3")
    asked, expected = [], []
    for seed in range(4):
        x, memory = moving(seed), remembered(law, seed)
        arrays = {"q": x.q, "qd": x.qd, "object_pose": x.object_pose, "object_twist": x.object_twist}
        asked.append({"t": np.array(0.2 * seed), **arrays, **given} | ({"memory": memory} if memory.size else {}))
        expected.append(fast.torques(0.2 * seed, *arrays.values(), memory=memory if memory.size else None, **given))
    for found, truth in zip(outputs(program, [function], {"law": asked})["law"], expected, strict=True):
        assert same_bits(found["tau"], truth.tau)
        assert same_bits(found.get("kept", np.zeros(0)), truth.memory)


def test_every_law_drives_every_joint():
    """No law of the table is a stub that returns zeros."""
    for law, given in LAWS.values():
        assert (np.abs(law.given(given)(0.5, moving(1), None)[0]) > 0.0).sum() == N
