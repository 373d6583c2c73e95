"""Whether the wrenches and accelerations that inverse dynamics is given are possible."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.dynamics.trunk.trunk_inverse import require_undriven
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

SAME = 1e-9  # largest relative difference between a given wrench and the one that a bushing exerts


def deciding(chain: ClosedChain) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of the numbers that show whether wrenches and accelerations are possible.

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


def require_possible(chain: ClosedChain, f: Array, found: Mapping[str, Array]) -> None:
    """Refuse wrenches that bushings do not exert, and accelerations for which a floating base would need a drive.

    Args:
        chain: the chain.
        f: (arms, 6) given wrenches.
        found: the numbers of `deciding`.

    Raises:
        StateError: they are not possible; the message gives the wrench that is missing.
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
        require_undriven(found["trunk_base_wrench"], found["largest_wrench"])
