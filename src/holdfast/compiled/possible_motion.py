"""Whether what compiled inverse dynamics is given is possible, by the rules of the reference."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.dynamics.possible_motion import deciding, differ, require_possible
from holdfast.dynamics.trunk.trunk_inverse import needs_drive
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array


def possible(chain: ClosedChain, f: Array, found: Mapping[str, Array]) -> dict[str, Array]:
    """Return results without the numbers of `deciding`; in a batch, those of impossible systems become NaN.

    Args:
        chain: the chain.
        f: (arms, 6) or (batch, arms, 6) given grasp wrenches.
        found: results by name, one system's or a batch's, which are overwritten.

    Raises:
        StateError: One system is not possible: a bushing exerts another wrench, or a floating base would need a drive.
    """
    decided = deciding(chain)
    if not decided:
        return dict(found)
    results = {name: x for name, x in found.items() if name not in decided}
    of = {name: found[name] for name in decided}
    if all(of[name].ndim == len(shape) for name, shape in decided.items()):
        require_possible(chain, f, of)
        return results
    wrong = list(differ(chain, f, of["bushing_wrench"]).values()) if chain.bushings else []
    wrong += [needs_drive(of["trunk_base_wrench"], of["largest_wrench"])] if chain.floats else []
    for x in results.values():
        x[np.logical_or.reduce(wrong)] = np.nan
    return results
