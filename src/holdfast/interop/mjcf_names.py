"""Bodies, joints and drives of a compiled MuJoCo model, by name and along the tree."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from holdfast.errors import SceneError
from holdfast.interop.mjcf_model import mujoco_module
from holdfast.model import checks
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


def body_name(model: Any, body: int) -> str:
    """Return a body's name, or its number where it has none."""
    return model.body(body).name or f"body {body}"


def joint_name(model: Any, joint: int) -> str:
    """Return a joint's name, or its number where it has none."""
    return model.joint(joint).name or f"joint {joint}"


def joints_of(model: Any, bodies: Iterable[int]) -> list[int]:
    """Return the numbers of the joints that move bodies, in their order."""
    return [int(model.body_jntadr[b]) + k for b in bodies for k in range(int(model.body_jntnum[b]))]


def joint_kind(model: Any, joint: int) -> str:
    """Return "hinge", "slide", "ball" or "free"."""
    return mujoco_module().mjtJoint(int(model.jnt_type[joint])).name.removeprefix("mjJNT_").lower()


def drives_of(model: Any, joint: int) -> Array:
    """Return the numbers of the actuators on a joint."""
    kinds = mujoco_module().mjtTrn
    on_joint = np.isin(model.actuator_trntype, (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)))
    return np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint))


def find_base(source: str, model: Any, name: str | None) -> int:
    """Return the number of the base body; None is the world.

    Raises:
        SceneError: no such body.
    """
    if name is None:
        return 0
    names = {body_name(model, b): b for b in range(model.nbody)}
    if name not in names:
        raise SceneError(f"{source}: base: no body '{name}'.{checks.did_you_mean(str(name), names)}")
    return names[name]


def find_tip(source: str, model: Any, base: int, name: str | None) -> tuple[int, Pose]:
    """Return the number of the tip's body, and the tip's pose in its axes.

    Raises:
        SceneError: no such site or body, or no name and several ends.
    """
    if name is None:
        ends = [b for b in range(1, model.nbody) if b not in model.body_parentid and _beyond(model, b, base)]
        if len(ends) != 1:
            listed = ", ".join(f"'{body_name(model, b)}'" for b in ends)
            raise SceneError(f"{source}: tip: expected one end, got {len(ends)} ({listed}); try tip= with one of them")
        return ends[0], Pose.identity()
    sites = {model.site(s).name: s for s in range(model.nsite) if model.site(s).name}
    if name in sites:
        site = sites[name]
        frame = Pose.from_wxyz_xyz(np.r_[model.site_quat[site], model.site_pos[site]])
        return int(model.site_bodyid[site]), frame
    bodies = {body_name(model, b): b for b in range(model.nbody)}
    if name not in bodies:
        raise SceneError(f"{source}: tip: no site or body '{name}'.{checks.did_you_mean(str(name), [*sites, *bodies])}")
    return bodies[name], Pose.identity()


def bodies_between(source: str, model: Any, base: int, tip: int) -> list[int]:
    """Return the numbers of the bodies after the base up to the tip's, base to tip.

    Raises:
        SceneError: the tip does not hang on the base.
    """
    way, body = [], tip
    while body != base and body != 0:
        way.insert(0, body)
        body = int(model.body_parentid[body])
    if body != base or not way:
        raise SceneError(
            f"{source}: expected a tip that hangs on the base, got base '{body_name(model, base)}' and tip on"
            f" '{body_name(model, tip)}'"
        )
    return way


def _beyond(model: Any, body: int, base: int) -> bool:
    """Return whether a body hangs on the base."""
    while body != base and body != 0:
        body = int(model.body_parentid[body])
    return body == base
