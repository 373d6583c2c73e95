"""The noise of what a calibration sees: joint positions and gaps of closures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial.frozen import Frozen


@called
@dataclass(frozen=True, eq=False)
class ClosureNoise(Frozen):
    """Standard deviations of independent errors in every posture.

    Attributes:
        turn: of each angle of a closed grasp or loop, or of a measured attitude, > 0 [rad].
        shift: of each length of it, or of a measured position, > 0 [m].
        joints: of joint positions, >= 0: one number, or (n,) in the order of q [rad or m].
    """

    turn: float
    shift: float
    joints: Any = 0.0

    def __post_init__(self) -> None:
        for name in ("turn", "shift"):
            object.__setattr__(self, name, checks.number(getattr(self, name), f"closure noise: {name}", above=0.0))
        joints = checks.numbers(np.atleast_1d(self.joints), None, "closure noise: joints")
        for one in joints.ravel().tolist():
            checks.number(one, "closure noise: joints", at_least=0.0)
        object.__setattr__(self, "joints", joints)
