"""The built-in arms and their home positions, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from holdfast.model.arm import Arm
from holdfast.robots.gen3 import gen3
from holdfast.robots.iiwa14 import iiwa14
from holdfast.robots.panda import panda
from holdfast.robots.recognise import BUILT_IN
from holdfast.robots.ur5e import ur5e
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array

ROBOTS: Mapping[str, Callable[..., Arm]] = FrozenDict({"panda": panda, "iiwa14": iiwa14, "ur5e": ur5e, "gen3": gen3})
HOME: Mapping[str, Array] = FrozenDict({robot.name: robot.home for robot in BUILT_IN})
