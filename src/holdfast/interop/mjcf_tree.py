"""Finding bodies, joints and actuators in a compiled MuJoCo model, and refusing joints that arms cannot have."""

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
    """Return a body's name, or its index if it has none."""
    return model.body(body).name or f"body {body}"


def joint_name(model: Any, joint: int) -> str:
    """Return a joint's name, or its index if it has none."""
    return model.joint(joint).name or f"joint {joint}"


def joints_of(model: Any, bodies: Iterable[int]) -> list[int]:
    """Return the indices of the joints of some bodies, in their order."""
    return [int(model.body_jntadr[b]) + k for b in bodies for k in range(int(model.body_jntnum[b]))]


def joint_kind(model: Any, joint: int) -> str:
    """Return "hinge", "slide", "ball" or "free"."""
    return mujoco_module().mjtJoint(int(model.jnt_type[joint])).name.removeprefix("mjJNT_").lower()


def drives_of(model: Any, joint: int) -> Array:
    """Return the indices of the actuators of a joint."""
    kinds = mujoco_module().mjtTrn
    on_joint = np.isin(model.actuator_trntype, (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)))
    return np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint))


def find_base(source: str, model: Any, name: str | None) -> int:
    """Return the index of the base body; the name None stands for the world.

    Raises:
        SceneError: there is no such body.
    """
    if name is None:
        return 0
    if not isinstance(name, str):
        raise SceneError(f"{source}: base: expected the name of a body, got {checks.short(name)}")
    names = {body_name(model, b): b for b in range(model.nbody)}
    if name not in names:
        raise SceneError(f"{source}: base: no body '{name}'.{checks.did_you_mean(name, names)}")
    return names[name]


def find_tip(source: str, model: Any, base: int, name: str | None) -> tuple[int, Pose]:
    """Return the index of the tip's body, and the tip's pose in its frame.

    Raises:
        SceneError: there is no such site or body, or no name is given and there are several ends.
    """
    if name is None:
        ends = [b for b in range(1, model.nbody) if b not in model.body_parentid and _beyond(model, b, base)]
        if len(ends) != 1:
            listed = ", ".join(f"'{body_name(model, b)}'" for b in ends)
            raise SceneError(f"{source}: tip: expected one end, got {len(ends)} ({listed}); try tip= with one of them")
        return ends[0], Pose.identity()
    if not isinstance(name, str):
        raise SceneError(f"{source}: tip: expected the name of a site or body, got {checks.short(name)}")
    sites = {model.site(s).name: s for s in range(model.nsite) if model.site(s).name}
    if name in sites:
        site = sites[name]
        frame = Pose.from_wxyz_xyz(np.r_[model.site_quat[site], model.site_pos[site]])
        return int(model.site_bodyid[site]), frame
    bodies = {body_name(model, b): b for b in range(model.nbody)}
    if name not in bodies:
        raise SceneError(f"{source}: tip: no site or body '{name}'.{checks.did_you_mean(name, [*sites, *bodies])}")
    return bodies[name], Pose.identity()


def bodies_between(source: str, model: Any, base: int, tip: int) -> list[int]:
    """Return the indices of the bodies from the one after the base to that of the tip.

    Raises:
        SceneError: the tip is not a descendant of the base.
    """
    path, body = [], tip
    while body != base and body != 0:
        path.insert(0, body)
        body = int(model.body_parentid[body])
    if body != base or not path:
        raise SceneError(
            f"{source}: expected a tip that hangs on the base, got base '{body_name(model, base)}' and tip on"
            f" '{body_name(model, tip)}'"
        )
    return path


def _beyond(model: Any, body: int, base: int) -> bool:
    """Return whether a body is the base or a descendant of it."""
    while body != base and body != 0:
        body = int(model.body_parentid[body])
    return body == base


def require_plain(source: str, model: Any, j: int) -> None:
    """Refuse a joint with a nonlinear spring or damping, or whose actuator has its own damping or armature.

    Raises:
        SceneError: the joint has one of these, which the message names.
    """
    dof, drives = model.jnt_dofadr[j], drives_of(model, j)
    excess = {
        "a spring that is not linear": model.jnt_stiffnesspoly[j],
        "damping that is not linear": model.dof_dampingpoly[dof],
        "a plastic spring": [model.jnt_plasticadr[j] + 1],
        "an actuator with armature": model.actuator_armature[drives],
        "an actuator with damping": [model.actuator_damping[drives], *model.actuator_dampingpoly[drives].T],
    }
    found = [name for name, values in excess.items() if np.any(np.asarray(values))]
    if found:
        raise SceneError(
            f"{source}: joint '{joint_name(model, j)}': expected linear damping and springs, armature and friction"
            f" loss of its own only, got {', '.join(found)}; try another model of the joint, or holding it (locked=)"
        )
