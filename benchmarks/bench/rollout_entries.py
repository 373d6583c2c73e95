"""Entries that take time steps of many systems: rollouts of this library, and MuJoCo's `mj_step`."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

import holdfast
from benchmarks.bench.entries import LIBRARY, Timed
from benchmarks.bench.mujoco_peer import inputs, mjcf
from benchmarks.bench.systems import System

STEP = 1e-3  # s
STEPS = 20  # steps from each state under constant torques, before the states are reset
SCHEMES = ("rk4", "midpoint")
DEFAULT_IMPEDANCE = (0.9, 0.95, 0.001, 0.5, 2.0)  # the default of MuJoCo
# Integrator and impedance of the welds; Newton's dense solver is the fastest at this size.
MUJOCO = (("Euler", "hardest"), ("Euler", "default"), ("implicitfast", "hardest"), ("RK4", "hardest"))


@dataclass(frozen=True, eq=False)
class Stepping:
    """An entry that takes time steps.

    Attributes:
        entry: the entry to time; an evaluation is one step of one system.
        gap: function that returns the largest gap of any grasp at the end [m or rad].
    """

    entry: Timed
    gap: Callable[[], float]


def rollout(system: System, scheme: str, size: int) -> Stepping:
    """Return a batch that is stepped by one call on one thread under constant torques."""
    made = _compiled(system, scheme)
    q, qd, tau, pose, twist = system.repeated(size).arrays
    initial = made.start(q, qd, pose, twist, tau=tau)

    def stepped() -> Any:
        return made.step(initial.copy(), STEP, steps=STEPS, tau=tau, threads=1)

    name, note = f"{scheme}, {size:,} systems", "states copied in each time"
    entry = Timed(name, LIBRARY, stepped, size * STEPS, note)
    return Stepping(entry, lambda: float(stepped().gap[:, 0].max()))


@functools.lru_cache(maxsize=len(SCHEMES))
def _compiled(system: System, scheme: str) -> Any:
    return holdfast.compile_rollout(system.chain, scheme=scheme)


def mj_step(system: System, integrator: str, welds: str) -> Stepping:
    """Return `mj_step` from one state after the other, all steps of a state in one call.

    Args:
        system: the system.
        integrator: "Euler", "implicitfast" or "RK4".
        welds: "hardest", or "default" for MuJoCo's default impedance.
    """
    mujoco: Any = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(system.chain, "Newton", "dense"))
    if welds == "default":
        model.eq_solimp[:] = DEFAULT_IMPEDANCE
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    model.opt.timestep = STEP
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    data, rows = mujoco.MjData(model), inputs(system)

    def steps(q: Any, v: Any, tau: Any) -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[...] = q
        data.qvel[...] = v
        data.qfrc_applied[...] = tau
        mujoco.mj_step(model, data, STEPS)

    def sweep() -> None:
        for row in rows:
            steps(*row)

    def gap() -> float:
        gaps = []
        for row in rows:
            steps(*row)
            mujoco.mj_forward(model, data)
            gaps.append(float(np.abs(data.efc_pos).max()))
        return max(gaps)

    name, note = f"mj_step, {integrator}, {welds} welds", "Newton, dense; no geoms, islands off"
    return Stepping(Timed(name, "mujoco", sweep, system.states * STEPS, note), gap)
