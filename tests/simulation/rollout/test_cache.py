"""Steps on disk: the next process neither traces nor compiles those whose law has a key, and only traces the others."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from holdfast import simulate
from holdfast.compiler.composition import Composition
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
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
rollout = compile_rollout(chain, law)
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


def test_next_process(tmp_path):
    """With a key and without one; another list of parameters under the same key is other code."""
    compilations, traces, bits = run(tmp_path, "keyed", "gain")
    assert compilations == traces == 2  # the step, and the slope anew
    assert run(tmp_path, "keyed", "gain") == [0, 0, bits]
    assert run(tmp_path, "keyed", "gain", "offset")[:2] == [2, traces]
    assert run(tmp_path, "", "gain") == [2, traces, bits]
    assert run(tmp_path, "", "gain") == [0, traces, bits]


def test_controllers_of_the_library(monkeypatch, tmp_path):
    """Their numbers are their key: an equal one is not traced again, one with a function of the user's is."""
    monkeypatch.setenv("HOLDFAST_CACHE", str(tmp_path))  # whatever runs before have left
    traces, made = [], Composition.__init__
    monkeypatch.setattr(Composition, "__init__", lambda self: traces.append(1) or made(self))

    def traced(damping: float, path: Callable[[float], Any] | None = None) -> int:
        chain, state = squeezed(("rigid", "rigid"), None)
        hold = RestToRest(state.object_frame).at
        controller = ObjectTracking(chain, path or hold, joint_damping=damping)
        before = len(traces)
        assert simulate(chain, state, controller, 0.05, 1e-3).stopped is None
        return len(traces) - before

    assert [traced(0.123), traced(0.123), traced(0.124)] == [1, 0, 1]
    here = RestToRest(squeezed(("rigid", "rigid"), None)[1].object_frame)
    assert traced(0.123, lambda t: here.at(t)) == 1
