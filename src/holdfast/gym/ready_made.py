"""The default chains of the tasks: two Pandas and a box."""

from __future__ import annotations

from holdfast.assembly.assemble import assemble
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Friction, Grasp, contact_frame
from holdfast.model.held_object import HeldObject
from holdfast.robots.panda import panda
from holdfast.state import State

PLACE = (1, 0, 0, 0, 0, 0, 0.72)


def two_fingers() -> tuple[ClosedChain, State]:
    """Return two arms that press a 3 kg box between rubber fingers."""
    rubber = Friction(mu=0.8, torsion_radius=0.02)
    left = Grasp("softfinger", contact_frame([-0.15, 0, 0], into=[1, 0, 0]), contact=rubber)
    right = Grasp("softfinger", contact_frame([0.15, 0, 0], into=[-1, 0, 0]), contact=rubber)
    box = HeldObject.box(3.0, 0.3, 0.2, 0.2)
    return assemble(_arms(0.55), box, {"left": left, "right": right}, object_pose=PLACE)


def two_hands() -> tuple[ClosedChain, State]:
    """Return two arms with rigid grasps of a 1 kg box, so that each could hold it alone."""
    left = Grasp("rigid", contact_frame([-0.15, 0, 0], into=[1, 0, 0]))
    right = Grasp("rigid", contact_frame([0.15, 0, 0], into=[-1, 0, 0]))
    box = HeldObject.box(1.0, 0.3, 0.1, 0.1)
    return assemble(_arms(0.55), box, {"left": left, "right": right}, object_pose=PLACE)


def _arms(apart: float) -> dict[str, Arm]:
    """Return two Pandas that face each other, with armature."""
    at = {"left": (1, 0, 0, 0, -apart, 0, 0), "right": (0, 0, 0, 1, apart, 0, 0)}
    return {name: panda(base, armature=0.3) for name, base in at.items()}
