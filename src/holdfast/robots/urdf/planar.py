"""Splitting of planar joints into two prismatic joints in the plane and a revolute joint about its normal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.robots.urdf.robot import UrdfInertial, UrdfJoint, UrdfLink
from holdfast.spatial.pose import Pose
from holdfast.spatial.vector import cross

UNREAD = ("limit", "dynamics", "mimic")


def taken_apart(joint: UrdfJoint) -> tuple[list[UrdfJoint], list[UrdfLink]]:
    """Return the three joints with one degree of freedom that replace a planar joint, and two massless links between.

    A planar joint 'name' becomes the prismatic joints 'name.1' and 'name.2' and the revolute joint 'name.3' about the
    normal. The prismatic joints are along the child's x and y for a normal along z, along y and z for x, and along z
    and x for y; for any other normal, they are along the nearest such directions in the plane.
    """
    normal, name, element = joint.axis, joint.name, joint.element
    along = np.eye(3)[(int(np.argmax(np.abs(normal))) + 1) % 3]
    first = along - (normal @ along) * normal
    first = first / np.linalg.norm(first)
    unread = [tag for tag in UNREAD if element.first(tag) is not None]
    notes = [*joint.notes, element.message("planar, read as two prismatic joints and a revolute joint")]
    notes += [element.message(f"{', '.join(unread)}: ignored for a planar joint")] if unread else []
    between = [f"{name}.1", f"{name}.2"]
    links = [joint.parent, *between, joint.child]
    moves = [("prismatic", first), ("prismatic", cross(normal, first)), ("continuous", normal)]
    joints = [
        replace(
            joint,
            name=f"{name}.{k + 1}",
            kind=kind,
            parent=links[k],
            child=links[k + 1],
            origin=joint.origin if k == 0 else Pose.identity(),
            axis=axis + 0.0,
            notes=tuple(notes) if k == 0 else (),
        )
        for k, (kind, axis) in enumerate(moves)
    ]
    weightless = UrdfInertial(0.0, np.zeros(3), np.zeros((3, 3)), element)
    return joints, [UrdfLink(link, weightless, element, ()) for link in between]
