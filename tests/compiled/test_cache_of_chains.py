"""Machine code on disk: found by the next process without tracing, unless a law has no key; rebuilt when damaged."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.control.traced_law import law_of
from tests.simulation.gantries import squeezed

ROOT = Path(__file__).parents[2]
COUNTED = """
import json, sys
import numpy as np
import holdfast
from holdfast.compiler import composition
from holdfast.compiler.targets import cpu

compilations, traces = [], []
compiled, made = cpu._compiled, composition.Composition.__init__
cpu._compiled = lambda *given: compilations.append(1) or compiled(*given)
composition.Composition.__init__ = lambda self: traces.append(1) or made(self)
"""

# Answers of a small chain in every way there is, as bits.
CHAIN = """
from tests.compiled.problems import chain_of, numbers, one, outputs

chain = chain_of(((2, "ball"), (3, "softfinger")))
given = numbers(chain, 5)
fast = holdfast.compile(chain)
single = fast.forward_dynamics(**one(given, 0))
fast.forward_dynamics(*one(given, 0).values(), out=single)
arrays = [x for result in (single, fast.forward_dynamics(**given)) for x in outputs(result)]
"""

# A rollout under a law with the key and the parameters that are given.
ROLLOUT = """
from tests.simulation.gantries import squeezed

chain, state = squeezed(("rigid", None), None)
key, *names = sys.argv[1:]
law = holdfast.ControlLaw(
    lambda t, x, m, given: (sum(given[name][()] for name in names) * np.ones(6), m + np.array([1.0])),
    np.zeros(1), dict.fromkeys(names, ()), key,
)
rollout = holdfast.compile_rollout(chain, law, scheme="midpoint")
given = {name: k + 1.0 for k, name in enumerate(names)}
systems = rollout.start(state.q, state.qd, state.object_pose, state.object_twist, **given)
rollout.step(systems, 1e-2, steps=3, **given)
rollout.step(systems, 1e-2, **{name: 2.0 * np.asarray(x) for name, x in given.items()})
arrays = systems.arrays.values()
"""

BITS = """
bits = np.concatenate([np.ravel(x) for x in arrays]).tobytes().hex()
print(json.dumps([len(compilations), len(traces), bits]))
"""


def run(script: str, cache: Path, *arguments: str) -> list:
    """Return compilations, traces and the answers' bits, by a new process."""
    env = os.environ | {"HOLDFAST_CACHE": str(cache), "PYTHONPATH": os.pathsep.join(map(str, (ROOT / "src", ROOT)))}
    command = [sys.executable, "-c", COUNTED + script + BITS, *arguments]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_next_process(tmp_path):
    """Nothing is traced or compiled the second time; a damaged entry is made again, and only that one."""
    cache = tmp_path / "cache"
    compilations, traces, bits = run(CHAIN, cache)
    entries = sorted(cache.iterdir())
    assert compilations == len(entries) == 4 and traces == 1  # single, batch, and two builtins
    assert run(CHAIN, cache) == [0, 0, bits]
    whole = {path: path.read_bytes() for path in entries}
    random = np.random.default_rng(0)
    for path in entries:
        damaged = bytearray(whole[path])
        damaged[int(random.integers(len(damaged)))] ^= 16
        path.write_bytes(damaged)
    compilations, _, again = run(CHAIN, cache)
    assert compilations == 4 and again == bits
    assert {path: path.read_bytes() for path in cache.iterdir()} == whole
    entries[0].write_bytes(whole[entries[0]][:100])
    entries[1].unlink()
    compilations, _, again = run(CHAIN, cache)
    assert compilations == 2 and again == bits


@pytest.mark.slow
def test_off(tmp_path):
    """HOLDFAST_CACHE=off compiles each time."""
    compilations, traces, _ = run(CHAIN, Path("off"))
    assert compilations == 4 and traces == 1
    assert not Path("off").exists()


@pytest.mark.slow
def test_next_process_of_a_rollout(tmp_path):
    """With a key or known by its program; another list of parameters under the same key is other code."""
    compilations, traces, bits = run(ROLLOUT, tmp_path, "keyed", "gain")
    assert compilations == traces == 2  # the step, and the slope anew
    assert run(ROLLOUT, tmp_path, "keyed", "gain") == [0, 0, bits]
    assert run(ROLLOUT, tmp_path, "keyed", "gain", "offset")[:2] == [2, traces]
    assert run(ROLLOUT, tmp_path, "", "gain") == [2, traces, bits]
    assert run(ROLLOUT, tmp_path, "", "gain") == [0, 0, bits]


def test_controllers_of_the_library():
    """Their numbers are their key: equal ones share machine code, and a function of the user's stands for none."""
    chain, state = squeezed(("rigid", "rigid"), None)
    hold = RestToRest(state.object_frame)

    def key(damping: float, path: Callable[[float], Any]) -> str:
        law = law_of(ObjectTracking(chain, path, joint_damping=damping), chain)
        assert law is not None
        return law.key

    assert key(0.123, hold.at) == key(0.123, RestToRest(state.object_frame).at) != key(0.124, hold.at)
    assert key(0.123, lambda t: hold.at(t)) == "" != key(0.123, hold.at)
