"""What else is computed of a chain, arm by arm, and its schedules: arms of one type side by side.

The texts are those of the reference. Energies are summed over object and arms in the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.compiled.arm_stages import LINKS, ArmType, Phases
from holdfast.compiled.object_stages import unit_pose
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.wiring import ScheduleWriter, externals, shapes, starts
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import Call, External, Internal, Schedule, Wire
from holdfast.compiler.stage import Stage, stage
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.arm.velocity import link_twists, tip_twist
from holdfast.dynamics.closed.contact import contact
from holdfast.dynamics.consistency import tip_from_contact
from holdfast.dynamics.energy import arm_kinetic_energy, arm_potential_energy, held_body
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import TRANSMITTED
from holdfast.model.held_object import HeldObject
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar

Given = dict[str, Array]
Results = tuple[Any, ...]

# Numbers of a grasp's attitude that its position rows are made of: R of tip from contact, or its x axis.
ATTITUDES: dict[str | None, int] = {"rigid": 9, "hinge": 3}

_OBJECT = ("object_mass", "object_com", "object_inertia")


@dataclass(frozen=True, eq=False)
class Computation:
    """A computation arm by arm.

    Attributes:
        inputs: the caller's arrays.
        parameters: run-time parameters; those of links, if they matter, are added as the options say.
        arm: what is computed of one arm.
        results: by name, how many numbers of it each arm has; an energy has none but a sum.
        arm_inputs: the arm's inputs, where they are not the caller's.
        arm_parameters: the arm's parameters, where they are not all.
        body: the object's part: its frame for the arms, or its energy.
        by_grasp: whether it is of the arms that hold, each kind in its way.
        by_links: whether the links' inertias matter.
        acting: whether wrenches on the links do.
    """

    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    arm: Callable[[ArmType, Given], Results]
    results: Mapping[str, Callable[[int, str | None], int]]
    arm_inputs: tuple[str, ...] | None = None
    arm_parameters: tuple[str, ...] | None = None
    body: Callable[[Given], Scalar] | None = None
    by_grasp: bool = False
    by_links: bool = True
    acting: bool = False

    @property
    def summed(self) -> bool:
        """Whether the arms' and the object's parts are added up."""
        return self.body is not None

    def structure(self, chain: ClosedChain, options: Options) -> Structure:
        """Return the chain as this computation sees it; options that do not matter are left out."""
        own = Options("auto", options.link_inertia and self.by_links, options.link_wrenches and self.acting, True)
        return Structure(chain, own, self.by_grasp, self.by_links)

    def externals(self, structure: Structure) -> dict[str, External]:
        """Return the arrays it takes and returns."""
        chain, options = structure.chain, structure.options
        inputs = (*self.inputs, "link_wrench") if options.link_wrenches else self.inputs
        parameters = (*self.parameters, *LINKS) if options.link_inertia else self.parameters
        found = {name: (self.starts(chain, name)[-1],) for name in self.results}
        outputs: dict[str, Shape] = {"energy": ()} if self.summed else found
        return externals(inputs, parameters, outputs, shapes(chain) | outputs)

    def starts(self, chain: ClosedChain, result: str) -> list[int]:
        """Return where each arm's part of a result begins, and where the last one ends."""
        kinds = [chain.grasps[name].kind if name in chain.grasps else None for name in chain.arms]
        sizes = zip(chain.arms.values(), kinds, strict=True)
        return starts(self.results[result](arm.joint_count, kind) for arm, kind in sizes)

    def stage(self, of: ArmType) -> Stage:
        """Return the stage of one type of arms."""
        parameters = of.ports((*(self.arm_parameters or self.parameters), *LINKS))
        inputs = of.ports((*(self.arm_inputs or self.inputs), "link_wrench"))

        def text(*arrays: Array) -> Phases:
            given = dict(zip(parameters, arrays, strict=True))
            now = yield ()
            return self.arm(of, given | dict(zip(inputs, now, strict=True)))

        names = ["part"] if self.summed else [name for name in self.results if self.results[name](1, of.kind)]
        return stage("arm", text, [parameters, inputs], [(), names])

    def schedule(self, structure: Structure) -> Schedule:
        """Return the schedule for one chain."""
        writer = ScheduleWriter(structure, self.externals(structure))
        if self.summed:
            writer.internals["sum"] = Internal(1, 1, replaced=True)
            writer.alone("object", self._object())
        elif "object_pose" in self.inputs:
            writer.internals["R"] = Internal(1, 9)
            writer.alone("object", stage("frame", lambda p: (unit_pose(p).R,), [{"object_pose": (7,)}], [("R",)]))
        for k, rows in enumerate(structure.types.values()):
            if structure.kind(rows[0]) or not self.by_grasp:
                self._arms(writer, f"arms{k}", rows)
        if self.summed:
            writer.alone("total", stage("total", lambda x: (x[()],), [{"sum": ()}], [("energy",)]))
        return Schedule(writer.externals, writer.internals, writer.groups, tuple(writer.prepare), tuple(writer.calls))

    def _arms(self, writer: ScheduleWriter, name: str, rows: Sequence[int]) -> None:
        """The arms of one type."""
        structure, options, items = writer.structure, writer.structure.options, tuple(range(len(rows)))
        kind = structure.kind(rows[0]) if self.by_grasp else None
        made = self.stage(ArmType(structure.arm(rows[0]), kind, options))
        places = {result: self.starts(structure.chain, result) for result in self.results}
        wires = {result: Wire(result, tuple(places[result][row] for row in rows)) for result in self.results}
        wires |= {"object_R": Wire("R", (0,) * len(rows)), "object_p": Wire("object_pose", (4,) * len(rows))}
        writer.arms(name, made, rows, ("part",), wires)
        writer.calls.append(Call(name, 1, items))
        if self.summed:
            add = stage("add", lambda x, part: (x[()] + part[()],), [{"sum": (), "part": ()}], [("sum'",)])
            writer.group(f"sum{name}", add, len(rows), {"part": Wire(f"{name}.part", items)})
            writer.calls.append(Call(f"sum{name}", 0, items))

    def _object(self) -> Stage:
        """Return the stage with which the sum begins."""
        body = self.body
        assert body is not None
        parameters: dict[str, Shape] = {"object_mass": (), "object_com": (3,), "object_inertia": (3, 3)}
        inputs: dict[str, Shape] = {"object_pose": (7,)}
        if "gravity" in self.parameters:
            parameters["gravity"] = (3,)
        if "object_twist" in self.inputs:
            inputs["object_twist"] = (6,)

        def text(*arrays: Array) -> Phases:
            given = dict(zip(parameters, arrays, strict=True))
            now = yield ()
            return (body(given | dict(zip(inputs, now, strict=True))),)

        return stage("object", text, [parameters, inputs], [(), ("sum'",)])


def _torques(of: ArmType, x: Given) -> Results:
    motion = of.motion(x, x | {"tau": np.zeros(of.arm.joint_count)})
    return (drive_torques(motion, x["qd"], x["qdd"], x["grasp_wrench"]),)


def _mass_matrix(of: ArmType, x: Given) -> Results:
    arm = of.mounted(x)
    return (mass_matrix(arm, posture(arm, x["q"]))[0],)


def _jacobian(of: ArmType, x: Given) -> Results:
    arm = of.mounted(x)
    return (jacobian(arm, posture(arm, x["q"])),)


def _closure(of: ArmType, x: Given) -> Results:
    arm = of.mounted(x)
    at = posture(arm, x["q"])
    V = tip_twist(arm, at, link_twists(arm, at, x["qd"], x["base_twist"]))
    c = contact(of.held(x), Pose.unchecked(x["object_R"], x["object_p"]), x["object_twist"], V)
    seen = tip_from_contact(c, x["object_p"] + c.offset, at.tip)
    attitude = {"rigid": (seen.R,), "hinge": (seen.R[:, 0],)}.get(c.grasp.kind, ())
    return (*attitude, -seen.p, c.velocity_gap)


def _kinetic_energy(of: ArmType, x: Given) -> Results:
    return (arm_kinetic_energy(of.mounted(x), x["q"], x["qd"], x["base_twist"]),)


def _potential_energy(of: ArmType, x: Given) -> Results:
    return (arm_potential_energy(of.mounted(x), x["q"], x["gravity"]),)


def _object_kinetic_energy(x: Given) -> Scalar:
    return held_body(_held(x), unit_pose(x["object_pose"]), x["object_twist"]).kinetic_energy


def _object_potential_energy(x: Given) -> Scalar:
    return held_body(_held(x), unit_pose(x["object_pose"]), np.zeros(6)).potential_energy(x["gravity"])


def _held(x: Given) -> HeldObject:
    mass: Scalar = x["object_mass"][()]
    return HeldObject(mass, x["object_inertia"], x["object_com"], physical=False)


COMPUTATIONS: dict[str, Computation] = {
    "inverse_dynamics": Computation(
        ("q", "qd", "qdd", "grasp_wrench"),
        ("gravity", "base_R", "base_twist", "base_acceleration"),
        _torques,
        {"tau": lambda N, _: N},
        acting=True,
    ),
    "mass_matrix": Computation(("q",), (), _mass_matrix, {"mass_matrix": lambda N, _: N * N}),
    "jacobian": Computation(("q",), ("base_R",), _jacobian, {"jacobian": lambda N, _: 6 * N}, by_links=False),
    "closure": Computation(
        ("q", "qd", "object_pose", "object_twist"),
        ("base_R", "base_p", "base_twist", "grasp_R", "grasp_p"),
        _closure,
        {
            "attitude": lambda _, kind: ATTITUDES.get(kind, 0),
            "shift": lambda _, kind: 3 if kind else 0,
            "velocity": lambda _, kind: len(TRANSMITTED[kind]) if kind else 0,
        },
        arm_inputs=("q", "qd", "object_R", "object_p", "object_twist"),
        by_grasp=True,
        by_links=False,
    ),
    "kinetic_energy": Computation(
        ("q", "qd", "object_pose", "object_twist"),
        (*_OBJECT, "base_R", "base_twist"),
        _kinetic_energy,
        {},
        arm_inputs=("q", "qd"),
        arm_parameters=("base_R", "base_twist"),
        body=_object_kinetic_energy,
    ),
    "potential_energy": Computation(
        ("q", "object_pose"),
        ("gravity", *_OBJECT, "base_R", "base_p"),
        _potential_energy,
        {},
        arm_inputs=("q",),
        arm_parameters=("gravity", "base_R", "base_p"),
        body=_object_potential_energy,
    ),
}
