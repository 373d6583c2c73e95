"""Why a run ended where a step failed: at a singular configuration that is the cause, and its directions are named."""

from __future__ import annotations

from holdfast.dynamics.near_singular import NEAR, nearly_lost
from holdfast.errors import HoldfastError
from holdfast.simulation.instant import Instant

SINGULAR = 0.01  # strength: below it a singular configuration is taken for the cause, above it for a possible one


def reason(cause: HoldfastError, last: Instant) -> str:
    """Return why a step failed, in words, with the directions that are nearly lost at the last sample.

    Args:
        cause: what the step raised.
        last: the chain at the last accepted instant.
    """
    lost = nearly_lost(last.chain, last.state, SINGULAR)
    if lost:
        what = str(cause).partition("; try ")[0]
        return (
            f"{what}. The last configuration is nearly singular, where joint rates and forces grow without bound:"
            f" {'; '.join(lost)}. Try a motion that keeps away from it"
        )
    near = nearly_lost(last.chain, last.state, NEAR)
    return f"{cause}. The last configuration is also near a singular one: {'; '.join(near)}" if near else str(cause)
