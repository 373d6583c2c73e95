"""Random robots as URDF and as SDF, written twice in unlike ways: link frames elsewhere, axes in other frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import holdfast as hf
from holdfast.spatial import rotation


class RandomJoint(NamedTuple):
    """A joint and the link beyond it.

    Attributes:
        kind: "revolute" or "prismatic".
        origin: position and angles of the joint in the link before.
        axis: its axis, in its own frame.
        mass: mass of the link [kg].
        com: its mass centre.
        moments: its principal moments.
        turn: angles of their axes.
    """

    kind: str
    origin: np.ndarray
    axis: np.ndarray
    mass: float
    com: np.ndarray
    moments: np.ndarray
    turn: np.ndarray


def random_joints(seed: int, count: int = 5) -> list[RandomJoint]:
    """Return a chain of joints."""
    r, found = np.random.default_rng(seed), []
    for k in range(count):
        axis = r.normal(size=3)
        a, b, c = r.uniform(0.01, 0.03, size=3)
        moments = np.array([b + c, a + c, a + b])
        kind = "prismatic" if k == 2 else "revolute"
        origin = np.concatenate([r.normal(size=3) * 0.3, r.uniform(-1.5, 1.5, size=3)])
        numbers = (origin, axis / np.linalg.norm(axis), r.uniform(1, 3), r.normal(size=3) * 0.1, moments)
        found.append(RandomJoint(kind, *numbers, r.uniform(-1, 1, size=3)))
    return found


def text(x: np.ndarray) -> str:
    """Return numbers to the last bit."""
    return " ".join(repr(float(y)) for y in x)


def pose(x: np.ndarray) -> hf.Pose:
    """Return the pose of six numbers."""
    return hf.Pose.from_rpy(*x[3:], xyz=x[:3])


def six(at: hf.Pose) -> np.ndarray:
    """Return position and roll, pitch, yaw of a pose."""
    return np.concatenate([at.p, rotation.to_euler_zyx(at.R)[::-1]])


def as_urdf(joints: list[RandomJoint]) -> str:
    """Return the robot as URDF."""
    parts = ['<robot name="random"><link name="link0"/>']
    for k, one in enumerate(joints):
        xx, yy, zz = map(repr, one.moments.tolist())
        parts.append(
            f'<joint name="joint{k}" type="{one.kind}"><parent link="link{k}"/><child link="link{k + 1}"/>'
            f'<origin xyz="{text(one.origin[:3])}" rpy="{text(one.origin[3:])}"/><axis xyz="{text(one.axis)}"/>'
            f'<limit lower="-2" upper="3" velocity="4" effort="50"/><dynamics damping="0.2" friction="0.1"/></joint>'
            f'<link name="link{k + 1}"><inertial><origin xyz="{text(one.com)}" rpy="{text(one.turn)}"/>'
            f'<mass value="{one.mass!r}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )
    return "".join([*parts, "</robot>"])


def as_sdf(joints: list[RandomJoint], seed: int | None = None) -> str:
    """Return the robot as SDF.

    Args:
        joints: the robot.
        seed: None for a file of 1.11 whose links have the frames of their joints. Otherwise a file of 1.6, in which
            they have random ones, all poses are in the model, and every other axis is, too.
    """
    r = np.random.default_rng(seed)
    parts = ['<model name="random"><link name="link0"><inertial><mass>1</mass></inertial></link>']
    before, moved = hf.Pose.identity(), hf.Pose.identity()
    for k, one in enumerate(joints):
        xx, yy, zz = map(repr, one.moments.tolist())
        place, axis, inertial = text(one.origin), text(one.axis), np.concatenate([one.com, one.turn])
        link = f'<pose relative_to="joint{k}"/>'
        joint = f'<pose relative_to="link{k}">{place}</pose>'
        told = ""
        if seed is not None:
            at = before @ pose(one.origin)  # of the joint, in the model
            moved = at @ pose(np.concatenate([r.normal(size=3) * 0.1, r.uniform(-1, 1, size=3)]))  # of the link
            link, joint = f"<pose>{text(six(moved))}</pose>", f"<pose>{text(six(moved.inverse() @ at))}</pose>"
            inertial = six(moved.inverse() @ at @ pose(inertial))
            if k % 2:
                axis, told = text(at.R @ one.axis), "<use_parent_model_frame>true</use_parent_model_frame>"
            before = at
        parts.append(
            f'<joint name="joint{k}" type="{one.kind}">{joint}<parent>link{k}</parent><child>link{k + 1}</child>'
            f"<axis><xyz>{axis}</xyz>{told}<limit><lower>-2</lower><upper>3</upper><velocity>4</velocity>"
            f"<effort>50</effort></limit><dynamics><damping>0.2</damping><friction>0.1</friction></dynamics></axis></joint>"
            f'<link name="link{k + 1}">{link}<inertial><pose>{text(inertial)}</pose><mass>{one.mass!r}</mass>'
            f"<inertia><ixx>{xx}</ixx><iyy>{yy}</iyy><izz>{zz}</izz></inertia></inertial></link>"
        )
    return f'<sdf version="{1.11 if seed is None else 1.6}">{"".join(parts)}</model></sdf>'
