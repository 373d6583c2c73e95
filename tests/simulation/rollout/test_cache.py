"""Steps on disk: the next process neither traces nor compiles those whose law has a key, and only traces the others."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.simulation.rollout.compiled_steppers import law_of
from tests.simulation.gantries import squeezed

ROOT = Path(__file__).parents[3]

SCRIPT = """
import json, sys
import numpy as np
from holdfast import ControlLaw, compile_rollout
from holdfast.compiler import composition
from holdfast.compiler.targets import cpu
from tests.simulation.gantries import squeezed

compilations, traces = [], []
compiled, made = cpu._compiled, composition.Composition.__init__
cpu._compiled = lambda *given: compilations.append(1) or compiled(*given)
composition.Composition.__init__ = lambda self: traces.append(1) or made(self)

chain, state = squeezed(("rigid", None), None)
key, *names = sys.argv[1:]
law = ControlLaw(
    lambda t, x, m, given: (sum(given[name][()] for name in names) * np.ones(6), m + np.array([1.0])),
    np.zeros(1), dict.fromkeys(names, ()), key,
)
rollout = compile_rollout(chain, law, scheme="midpoint")
given = {name: k + 1.0 for k, name in enumerate(names)}
systems = rollout.start(state.q, state.qd, state.object_pose, state.object_twist, **given)
rollout.step(systems, 1e-2, steps=3, **given)
rollout.step(systems, 1e-2, **{name: 2.0 * np.asarray(x) for name, x in given.items()})
bits = np.concatenate([np.ravel(x) for x in systems.arrays.values()]).tobytes().hex()
print(json.dumps([len(compilations), len(traces), bits]))
"""


def run(cache: Path, key: str, *names: str) -> list:
    """Return compilations, traces and the bits of a rollout, by a new process."""
    env = os.environ | {"HOLDFAST_CACHE": str(cache), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", SCRIPT, key, *names]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_next_process(tmp_path):
    """With a key and without one; another list of parameters under the same key is other code."""
    compilations, traces, bits = run(tmp_path, "keyed", "gain")
    assert compilations == traces == 2  # the step, and the slope anew
    assert run(tmp_path, "keyed", "gain") == [0, 0, bits]
    assert run(tmp_path, "keyed", "gain", "offset")[:2] == [2, traces]
    assert run(tmp_path, "", "gain") == [2, traces, bits]
    assert run(tmp_path, "", "gain") == [0, traces, bits]


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
