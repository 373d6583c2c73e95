"""Unstretched bushings, the condition for closing arms whose grasps are bushings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp


def with_slack_bushings(chain: ClosedChain, names: Iterable[str] | None = None) -> ClosedChain:
    """Return the chain with bushings replaced by rigid grasps; in its closed states, the bushings are unstretched.

    Args:
        chain: the chain.
        names: names of the arms; None for all arms with bushings.
    """
    which = set(chain.bushings if names is None else names) & set(chain.bushings)
    if not which:
        return chain
    grasps = {name: Grasp("rigid", grasp.frame) if name in which else grasp for name, grasp in chain.grasps.items()}
    return replace(chain, grasps=grasps)
