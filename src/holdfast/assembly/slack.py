"""Where bushings are slack: what arms that hold by them are brought to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp


def with_slack_bushings(chain: ClosedChain, names: Iterable[str] | None = None) -> ClosedChain:
    """Return the chain with rigid grasps in the place of bushings: where these are closed, bushings are slack.

    Args:
        chain: the chain.
        names: of the arms; None: all that hold by a bushing.
    """
    which = set(chain.bushings if names is None else names) & set(chain.bushings)
    if not which:
        return chain
    grasps = {name: Grasp("rigid", grasp.frame) if name in which else grasp for name, grasp in chain.grasps.items()}
    return replace(chain, grasps=grasps)
