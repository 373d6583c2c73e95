"""A closed chain as a MuJoCo model: arms, a free box, one weld per arm at its hardest setting.

MuJoCo is imported where it is used: it is optional.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.bench.systems import System
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

HARDEST = 0.9999  # the largest impedance MuJoCo accepts; its default, 0.95, is far softer


def mjcf(chain: ClosedChain, solver: str, jacobian: str) -> str:
    """Return the chain as MJCF text, without geoms, so that no collision work is timed."""
    bodies = "".join(_arm(name, arm) for name, arm in chain.arms.items())
    held = chain.held_object
    bodies += f'<body name="object"><freejoint/>{_inertial(held.mass, held.com, held.inertia)}</body>'
    welds = "".join(_weld(name, chain) for name in chain.grasps)
    return (
        f'<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option solver="{solver}" jacobian="{jacobian}" gravity="{_text(chain.gravity)}">'
        '<flag contact="disable"/></option>'
        f"<worldbody>{bodies}</worldbody><equality>{welds}</equality></mujoco>"
    )


def _arm(name: str, arm: Arm) -> str:
    opening = ""
    for k, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
        placement = joint.placement if k else arm.base @ joint.placement
        opening += (
            f'<body name="{name}/{k}" {_placed(placement)}>'
            f'<joint axis="{_text(joint.axis)}" armature="{joint.armature!r}"/>'
            f"{_inertial(link.mass, link.com, link.inertia)}"
        )
    return opening + "</body>" * arm.joint_count


def _weld(name: str, chain: ClosedChain) -> str:
    arm, contact = chain.arms[name], chain.grasps[name].frame
    # `anchor` is the contact in the last link's axes; `relpose` has its place in the object's axes, and the
    # attitude of the last link seen from the object
    turn = rotation.to_quaternion(contact.R @ arm.tip.R.T)
    return (
        f'<weld body1="object" body2="{name}/{arm.joint_count - 1}" anchor="{_text(arm.tip.p)}"'
        f' relpose="{_text(contact.p)} {_text(turn)}"'
        f' solimp="{HARDEST} {HARDEST} 0.001 0.5 2"/>'
    )


def _inertial(mass: float, com: Array, inertia: Array) -> str:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    full = _text([xx, yy, zz, xy, xz, yz])
    return f'<inertial mass="{mass!r}" pos="{_text(com)}" fullinertia="{full}"/>'


def _placed(pose: Pose) -> str:
    return f'pos="{_text(pose.p)}" quat="{_text(rotation.to_quaternion(pose.R))}"'


def _text(numbers: Any) -> str:
    """Return numbers with every digit they have."""
    return " ".join(repr(float(x)) for x in numbers)


def inputs(system: System) -> list[tuple[Array, Array, Array]]:
    """Return qpos, qvel and qfrc_applied of every state."""
    rows = []
    for q, qd, tau, pose, twist in zip(*system.arrays, strict=True):
        R = rotation.from_quaternion(pose[:4])
        rows.append(
            (
                np.concatenate([q, pose[4:], pose[:4]]),
                np.concatenate([qd, twist[3:], R.T @ twist[:3]]),  # linear in the world, angular in the body
                np.concatenate([tau, np.zeros(6)]),
            )
        )
    return rows
