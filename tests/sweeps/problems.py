"""A small sweep, quick to compute, and its data files."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.sweeps import NearPose, Normal, Sweep, Uniform
from tests.control.two_pandas import two_pandas


@functools.cache
def law() -> hf.ControlLaw:
    """Return the torques that hold the box, and springs in the joints."""
    chain, state = two_pandas()
    hold = hf.holding_torques(chain, state, internal_force=40.0)

    def stay(t: Any, now: hf.State, memory: Any, given: Any) -> tuple[Any, Any]:
        return hold - given["stiffness"] * (now.q - state.q) - 2.0 * now.qd, memory

    return hf.ControlLaw(stay, parameters={"stiffness": ()})


def parameters() -> dict[str, Any]:
    """Return a payload, a push and grasp frames that differ from run to run."""
    frames = np.array([grasp.frame.wxyz_xyz for grasp in two_pandas()[0].grasps.values()])
    push = Normal(0.0, [0.0, 0.0, 0.0, 5.0, 5.0, 5.0])
    near = NearPose(frames, turn=1e-3, shift=1e-3)
    body = {"object_mass": Uniform(2.0, 4.0), "object_inertia": "scale"}
    return {"stiffness": 200.0, "object_wrench": push, "grasp_pose": near, **body}


def small_sweep(store: Path, **options: Any) -> Sweep:
    """Return the sweep of 33 runs of four steps in chunks of five, as asked for besides."""
    chain, state = two_pandas()
    own = {"state": state, "parameters": parameters(), "count": 33, "chunk": 5, "duration": 4e-3, "step": 1e-3}
    return hf.sweep(chain, law(), store=store, **(own | options))


def data(store: Path) -> dict[str, bytes]:
    """Return the data files of a store by name."""
    return {path.name: path.read_bytes() for path in sorted(store.glob("runs_*.parquet"))}
