"""Why a run ended where a step failed: at a singular configuration no shorter step helps, so it is named instead."""

from __future__ import annotations

from holdfast.dynamics.near_singular import nearly_lost
from holdfast.errors import HoldfastError
from holdfast.simulation.instant import Instant


def reason(cause: HoldfastError, last: Instant) -> str:
    """Return why a step failed, in words, with the directions that are nearly lost at the last sample.

    Args:
        cause: what the step raised.
        last: the chain at the last accepted instant.
    """
    lost = nearly_lost(last.chain, last.state)
    if not lost:
        return str(cause)
    what = str(cause).partition("; try ")[0]
    return (
        f"{what}. The last configuration is nearly singular, where joint rates and forces grow without bound:"
        f" {'; '.join(lost)}. Try a motion that keeps away from it; a smaller time step does not help"
    )
