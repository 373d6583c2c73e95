"""The other libraries of the benchmark, with advice on how to install those that are missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from benchmarks.bench import mujoco_peer, pinocchio_peer
from benchmarks.bench.entries import Candidate
from benchmarks.bench.systems import System


@dataclass(frozen=True)
class Peer:
    """A library for comparison.

    Attributes:
        name: name of the module.
        package: name of the package to install.
        needs: a function that other packages of this name and old releases lack.
        candidates: function that returns the candidates for a system.
    """

    name: str
    package: str
    needs: str
    candidates: Callable[[System], list[Candidate]]


PEERS = (
    # comes first, because it gives the reference solution
    Peer("pinocchio", "pin", "lcaba", pinocchio_peer.candidates),
    Peer("mujoco", "mujoco-core", "mj_forward", mujoco_peer.candidates),
)


def found() -> dict[str, dict[str, str]]:
    """Return for every peer {"version": ...}, or {"absent": ...} with the reason and advice."""
    return {peer.name: _find(peer) for peer in PEERS}


def _find(peer: Peer) -> dict[str, str]:
    try:
        module = import_module(peer.name)
    except ImportError as error:
        return {"absent": f"{error}; try pip install {peer.package}"}
    if not hasattr(module, peer.needs):
        return {"absent": f"the module '{peer.name}' here has no {peer.needs}; try pip install -U {peer.package}"}
    return {"version": str(module.__version__)}


def candidates(system: System, present: dict[str, dict[str, str]]) -> list[Candidate]:
    """Return the candidates of every installed peer."""
    return [way for peer in PEERS if "version" in present[peer.name] for way in peer.candidates(system)]
