"""Built-in arms from published data, two mechanisms made of short arms, and the import of URDF files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import lazy_loader

from holdfast.model.arm import Arm
from holdfast.robots.gen3 import GEN3_HOME, gen3
from holdfast.robots.iiwa14 import IIWA14_HOME, iiwa14
from holdfast.robots.mechanisms import Mechanism, stewart_platform, three_finger_hand
from holdfast.robots.panda import PANDA_HOME, panda
from holdfast.robots.recognise import BUILT_IN
from holdfast.robots.ur5e import UR5E_HOME, ur5e
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.robots.descriptions import load_robot_description
    from holdfast.robots.urdf import urdf_chain

# Built-in arms do not need the readers of files, which are therefore imported lazily; `load_urdf_trunk` is public at
# the top, beside `load_urdf_arms`, and stays here for programs that have it from here.
_FROM_FILES = {"descriptions": ["load_robot_description"], "urdf": ["load_urdf_trunk", "urdf_chain"]}
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs=_FROM_FILES)

ROBOTS: Mapping[str, Callable[..., Arm]] = FrozenDict({"panda": panda, "iiwa14": iiwa14, "ur5e": ur5e, "gen3": gen3})
HOME: Mapping[str, Array] = FrozenDict({robot.name: robot.home for robot in BUILT_IN})

__all__ = [
    "GEN3_HOME",
    "HOME",
    "IIWA14_HOME",
    "PANDA_HOME",
    "ROBOTS",
    "UR5E_HOME",
    "Mechanism",
    "gen3",
    "iiwa14",
    "load_robot_description",
    "panda",
    "stewart_platform",
    "three_finger_hand",
    "ur5e",
    "urdf_chain",
]
