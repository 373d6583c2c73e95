"""Which other libraries are here; one that is not is named with what would bring it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from holdfast.bench import mujoco_peer, pinocchio_peer
from holdfast.bench.entries import Candidate
from holdfast.bench.systems import System


@dataclass(frozen=True)
class Peer:
    """A library to compare with.

    Attributes:
        name: of the module.
        package: what to install.
        needs: a function that neither another package of that name nor too old a release has.
        candidates: its ways to solve a system.
    """

    name: str
    package: str
    needs: str
    candidates: Callable[[System], list[Candidate]]


PEERS = (
    Peer("pinocchio", "pin", "lcaba", pinocchio_peer.candidates),  # first: it supplies the true answers
    Peer("mujoco", "mujoco-core", "mj_forward", mujoco_peer.candidates),
)


def found() -> dict[str, dict[str, str]]:
    """Return {"version": ...} or {"absent": why, and what to try} of every peer."""
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
    """Return every way of every peer that is here."""
    return [way for peer in PEERS if "version" in present[peer.name] for way in peer.candidates(system)]
