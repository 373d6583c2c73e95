"""Which built-in robot an arm is: its looks and its home posture go with its joints, not with its name."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.model.arm import Arm
from holdfast.robots.gen3 import GEN3_HOME, GEN3_LOOKS, GEN3_ROWS
from holdfast.robots.iiwa14 import IIWA14_HOME, IIWA14_LOOKS, IIWA14_ROWS
from holdfast.robots.link_table import Row, signed_axes
from holdfast.robots.panda import PANDA_HOME, PANDA_LOOKS, PANDA_ROWS
from holdfast.robots.primitive import Primitive
from holdfast.robots.ur5e import UR5E_HOME, UR5E_LOOKS, UR5E_ROWS
from holdfast.spatial.scalar import Array

SAME = 1e-4  # m, and entries of rotations: descriptions round right angles to 1.5708


class Known(NamedTuple):
    """What is known of a built-in robot besides its mechanics.

    Attributes:
        rows: its joints and links.
        home: a posture with room on every side, (N,) [rad].
        looks: solids on its base and links.
    """

    rows: tuple[Row, ...]
    home: Array
    looks: tuple[tuple[Primitive, ...], ...]


KNOWN: dict[str, Known] = {
    "panda": Known(PANDA_ROWS, PANDA_HOME, PANDA_LOOKS),
    "iiwa14": Known(IIWA14_ROWS, IIWA14_HOME, IIWA14_LOOKS),
    "ur5e": Known(UR5E_ROWS, UR5E_HOME, UR5E_LOOKS),
    "gen3": Known(GEN3_ROWS, GEN3_HOME, GEN3_LOOKS),
}


def builtin_of(arm: Arm) -> str | None:
    """Return the name of the built-in robot with the same joints (kinds, axes, placements), or None.

    Names, masses, tools and where it stands do not matter, so an arm from a file is known too.
    """
    return next((name for name, known in KNOWN.items() if _same_joints(arm, known.rows)), None)


def home_of(arm: Arm) -> Array | None:
    """Return the home posture (N,) of the built-in robot that the arm is [rad], or None."""
    name = builtin_of(arm)
    return None if name is None else KNOWN[name].home


def _same_joints(arm: Arm, rows: tuple[Row, ...]) -> bool:
    return arm.joint_count == len(rows) and all(
        joint.kind == "revolute"
        and np.allclose(joint.axis, [0.0, 0.0, 1.0], rtol=0, atol=SAME)
        and np.allclose(joint.placement.R, signed_axes(row.axes), rtol=0, atol=SAME)
        and np.allclose(joint.placement.p, row.origin, rtol=0, atol=SAME)
        for joint, row in zip(arm.joints, rows, strict=True)
    )
