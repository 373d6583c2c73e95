"""One arm as a stage: parameters, then outward to the grasp, then back from the grasp force.

The texts are those of the reference; between their phases the object's filter acts.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.compiled.packing import symmetric, upper, upper_count
from holdfast.compiler.stage import Stage, stage
from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion
from holdfast.dynamics.closed.contact import contact
from holdfast.dynamics.closed.measurement import measurement, mobility_ratio
from holdfast.dynamics.closed.tip_response import Route, TipResponse, tip_response
from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import symmetric6

Phases = Generator[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]

NO_INERTIA = 1e-14  # as in dynamics/forward: what is left of an articulated inertia is rounding


class ArmType:
    """What arms must share to run side by side: everything that is folded into the code.

    Attributes:
        arm: one of them; base and name do not matter.
        kind: of its grasp, or None.
        link_inertia: whether the links' inertias are run-time parameters.
        link_wrenches: whether external wrenches act on the links.
    """

    def __init__(self, arm: Arm, kind: str | None, link_inertia: bool, link_wrenches: bool) -> None:
        self.arm, self.kind = arm, kind
        self.link_inertia, self.link_wrenches = link_inertia, link_wrenches

    def parameters(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the arm's run-time parameters."""
        N = self.arm.joint_count
        shapes: dict[str, tuple[int, ...]] = {
            "base_R": (3, 3),
            "base_twist": (6,),
            "base_acceleration": (6,),
            "gravity": (3,),
        }
        if self.link_inertia:
            shapes |= {"link_mass": (N,), "link_com": (N, 3), "link_inertia": (N, 3, 3)}
        return shapes | ({"grasp_R": (3, 3), "grasp_p": (3,)} if self.kind else {})

    def inputs(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the arm's own inputs."""
        N = self.arm.joint_count
        shapes: dict[str, tuple[int, ...]] = {"q": (N,), "qd": (N,), "tau": (N,)}
        return shapes | ({"link_wrench": (N, 6)} if self.link_wrenches else {})

    def mounted(self, given: dict[str, Array]) -> Arm:
        """Return the arm with its run-time parameters in place."""
        arm = replace(self.arm, base=Pose(given["base_R"], np.zeros(3)))
        if self.link_inertia:
            links = zip(given["link_mass"], given["link_com"], given["link_inertia"], strict=True)
            arm = replace(arm, links=tuple(Link(m, com, I, physical=False) for m, com, I in links))
        return arm

    def motion(self, given: dict[str, Array], now: dict[str, Array]) -> ArmMotion:
        """Return the arm in motion."""
        acceleration = given["base_acceleration"] - concatenate([np.zeros(3), given["gravity"]])
        return arm_motion(
            ArmInputs(
                self.mounted(given),
                now["q"],
                now["qd"],
                now["tau"],
                given["base_twist"],
                acceleration,
                now.get("link_wrench"),
            )
        )


def held_arm(of: ArmType, route: Route) -> Stage:
    """Return the stage of an arm that holds: its measurement of alpha(C), and what f does to it."""
    assert of.kind is not None
    grasp = Grasp(of.kind)  # type: ignore[arg-type]
    parameters, inputs = of.parameters(), of.inputs()

    def text(*arrays: Array) -> Phases:
        given = dict(zip(parameters, arrays, strict=True))
        *own, object_R, object_twist, mobility = yield ()
        motion = of.motion(given, dict(zip(inputs, own, strict=True)))
        held = replace(grasp, frame=Pose(given["grasp_R"], given["grasp_p"]))
        c = contact(held, Pose(object_R, np.zeros(3)), object_twist, motion.tip_twist)
        tip = tip_response(motion, route)
        m = measurement(c, tip, symmetric6(symmetric(mobility)))
        seen = (upper(m.R), m.r, mobility_ratio(m))
        from_arm, alpha = yield seen if of.kind == "rigid" else (*seen, m.C, m.object_size)
        f = c.transmissible(shift_wrench(-c.offset, from_arm))
        qdd, base = tip.back(f)
        gap = shift_twist(c.offset, alpha) + c.a - tip_acceleration(motion, qdd) - c.g
        return _sound(tip, qdd), f, base, gap[:3] @ c.h

    outward = ("noise", "measured", "ratio") + (() if of.kind == "rigid" else ("rows", "object_size"))
    return stage(
        f"arm_{of.kind}",
        text,
        [
            parameters,
            inputs | {"object_R": (3, 3), "object_twist": (6,), "mobility": (upper_count(6),)},
            {"from_arm": (6,), "alpha": (6,)},
        ],
        [(), outward, ("qdd", "grasp_wrench", "base_wrench", "contact_acceleration")],
    )


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
