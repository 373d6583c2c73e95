"""What a run does when a margin becomes negative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.simulation.limits import Signals
from holdfast.spatial.scalar import Array

OnSlip = Literal["stop", "record", "release"]
OnLimit = Literal["record", "stop"]


@dataclass(frozen=True)
class Policy:
    """What is done about violations.

    Attributes:
        on_slip: about a grasp that cannot hold: "stop" the run there; "record" it and go on as if it
            held; "release" it: the grasp opens and the arm goes on free.
        on_limit: about a joint beyond a limit: "record" or "stop".
    """

    on_slip: OnSlip = "stop"
    on_limit: OnLimit = "record"

    def __post_init__(self) -> None:
        for name, known in (("on_slip", get_args(OnSlip)), ("on_limit", get_args(OnLimit))):
            given = getattr(self, name)
            if given not in known:
                raise ModelError(
                    f"simulation: {name}: expected one of {', '.join(known)}, got {given!r}."
                    + checks.did_you_mean(str(given), known)
                )

    def acting(self, signals: Signals) -> Array:
        """Return which limited signals end the step where they become negative, as indices."""
        acts = {"grasp": self.on_slip != "record"}
        return np.array(
            [i for i in signals.limited if acts.get(signals.quantities[i], self.on_limit == "stop")], dtype=int
        )
