"""What is believed about a machine before its recordings are looked at: how uncertain the model's values are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

RELATIVE = ("payload", "links")


@called
@dataclass(frozen=True, eq=False)
class Prior(Frozen):
    """Standard deviations of the unknowns of a machine about the model's values.

    Those of bodies are of their log-Cholesky coordinates, which have no units: 0.1 is about a tenth of masses and
    extents. Others are one number, or one for each joint or sensor. None stands for a wide one, with the largest torque
    T of the joint (its effort limit, or else the largest one that was measured): T / 10 for offsets and friction,
    T / 10 per rad/s or m/s for damping, T / 20 per rad/s^2 or m/s^2 for armature; for sensors a tenth of the largest
    reading, 0.3 for scales, 0.02 s for time offsets, and for gains the ratio
    of the model's torques to the currents.

    Attributes:
        payload: of the object, relative.
        links: of each link, relative.
        armature: [kg m^2 or kg].
        damping: [N m s/rad or N s/m].
        friction: Coulomb friction [N m or N].
        friction_offset: [N m or N].
        friction_asymmetry: [N m or N].
        drive_gain: [N m/A or N/A].
        sensor_offset: [N m, N].
        sensor_scale: as a fraction.
        sensor_drift: [N m/s, N/s].
        time_offset: [s].
    """

    payload: float = 2.0
    links: float = 0.2
    armature: ArrayLike | None = None
    damping: ArrayLike | None = None
    friction: ArrayLike | None = None
    friction_offset: ArrayLike | None = None
    friction_asymmetry: ArrayLike | None = None
    drive_gain: ArrayLike | None = None
    sensor_offset: ArrayLike | None = None
    sensor_scale: ArrayLike | None = None
    sensor_drift: ArrayLike | None = None
    time_offset: ArrayLike | None = None

    def __post_init__(self) -> None:
        for name, value in tuple(vars(self).items()):
            if name in RELATIVE:
                object.__setattr__(self, name, checks.number(value, f"prior: {name}", above=0.0))
            elif value is not None:
                given = checks.numbers(value, None, f"prior: {name}")
                if not (given > 0.0).all():
                    raise ModelError(f"prior: {name}: expected standard deviations > 0, got {given.min():g}")
                object.__setattr__(self, name, given)

    def deviations(self, name: str, usual: Array) -> Array:
        """Return the standard deviations of a kind of unknowns, with the usual ones where none are given."""
        given: Any = getattr(self, name)
        if given is None:
            return usual
        if np.shape(given) not in ((), usual.shape):
            raise ModelError(f"prior: {name}: expected one number or {len(usual)}, got shape {np.shape(given)}")
        return np.broadcast_to(given, usual.shape).astype(float)
