"""The proof that limits conflict, by multipliers, and in words.

If h - G x in K has no solution, there are multipliers z in K with G'z = 0 and h'z < 0. Those of the least violation
v* = min {v: h - G x + B v in K} have B'z = 1, so that each limit takes part by a share, and -h'z = v*.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

MENTIONED_SHARE = 0.05  # smaller shares are not mentioned
MOST_PRICES = 4


@dataclass(frozen=True, eq=False)
class Certificate(Frozen):
    """Multipliers z in K with G'z = 0 and h'z < 0, which prove that limits cannot be kept together.

    Attributes:
        multipliers: by limit in words, its part of z, one number or those of a cone, for limits in units of F0 times
            the weight with which they give way.
        shares: by limit in words, how much it takes part, in falling order; they add up to 1.
        lack: by how much all these limits would have to give way at once, -h'z = v* [N].
        residual: largest entry of G'z, in newtons per unit of the unknowns, which is 0 but for rounding.
    """

    multipliers: Mapping[str, Array]
    shares: Mapping[str, float]
    lack: float
    residual: float

    @property
    def words(self) -> str:
        """The limits that conflict, with their shares, in a sentence."""
        large = sum(share >= MENTIONED_SHARE for share in self.shares.values())
        listed = [f"{name} ({share:.0%})" for name, share in self.shares.items()][: large or MOST_PRICES]
        if len(listed) == 1:
            return f"{listed[0]} is not enough: it lacks {self.lack:.3g} N"
        if not large and len(self.shares) > len(listed):
            listed.append(f"{len(self.shares) - len(listed)} more")
        return f"{', '.join(listed[:-1])} and {listed[-1]} conflict: together they lack {self.lack:.3g} N"


def certificate(words: Sequence[str], parts: Sequence[Array], lack: float, residual: float) -> Certificate:
    """Return the certificate of multipliers, limit by limit; limits without a share are left out."""
    size = sum(float(part[0]) for part in parts)
    found = sorted(zip(words, parts, strict=True), key=lambda pair: -pair[1][0])
    found = [(name, part) for name, part in found if np.abs(part).max() > 1e-9 * size]
    return Certificate(
        dict(found), {name: float(part[0]) / size for name, part in found if part[0] > 1e-6 * size}, lack, residual
    )


def kept(prices: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return words for limits that are kept: which of them cost most."""
    costly = sorted(((price, name) for name, price in prices.items() if price > 0.0), reverse=True)
    if not costly:
        return "all limits are kept, and none of them costs anything"
    listed = ", ".join(f"{name} ({price:.2g} per {units[name]})" for price, name in costly[:MOST_PRICES])
    return f"all limits are kept; those that cost most: {listed}"
