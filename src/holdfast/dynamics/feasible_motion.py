"""Whether the wrenches and accelerations that inverse dynamics is given are feasible."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.dynamics.trunk.trunk_inverse import needs_drive, require_no_base_wrench
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

SAME = 1e-9  # largest relative difference between a given wrench and the one that a bushing exerts


def feasibility(chain: ClosedChain) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of the numbers that show whether wrenches and accelerations are feasible.

    They are the wrench that a floating base would need, and beside it the largest wrench on the trunk; and the wrench
    that every bushing exerts on the object, with zeros for other grasps.
    """
    of_base: dict[str, tuple[int, ...]] = {"trunk_base_wrench": (6,), "largest_wrench": ()} if chain.floats else {}
    return of_base | ({"bushing_wrench": (len(chain.arms), 6)} if chain.bushings else {})


def differ(chain: ClosedChain, f: Array, exerted: Array) -> dict[str, Array]:
    """Return by arm whether the wrench given for its bushing is neither zero nor the one that it exerts, (...).

    Args:
        chain: the chain.
        f: (..., arms, 6) given wrenches.
        exerted: (..., arms, 6) exerted wrenches.
    """
    with np.errstate(invalid="ignore"):  # a batch may contain systems that are refused for other reasons
        off, size = (np.abs(x).max(-1) for x in (f - exerted, exerted))
        different = (f != 0.0).any(-1) & (off > SAME * np.maximum(1.0, size))
    return {name: different[..., chain.names.index(name)] for name in chain.bushings}


def require_feasible(chain: ClosedChain, f: Array, found: Mapping[str, Array]) -> None:
    """Refuse wrenches that bushings do not exert, and accelerations for which a floating base would need a drive.

    Args:
        chain: the chain.
        f: (arms, 6) given wrenches.
        found: the arrays of `feasibility`.

    Raises:
        StateError: they are not feasible; the message gives the wrench that is missing.
    """
    if chain.bushings:
        exerted = found["bushing_wrench"]
        for name in [name for name, different in differ(chain, f, exerted).items() if different]:
            i = chain.names.index(name)
            raise StateError(
                f"grasp_wrench: arm '{name}' holds by a bushing, which exerts {checks.place(exerted[i])} in this state,"
                f" got {checks.place(f[i])};"
                " try zeros, which stand for that"
            )
    if chain.floats:
        require_no_base_wrench(found["trunk_base_wrench"], found["largest_wrench"])


def feasible(chain: ClosedChain, given: Mapping[str, Array], found: Mapping[str, Array]) -> dict[str, Array]:
    """Return results without the arrays of `feasibility`; in a batch, those of infeasible systems become NaN.

    Args:
        chain: the chain.
        given: the inputs, with grasp_wrench (arms, 6) or (batch, arms, 6).
        found: results by name, one system's or a batch's, which are overwritten.

    Raises:
        StateError: One system is not feasible: a bushing exerts another wrench, or a floating base would need a drive.
    """
    decided, f = feasibility(chain), given["grasp_wrench"]
    if not decided:
        return dict(found)
    results = {name: x for name, x in found.items() if name not in decided}
    of = {name: found[name] for name in decided}
    if all(of[name].ndim == len(shape) for name, shape in decided.items()):
        require_feasible(chain, f, of)
        return results
    wrong = list(differ(chain, f, of["bushing_wrench"]).values()) if chain.bushings else []
    wrong += [needs_drive(of["trunk_base_wrench"], of["largest_wrench"])] if chain.floats else []
    for x in results.values():
        x[np.logical_or.reduce(wrong)] = np.nan
    return results


def require_holding(chain: ClosedChain, given: Mapping[str, Array]) -> None:
    """Raise a StateError if a grasp_wrench (..., arms, 6) is not zero for an arm that holds nothing."""
    f = given["grasp_wrench"]
    for row, name in enumerate(chain.names):
        if name in chain.grasps:
            continue
        loads = f[..., row, :].reshape(-1, 6)
        loaded = np.flatnonzero((np.isfinite(loads) & (loads != 0.0)).any(1))
        if loaded.size:
            where = f" in system {loaded[0]}" if f.ndim > 2 else ""
            raise StateError(f"grasp_wrench: arm '{name}' holds nothing, expected zeros, got {loads[loaded[0]]}{where}")
