"""MuJoCo's `mj_forward` in its fastest settings: no geoms, no islands, every solver, the stiffest weld it accepts.

MuJoCo is optional and is imported where it is used.
"""

from __future__ import annotations

import functools
from importlib import import_module
from typing import Any
from xml.etree import ElementTree

import numpy as np

from benchmarks.bench.entries import Answers, Candidate, Entry
from benchmarks.bench.systems import System
from holdfast import ClosedChain, State
from holdfast.interop.mjcf_writer import HARDEST, coordinates, document
from holdfast.spatial.scalar import Array

LIBRARY = "mujoco"
SOLVERS = (("Newton", "dense"), ("Newton", "sparse"), ("CG", "sparse"), ("PGS", "dense"))


def candidates(system: System) -> list[Candidate]:
    """Return `mj_forward` with every solver that is the fastest for some system."""
    return [
        Candidate(_name(solver, jacobian), LIBRARY, functools.partial(mj_forward, system, solver, jacobian))
        for solver, jacobian in SOLVERS
    ]


def mj_forward(system: System, solver: str, jacobian: str, truth: Answers | None) -> Entry:
    """Return `mj_forward` with one solver; its accelerations are those of a soft weld."""
    mujoco: Any = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(system.chain, solver, jacobian))
    # there is one island; searching for more costs 5 to 10 %
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
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
    return Entry(_name(solver, jacobian), LIBRARY, sweep, system.states, note, answers=answers)


def _name(solver: str, jacobian: str) -> str:
    return f"mj_forward, {solver} {jacobian}"


FASTEST = {
    "compiler": {"fusestatic": "true"},
    "option/flag": {"limit": "disable"},
}


def mjcf(chain: ClosedChain, solver: str, jacobian: str) -> str:
    """Return the chain as MJCF text, without geoms, so that no collision work is timed."""
    root = document(chain, visuals=False)
    for path, settings in (*FASTEST.items(), ("option", {"solver": solver, "jacobian": jacobian})):
        part = root.find(path)
        assert part is not None
        part.attrib.update(settings)
    return ElementTree.tostring(root, encoding="unicode")


def inputs(system: System) -> list[tuple[Array, Array, Array]]:
    """Return qpos, qvel and qfrc_applied of every state."""
    return [
        (*coordinates(system.chain, State(q, qd, pose, twist)), np.concatenate([tau, np.zeros(6)]))
        for q, qd, tau, pose, twist in zip(*system.arrays, strict=True)
    ]
