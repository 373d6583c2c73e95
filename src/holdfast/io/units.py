"""Units of recorded columns, as they are written in titles and scenes, and their factors to SI units."""

from __future__ import annotations

import math
import re

from holdfast.errors import ResultError
from holdfast.model import checks

TURN = 2.0 * math.pi
POUND, KILOGRAM = 4.4482216152605, 9.80665  # N: weights of masses of one pound and one kilogram (CGPM 1901)
# by SI unit, the factors by which readings in other units are multiplied
FACTORS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": TURN / 360.0, "rev": TURN},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "rad/s": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": TURN / 360.0, "rev/s": TURN, "rpm": TURN / 60.0},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "N m": {"Nm": 1.0, "mNm": 1e-3, "kNm": 1e3, "Ncm": 1e-2, "Nmm": 1e-3, "kgfm": KILOGRAM, "lbfft": 0.3048 * POUND},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": KILOGRAM, "lbf": POUND},
    "A": {"A": 1.0, "mA": 1e-3, "%": 1.0, "1": 1.0},  # or any other signal in proportion to torques
    "1": {"1": 1.0},
}


def factor_to(si: str, unit: str, what: str) -> float:
    """Return the factor from a unit to an SI unit; spaces, dots and asterisks in it do not matter.

    Args:
        si: the SI unit, such as `N m`.
        unit: the unit as it is written, such as `deg`, `mA`, `N*m`.
        what: the column, for the message.

    Raises:
        ResultError: it is no unit of this quantity.
    """
    plain = re.sub(r"[\s*.·]", "", unit).replace("°", "deg").replace("µ", "u").replace("μ", "u")
    if plain in FACTORS[si]:
        return FACTORS[si][plain]
    known = next((one for one, units in FACTORS.items() if plain in units), None)
    hint = f", which is a unit of {known}" if known else checks.did_you_mean(plain, FACTORS[si]).rstrip("?").lower()
    raise ResultError(f"{what}: expected a unit among {', '.join(FACTORS[si])}; got {checks.short(unit)}{hint}")
