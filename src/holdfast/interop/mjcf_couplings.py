"""What acts on the arms of a compiled MuJoCo model beyond their joints: couplings, and forces that are not read."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.errors import SceneError
from holdfast.interop.mjcf_bodies import MjcfRobot
from holdfast.interop.mjcf_model import is_disabled, mujoco_module
from holdfast.interop.mjcf_tree import body_name, joints_of

DEFAULT_GRAVITY = (0.0, 0.0, -9.81)  # MuJoCo's default gravity [m/s^2]
APART = -2  # the place of bodies that move apart from the arms
STANDING = -1  # the place of bodies that stand with the base


@dataclass(frozen=True, eq=False)
class Moving:
    """The bodies and joints of arms, and the base on which they stand.

    Attributes:
        robot: the model.
        groups: indices of the bodies that move together, by group.
        joints: indices of the joints that move.
        base: index of the base body.
    """

    robot: MjcfRobot
    groups: list[set[int]]
    joints: Container[int]
    base: int

    def place(self, body: int) -> int:
        """Return the index of a body's group, `STANDING` or `APART`."""
        for k, group in enumerate(self.groups):
            if body in group:
                return k
        model = self.robot.model
        standing, above = {0, self.base}, self.base
        while above:
            above = int(model.body_parentid[above])
            standing.add(above)
        while body not in standing:
            if any(j not in self.robot.held for j in joints_of(model, [body])):
                return APART
            body = int(model.body_parentid[body])
        return STANDING

    def between(self, bodies: Iterable[int], *, beside: bool) -> bool:
        """Return whether bodies are in several places, one of them on the arms; `beside` counts others that move."""
        places = {self.place(body) for body in bodies}
        if APART in places and not beside:
            return False  # a tie to another object is no matter of the arm
        return len(places) > 1 and max(places) >= 0


def checked_couplings(moving: Moving, read: Container[int] = ()) -> list[str]:
    """Return notes on what acts on the arms and is not read.

    Args:
        moving: the arms.
        read: indices of the equalities that are read.

    Raises:
        SceneError: a body has gravity compensation or a plugin, or an equality or a tendon with forces of its own acts
            on the arm; the message names it.
    """
    robot, model = moving.robot, moving.robot.model
    for b in sorted(set[int]().union(*moving.groups)):
        body = f"{robot.source}: body '{body_name(model, b)}'"
        if model.body_gravcomp[b] and model.body_mass[b]:
            got = f"{model.body_gravcomp[b]:g}; try 0 there, and joint torques that carry the body"
            raise SceneError(f"{body}: gravcomp: expected 0, got {got}")
        if model.body_plugin[b] >= 0:
            raise SceneError(f"{body}: expected no plugin that acts on it; try another model of it")
    notes = []
    for e in range(model.neq):
        if e in read or not binds(moving, e):
            continue
        name = model.equality(e).name or f"equality {e}"
        if not model.eq_active0[e] or is_disabled(model, "EQUALITY"):
            notes.append(f"{robot.source}: '{name}': an equality that is not active, not read")
            continue
        raise SceneError(
            f"{robot.source}: '{name}': expected an arm without loops or couplings, got an equality constraint"
            " within it; try to lock the joints that it couples (locked=)"
        )
    for t in range(model.ntendon):
        if _pulls(moving, t) and _has_forces(model, t):
            name = model.tendon(t).name or f"tendon {t}"
            raise SceneError(
                f"{robot.source}: '{name}': expected a tendon without forces and limits of its own on the arm; try to"
                " lock the joints over which it passes (locked=)"
            )
    return [*notes, *_flexes(moving), *_servos(moving), *_options(robot), *_mocap(moving)]


def binds(moving: Moving, e: int) -> bool:
    """Return whether an equality couples the arm to itself or to what stands still."""
    model, mujoco = moving.robot.model, mujoco_module()
    pair = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
    kind = mujoco.mjtEq(int(model.eq_type[e])).name.removeprefix("mjEQ_")
    if kind == "JOINT":
        return any(j in moving.joints for j in pair)
    if kind == "TENDON":
        return any(t >= 0 and _pulls(moving, t) for t in pair)
    if kind.startswith("FLEX"):
        return moving.between(_flex_bodies(model, pair[0]), beside=True)
    of = {"mjOBJ_SITE": model.site_bodyid, "mjOBJ_GEOM": model.geom_bodyid}
    bodies = of.get(mujoco.mjtObj(int(model.eq_objtype[e])).name, np.arange(model.nbody))
    return moving.between([int(bodies[one]) for one in pair], beside=False)


def _pulls(moving: Moving, t: int) -> bool:
    """Return whether a tendon passes over a joint of the arm, or from one of its bodies to another one."""
    model, bodies = moving.robot.model, []
    for w in range(int(model.tendon_adr[t]), int(model.tendon_adr[t] + model.tendon_num[t])):
        kind, number = mujoco_module().mjtWrap(int(model.wrap_type[w])).name, int(model.wrap_objid[w])
        if kind == "mjWRAP_JOINT" and number in moving.joints:
            return True
        if kind == "mjWRAP_SITE":
            bodies.append(int(model.site_bodyid[number]))
        elif kind in ("mjWRAP_SPHERE", "mjWRAP_CYLINDER"):
            bodies.append(int(model.geom_bodyid[number]))
    return moving.between(bodies, beside=True)


def _has_forces(model: Any, t: int) -> bool:
    quantities = (
        model.tendon_stiffness, model.tendon_stiffnesspoly, model.tendon_damping, model.tendon_dampingpoly,
        model.tendon_frictionloss, model.tendon_armature, model.tendon_limited,
    )  # fmt: skip
    return any(np.any(quantity[t]) for quantity in quantities)


def _flex_bodies(model: Any, f: int) -> set[int]:
    """Return the bodies to which a flexible body is attached."""
    first, count = int(model.flex_vertadr[f]), int(model.flex_vertnum[f])
    nodes, node_count = int(model.flex_nodeadr[f]), int(model.flex_nodenum[f])
    attached = [*model.flex_vertbodyid[first : first + count], *model.flex_nodebodyid[nodes : nodes + node_count]]
    return {int(body) for body in attached if body >= 0}


def _flexes(moving: Moving) -> list[str]:
    """Return notes on flexible bodies that are attached to the arm."""
    model, source = moving.robot.model, moving.robot.source
    found = [f for f in range(model.nflex) if moving.between(_flex_bodies(model, f), beside=True)]
    mujoco = mujoco_module()
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, f) or f for f in found]
    return [f"{source}: flex '{name}': its elastic forces are not read" for name in names]


def _servos(moving: Moving) -> list[str]:
    """Return a note on actuators whose force depends on the state, whatever their control is."""
    model, trn = moving.robot.model, mujoco_module().mjtTrn
    names = []
    for a in range(len(model.actuator_trntype)):
        kind, number = trn(int(model.actuator_trntype[a])), int(model.actuator_trnid[a, 0])
        acts = {
            trn.mjTRN_JOINT: lambda number=number: number in moving.joints,
            trn.mjTRN_JOINTINPARENT: lambda number=number: number in moving.joints,
            trn.mjTRN_TENDON: lambda number=number: _pulls(moving, number),
            trn.mjTRN_BODY: lambda number=number: moving.place(number) >= 0,
        }.get(kind, lambda number=number: moving.place(int(model.site_bodyid[number])) >= 0)
        biased = model.actuator_biastype[a] and np.any(model.actuator_biasprm[a])
        if (biased or model.actuator_plugin[a] >= 0) and number >= 0 and acts():
            names.append(repr(model.actuator(a).name or f"actuator {a}"))
    if not names:
        return []
    shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    return [f"{moving.robot.source}: actuators {shown}: servos, whose forces depend on the state, are not read"]


def _options(robot: MjcfRobot) -> list[str]:
    """Return notes on settings that act on every body."""
    option, notes = robot.model.opt, []
    if is_disabled(robot.model, "GRAVITY") or tuple(option.gravity) != DEFAULT_GRAVITY:
        shown = "disabled" if is_disabled(robot.model, "GRAVITY") else " ".join(f"{x:g}" for x in option.gravity)
        notes.append(f"{robot.source}: option gravity: {shown}, not read; try gravity= of the chain")
    given = [name for name in ("density", "viscosity", "wind") if np.any(getattr(option, name))]
    if any(name != "wind" for name in given):
        notes.append(f"{robot.source}: option {', '.join(given)}: the forces of a fluid are not read")
    return notes


def _mocap(moving: Moving) -> list[str]:
    """Return a note on a base that is moved from outside."""
    model, body = moving.robot.model, moving.base
    above: Collection[int] = [body] if body else [int(model.body_rootid[b]) for group in moving.groups for b in group]
    found = sorted({int(model.body_rootid[b]) for b in above if model.body_mocapid[model.body_rootid[b]] >= 0})
    return [f"{moving.robot.source}: body '{body_name(model, b)}': mocap, taken as standing still" for b in found]
