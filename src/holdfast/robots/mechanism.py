"""What an assembly is made of, before anything is closed."""

from __future__ import annotations

from typing import NamedTuple

from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject


class Mechanism(NamedTuple):
    """Arms, the object they are to hold, and how: `assemble(*mechanism)` closes it.

    Attributes:
        arms: arm by name, mounted.
        held_object: the object.
        grasps: grasp by arm name.
    """

    arms: dict[str, Arm]
    held_object: HeldObject
    grasps: dict[str, Grasp]
