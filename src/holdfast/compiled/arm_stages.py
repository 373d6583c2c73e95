"""One arm as a stage: parameters, then outward to the grasp, then back from the grasp force.

The texts are those of the reference; between their phases the object's filter acts.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.compiled.folded import with_constants
from holdfast.compiled.packing import upper
from holdfast.compiled.structure import Options
from holdfast.compiler.program import Shape
from holdfast.compiler.stage import Stage, stage
from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion
from holdfast.dynamics.arm.regrouping import regrouped
from holdfast.dynamics.closed.contact import contact
from holdfast.dynamics.closed.measurement import Measurement, measurement
from holdfast.dynamics.closed.tip_response import Route, TipResponse, tip_response
from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench

BASE_MOTION = ("base_twist", "base_acceleration")  # parameters, if bases move
LINKS = ("link_mass", "link_com", "link_inertia")  # parameters, if the links' inertias are

Phases = Generator[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]

NO_INERTIA = 1e-14  # as in dynamics/forward: what is left of an articulated inertia is rounding

SHAPES: dict[str, Shape] = {
    "gravity": (3,),
    "base_R": (3, 3),
    "base_p": (3,),
    "base_twist": (6,),
    "base_acceleration": (6,),
    "grasp_R": (3, 3),
    "grasp_p": (3,),
    "grasp_wrench": (6,),
    "object_R": (3, 3),
    "object_p": (3,),
    "object_twist": (6,),
}  # of ports that are alike for all arms
CENTRE: dict[str, Shape] = {"centre": (3,), "centripetal": (3,)}  # the object's mass centre


class ArmType:
    """What arms must share to run side by side: everything that is folded into the code.

    Attributes:
        arm: one of them; base and name do not matter.
        kind: of its grasp, or None.
        options: the user's choices.
    """

    def __init__(self, arm: Arm, kind: str | None, options: Options) -> None:
        constant = with_constants(arm)
        self.arm = constant if options.link_inertia else regrouped(constant)
        self.kind, self.options = kind, options

    def ports(self, names: Iterable[str]) -> dict[str, Shape]:
        """Return the shapes of named ports; those of links only if they are run-time parameters or inputs."""
        N = self.arm.joint_count
        by_joint: dict[str, Shape] = {"q": (N,), "qd": (N,), "qdd": (N,), "tau": (N,)}
        links: dict[str, Shape] = {"link_mass": (N,), "link_com": (N, 3), "link_inertia": (N, 3, 3)}
        shapes = SHAPES | by_joint | (links if self.options.link_inertia else {})
        if self.options.link_wrenches:
            shapes["link_wrench"] = (N, 6)
        return {name: shapes[name] for name in names if name in shapes}

    def parameters(self) -> dict[str, Shape]:
        """Return the shapes of the arm's run-time parameters."""
        names = ("base_R", *(BASE_MOTION if self.options.base_motion else ()), "gravity", *LINKS)
        return self.ports((*names, "grasp_R", "grasp_p") if self.kind else names)

    def inputs(self) -> dict[str, Shape]:
        """Return the shapes of the arm's own inputs."""
        return self.ports(("q", "qd", "tau", "link_wrench"))

    def mounted(self, given: dict[str, Array]) -> Arm:
        """Return the arm with its run-time parameters in place; what is not given does not matter."""
        base = Pose.unchecked(given.get("base_R", np.eye(3)), given.get("base_p", np.zeros(3)))
        arm = replace(self.arm, base=base)
        if self.options.link_inertia:
            links = zip(given["link_mass"], given["link_com"], given["link_inertia"], strict=True)
            arm = replace(arm, links=tuple(Link(m, com, I, physical=False) for m, com, I in links))
        return arm

    def held(self, given: dict[str, Array]) -> Grasp:
        """Return the arm's grasp with its run-time parameters in place."""
        assert self.kind is not None
        frame = Pose.unchecked(given["grasp_R"], given["grasp_p"])
        return replace(Grasp(self.kind), frame=frame)  # type: ignore[arg-type]

    def motion(self, given: dict[str, Array], now: dict[str, Array]) -> ArmMotion:
        """Return the arm in motion."""
        still = np.zeros(6)
        acceleration = given.get("base_acceleration", still) - concatenate([np.zeros(3), given["gravity"]])
        return arm_motion(
            ArmInputs(
                self.mounted(given),
                now["q"],
                now["qd"],
                now["tau"],
                given.get("base_twist", still),
                acceleration,
                now.get("link_wrench"),
            )
        )


def held_arm(of: ArmType, route: Route) -> Stage:
    """Return the stage of an arm that holds: its measurement of alpha(C), and what f does to it."""
    parameters, inputs = of.parameters(), of.inputs()

    def text(*arrays: Array) -> Phases:
        given = dict(zip(parameters, arrays, strict=True))
        *own, object_R, object_twist, centre, centripetal = yield ()
        motion = of.motion(given, dict(zip(inputs, own, strict=True)))
        c = contact(of.held(given), Pose.unchecked(object_R, np.zeros(3)), object_twist, motion.tip_twist)
        tip = tip_response(motion, route)
        about = c.about(centre, centripetal)
        m = measurement(about, tip)
        from_arm, alpha = yield outward_of(m)
        f = c.transmissible(shift_wrench(-about.offset, from_arm))
        qdd, base = tip.back(f)
        gap = shift_twist(c.offset, alpha) + c.a - tip_acceleration(motion, qdd) - c.g
        return _sound(tip, qdd), f, base, gap[:3] @ c.h

    return stage(
        f"arm_{of.kind}",
        text,
        [
            parameters,
            inputs | {"object_R": (3, 3), "object_twist": (6,)} | CENTRE,
            {"from_arm": (6,), "alpha": (6,)},
        ],
        [(), outward_names(of), ("qdd", "grasp_wrench", "base_wrench", "contact_acceleration")],
    )


def outward_of(m: Measurement) -> tuple[Array, ...]:
    """Return what the object's filter needs to know of an arm."""
    return (upper(m.R), m.r, m.extent) if m.carried else (upper(m.R), m.r, m.extent, m.C)


def outward_names(of: ArmType) -> tuple[str, ...]:
    """Return the ports of the same."""
    return ("noise", "measured", "extent") if of.kind == "rigid" else ("noise", "measured", "extent", "rows")


def lone_arm(of: ArmType, route: Route) -> Stage:
    """Return the stage of an arm that holds nothing."""
    parameters, inputs = of.parameters(), of.inputs()

    def text(*arrays: Array) -> Phases:
        own = yield ()
        motion = of.motion(dict(zip(parameters, arrays, strict=True)), dict(zip(inputs, own, strict=True)))
        tip = tip_response(motion, route)
        qdd, base = tip.back(np.zeros(6))
        return _sound(tip, qdd), np.zeros(6), base

    return stage("arm_alone", text, [parameters, inputs], [(), ("qdd", "grasp_wrench", "base_wrench")])


def _sound(tip: TipResponse, qdd: Array) -> Array:
    """Return the accelerations, not-a-number where the arm's mass matrix is singular."""
    largest: Scalar = 0.0
    for pivot in tip.pivots:
        largest = maximum(largest, pivot)
    first = qdd[0]
    for pivot in tip.pivots:
        first = where(pivot > NO_INERTIA * largest, first, float("nan"))
    return concatenate([[first], qdd[1:]])
