"""What a body of welded links weighs."""

from __future__ import annotations

import numpy as np

from holdfast.model.link import Link
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.folding import Body
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.spatial.inertia import turned
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import dot, product


def welded_link(robot: UrdfRobot, body: Body, physical: bool) -> Link:
    """Return the links of a body as one.

        m = sum m_i,  c = sum m_i c_i / m,  J = sum R_i J_i R_i^T + m_i (d_i.d_i 1 - d_i d_i^T),

    d_i = c_i - c. Each link by itself must be possible.

    Raises:
        SceneError: an impossible link, or a body without any <inertial>.
    """
    name = next(iter(body.links))
    parts: list[tuple[float, Array, Array]] = []
    for link, at in body.links.items():
        inertial = robot.links[link].inertial
        if inertial is None:
            continue
        with inertial.element.refusals():
            own = Link(inertial.mass, inertial.com, inertial.inertia, link, physical)
        parts.append((own.mass, at.p + product(at.R, own.com), turned(own.inertia, at.R)))
    if not parts:
        raise robot.links[name].element.refuse(
            f"expected <inertial>, since joint {quoted(body.step.joint.name)} moves it, got none; try adding one"
            " (mass 0 and inertia 0 where it is meant to be massless)"
        )
    with robot.links[name].element.refusals():
        return Link(*_sum(parts), name=name, physical=physical)


def _sum(parts: list[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Return mass, mass centre and inertia about it of bodies welded together."""
    m = sum(part[0] for part in parts)
    c = sum((m_i / m * c_i for m_i, c_i, _ in parts), np.zeros(3)) if m > 0 else np.zeros(3)
    if len(parts) == 1:
        c = parts[0][1]
    J = np.zeros((3, 3))
    for m_i, c_i, J_i in parts:
        d = c_i - c
        J = J + J_i + m_i * (dot(d, d) * np.eye(3) - np.outer(d, d))
    return m, c + 0.0, J + 0.0  # no -0.0
