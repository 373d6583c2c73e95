"""A run whose controller remembers: numbers of every kind, all of which the torques depend on."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np

from holdfast import ClosedChain, State, simulate
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.io.result_folder import ResultWriter, run_meta
from holdfast.model.joint import UNBOUNDED
from holdfast.simulation.trajectory import Trajectory
from tests.control.two_pandas import two_pandas

DURATION, STEP = 0.024, 0.002  # few enough steps for the readable texts
SCENE = 'name = "remembering"\n'
UNLIMITED = {"position_limits": UNBOUNDED, "rate_limit": np.inf, "effort_limit": np.inf}


@functools.cache
def unlimited() -> tuple[ClosedChain, State]:
    """Return two Pandas without limits: there is nothing to verify inside the steps."""
    chain, state = two_pandas()
    arms = {
        name: replace(arm, joints=tuple(replace(joint, **UNLIMITED) for joint in arm.joints))
        for name, arm in chain.arms.items()
    }
    return replace(chain, arms=arms), state


class Remembering:
    """Gravity compensation, and an integral of all that was; a pure function of its memory."""

    def __init__(self, chain):
        self.holding = GravityCompensation(chain, 10.0, 1.0)

    def __call__(self, t, state: State, memory):
        """Return torques and what to carry on."""
        now = memory or {
            "integral": np.zeros(len(state.q)),
            "last": (0.0, [1, True]),
            "gain": np.float64(1),
            "word": "a",
        }
        gain, word = now.get("gain", np.float64(1)), now.get("word", "a")
        last, (count, odd) = now["last"]
        integral = now["integral"] + (t - last) * state.qd + 1e-3 * np.sin(count) * (1 if odd else -1)
        tau, _ = self.holding(t, state, None)
        tau = tau - gain * integral * (1 + (word == "b"))
        other = "b" if word == "a" else "a"
        return tau, {"integral": integral, "last": (t, [count + 1, not odd]), "gain": gain * 1.01, "word": other}


def run(
    folder: Path,
    resume: bool = False,
    *,
    overwrite: bool = False,
    duration: float = DURATION,
    added=lambda n: None,
    marked=lambda n: None,
) -> Trajectory:
    """Simulate into a folder, or go on with what is there, or replace it.

    After a sample is added, and after its checkpoint is marked, the hooks are called with how many there were.
    """
    chain, state = unlimited()
    meta = run_meta(chain, "remembering", duration, STEP)
    writer = (
        ResultWriter.resume(folder, meta, SCENE) if resume else ResultWriter(folder, meta, SCENE, overwrite=overwrite)
    )
    seen = []

    def add(sample):
        writer.add(sample)
        seen.append(sample)
        added(len(seen))

    def mark(checkpoint):
        writer.mark(checkpoint)
        marked(len(seen))

    try:
        done = simulate(
            chain,
            state,
            Remembering(chain),
            duration,
            STEP,
            start=writer.start,
            on_sample=add,
            on_checkpoint=mark,
        )
    except KeyboardInterrupt:
        writer.finish(None, stopped="interrupted")
        raise
    writer.finish(None, stopped=done.stopped, occurrences=done.occurrences)
    return done


class Died(BaseException):
    """Ends a run on the spot."""


def dies_at(sample):
    """Return a hook that ends the run there."""

    def hook(n):
        if n == sample:
            raise Died

    return hook
