"""Planned and timed paths as parts of laws: machine code asks them, and redundant joints follow a plan."""

import functools
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, PostureControl, compile_law, cooperative_law
from holdfast.errors import ModelError
from holdfast.forces import ForceLimits
from tests.control.kit import CHAIN, DAMPER, HERE, SPRING, STATE
from tests.longer import mostly_long, mostly_slow
from tests.planning.examples import carried

DURATION = 1.0


@functools.cache
def paths():
    """Return the path of the object, a plan for the joints that moves the elbows, and the fastest timing."""
    path = carried(STATE, [0.05, 0.0, 0.1], [0.0, 0.0, 0.2])
    elbows = hf.dynamics.Posture(STATE.q + np.tile(0.4 * np.eye(7)[2], 2))
    plan = hf.follow(CHAIN, STATE, path, duration=DURATION, step=0.1, posture=elbows)
    return path, plan, hf.time_path(CHAIN, STATE, path, ForceLimits(effort=0.8), nodes=9)


@pytest.mark.parametrize("kind", mostly_slow(["planned", "timed"], []))
def test_machine_code_asks_a_path(kind):
    """A law compiled to machine code returns what it returns on floats, before, at, between and after the nodes."""
    path, plan, timed = paths()
    if kind == "timed":
        motion, joints, nodes = ObjectImpedance(timed, SPRING, DAMPER), timed.joints_at, timed.t
    else:
        motion, joints, nodes = ObjectImpedance(path, SPRING, DAMPER), plan, plan.t
    law = cooperative_law(CHAIN, motion, InternalForce(10.0), PostureControl(joints, 5.0))
    compiled = compile_law(law, CHAIN)
    times = [-0.1, 0.0, *nodes[[1, 2, -2]], *(nodes[:3] + 0.3 * nodes[1]), nodes[-1], nodes[-1] + 0.1]
    for t in map(float, times):
        expected, _ = law(t, STATE, None)
        found, _ = compiled(t, STATE, None)
        assert found == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("kind", mostly_long(["planned", "timed"], ("timed",)))
def test_joints_follow_their_path(kind):
    """Started on the path, the joints stay on it up to the scheme's error; otherwise the elbows stay behind.

    A timed path accelerates by leaps, at which steps end.
    """
    path, plan, timed = paths()
    if kind == "timed":
        along, joints, start, end = timed, timed.joints_at, timed.state_at(0.0), timed.joints_at(timed.duration)[0]
    else:
        along, joints, start, end = path, plan, plan.state_at(0.0), plan.q[-1]
    until, off = timed.duration if kind == "timed" else DURATION, {}
    for rest in (joints, None):
        law = cooperative_law(CHAIN, ObjectImpedance(along, SPRING, DAMPER), posture=PostureControl(rest, 5.0))
        off[rest is None] = np.abs(hf.simulate(CHAIN, start, law, until, until / 200).q[-1] - end).max()
    assert off[False] < 1e-6
    assert kind == "timed" or off[True] > 0.02


@pytest.mark.slow
def test_refused_paths():
    """A path of the object is none of joints; other numbers of joints are named."""
    path, _, timed = paths()
    motion = ObjectImpedance(HERE, 100.0, 20.0)
    wrong: Any
    for wrong, said in (
        (path, "one of the object; try a plan of `hf.follow`"),
        (timed, "`joints_at` of a timed path"),
        (lambda t: (np.zeros(3),) * 3, "shape"),
        (lambda t: t, "positions, rates and accelerations"),
    ):
        with pytest.raises(ModelError, match="posture: rest") as error:
            cooperative_law(CHAIN, motion, posture=PostureControl(wrong))
        assert said in str(error.value)
