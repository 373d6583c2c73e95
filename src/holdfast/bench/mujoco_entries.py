"""MuJoCo's `mj_forward` at its best: no geoms, islands off, every solver, the hardest weld it accepts."""

from __future__ import annotations

import functools

import numpy as np

from holdfast.bench import library
from holdfast.bench.entry import Answers, Candidate, Entry
from holdfast.bench.mujoco_model import inputs, mjcf
from holdfast.bench.systems import System
from holdfast.interop.mjcf_writer import HARDEST

LIBRARY = "mujoco"
SOLVERS = (("Newton", "dense"), ("Newton", "sparse"), ("CG", "sparse"), ("PGS", "dense"))


def candidates(system: System) -> list[Candidate]:
    """Return `mj_forward` with every solver that is the fastest somewhere."""
    return [
        Candidate(_name(solver, jacobian), LIBRARY, functools.partial(mj_forward, system, solver, jacobian))
        for solver, jacobian in SOLVERS
    ]


def mj_forward(system: System, solver: str, jacobian: str, truth: Answers | None) -> Entry:
    """Return `mj_forward` with one solver, its accelerations those of a soft weld."""
    mujoco = library.mujoco()

    model = mujoco.MjModel.from_xml_string(mjcf(system.chain, solver, jacobian))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND  # one island: looking for more costs 5 to 10 %
    data = mujoco.MjData(model)
    qpos, qvel, applied, qacc = data.qpos, data.qvel, data.qfrc_applied, data.qacc
    forward, rows, n = mujoco.mj_forward, inputs(system), system.chain.joint_count

    def sweep() -> None:
        for q, v, tau in rows:
            qpos[...] = q
            qvel[...] = v
            applied[...] = tau
            forward(model, data)

    def answers() -> Answers:
        found = []
        for q, v, tau in rows:
            qpos[...], qvel[...], applied[...] = q, v, tau
            forward(model, data)
            found.append(qacc[:n].copy())
        return Answers(np.array(found))

    note = f"weld of impedance {HARDEST}, its hardest; no grasp wrenches compared"
    return Entry(_name(solver, jacobian), LIBRARY, sweep, system.states, answers, note)


def _name(solver: str, jacobian: str) -> str:
    return f"mj_forward, {solver} {jacobian}"
