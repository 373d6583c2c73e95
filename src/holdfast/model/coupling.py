"""Couplings of a chain's joints: mimic joints, gears, and locked joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, FrozenDict


@called
@dataclass(frozen=True, eq=False)
class Coupling(Frozen):
    """A linear relation between joints of a chain, sum c q = offset.

        Coupling({"left/finger1": 1.0, "left/finger2": -1.0})      two fingers that move alike
        Coupling({"left/knuckle": 0.7, "left/pad": -1.0}, -0.1)    pad = 0.7 knuckle + 0.1, a mimic joint of URDF

    Its force lambda acts on each joint with c lambda, so that the drive of one of them moves all. With a single joint
    it locks this joint.

    Attributes:
        terms: coefficients c by joint, "arm/joint" or "trunk/joint" as in `ClosedChain.joint_names`; none is zero.
        offset: sum c q [rad or m]; None if only the rates are coupled, sum c qd = 0.
    """

    terms: Mapping[str, float]
    offset: float | None = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.terms, Mapping) or not self.terms:
            raise ModelError(f"coupling: expected coefficients by joint, got {checks.short(self.terms)}")
        terms = {}
        for name, given in self.terms.items():
            checks.name(name, "coupling: name of a joint")
            terms[name] = checks.number(given, f"coupling: coefficient of '{name}'")
            if terms[name] == 0.0:
                raise ModelError(f"coupling: coefficient of '{name}': expected another number than 0")
        object.__setattr__(self, "terms", FrozenDict(terms))
        if self.offset is not None:
            object.__setattr__(self, "offset", checks.number(self.offset, "coupling: offset"))


def checked_couplings(given: Any, what: str) -> tuple[Coupling, ...]:
    """Return couplings as a tuple.

    Raises:
        ModelError: they are no list of couplings.
    """
    if not isinstance(given, Sequence) or not all(isinstance(one, Coupling) for one in given):
        raise ModelError(f"{what}: couplings: expected a list of Coupling, got {checks.short(given)}")
    return tuple(given)
