"""A closed chain as a MuJoCo model at its fastest: no geoms, no limits, bodies that stand still taken out.

MuJoCo is imported where it is used: it is optional.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from holdfast.bench.systems import System
from holdfast.interop.mjcf_writer import coordinates, document
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State

FASTEST = {
    "compiler": {"fusestatic": "true"},
    "option/flag": {"limit": "disable"},
}


def mjcf(chain: ClosedChain, solver: str, jacobian: str) -> str:
    """Return the chain as MJCF text, without geoms, so that no collision work is timed."""
    root = document(chain, looks=False)
    for path, settings in (*FASTEST.items(), ("option", {"solver": solver, "jacobian": jacobian})):
        part = root.find(path)
        assert part is not None
        part.attrib.update(settings)
    return ElementTree.tostring(root, encoding="unicode")


def inputs(system: System) -> list[tuple[Array, Array, Array]]:
    """Return qpos, qvel and qfrc_applied of every state."""
    return [
        (*coordinates(State(q, qd, pose, twist)), np.concatenate([tau, np.zeros(6)]))
        for q, qd, tau, pose, twist in zip(*system.arrays, strict=True)
    ]
