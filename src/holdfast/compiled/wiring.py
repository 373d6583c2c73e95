"""How the stages of a chain are tied to its arrays: what the schedules of all computations share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate

from holdfast.compiled.structure import Structure
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import Call, External, Group, Internal, Wire
from holdfast.compiler.stage import Stage
from holdfast.model.closed_chain import ClosedChain

# Arrays with a place for each joint, arm or grasp, and how many numbers that is.
_BY_JOINT = {"q": 1, "qd": 1, "qdd": 1, "tau": 1, "link_wrench": 6, "link_mass": 1, "link_com": 3, "link_inertia": 9}
_BY_ARM = {"base_R": 9, "base_p": 3, "base_twist": 6, "base_acceleration": 6, "grasp_wrench": 6, "base_wrench": 6}
_BY_GRASP = {"grasp_R": 9, "grasp_p": 3}


def shapes(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shape of every array of a chain that computations take or return, by name."""
    n, l, g = chain.joint_count, len(chain.arms), len(chain.grasps)
    return {
        "q": (n,),
        "qd": (n,),
        "qdd": (n,),
        "tau": (n,),
        "object_pose": (7,),
        "object_twist": (6,),
        "object_acceleration": (6,),
        "object_wrench": (6,),
        "link_wrench": (n, 6),
        "grasp_wrench": (l, 6),
        "base_wrench": (l, 6),
        "contact_acceleration": (chain.contact_freedom_count,),
        "gravity": (3,),
        "object_mass": (),
        "object_com": (3,),
        "object_inertia": (3, 3),
        "link_mass": (n,),
        "link_com": (n, 3),
        "link_inertia": (n, 3, 3),
        "base_R": (l, 3, 3),
        "base_p": (l, 3),
        "base_twist": (l, 6),
        "base_acceleration": (l, 6),
        "grasp_R": (g, 3, 3),
        "grasp_p": (g, 3),
    }


def externals(
    inputs: Iterable[str], parameters: Iterable[str], outputs: Iterable[str], shape: Mapping[str, Shape]
) -> dict[str, External]:
    """Return a computation's arrays: inputs, then parameters, then outputs."""
    return (
        {name: External(shape[name], "input") for name in inputs}
        | {name: External(shape[name], "parameter") for name in parameters}
        | {name: External(shape[name], "output") for name in outputs}
    )


def starts(sizes: Iterable[int]) -> list[int]:
    """Return where parts of these sizes begin when they lie in a row, and where the last one ends."""
    return list(accumulate(sizes, initial=0))


def arm_wires(structure: Structure, rows: Sequence[int]) -> dict[str, Wire]:
    """Return the wires of arms to the chain's arrays, by port."""
    chain, names = structure.chain, [structure.chain.names[row] for row in rows]
    joints = [chain.joints[name].start for name in names]
    wires = {port: Wire(port, tuple(size * j for j in joints)) for port, size in _BY_JOINT.items()}
    wires |= {port: Wire(port, tuple(size * row for row in rows)) for port, size in _BY_ARM.items()}
    if all(name in chain.grasps for name in names):
        holding = [structure.held_rows.index(row) for row in rows]
        freedoms = tuple(chain.contact_freedoms[name].start for name in names)
        wires |= {port: Wire(port, tuple(size * i for i in holding)) for port, size in _BY_GRASP.items()}
        wires["contact_acceleration"] = Wire("contact_acceleration", freedoms)
    return wires


class ScheduleWriter:
    """Collects the groups, arrays and calls of a schedule.

    Attributes:
        structure: the chain as the compiler sees it.
        externals: the caller's arrays.
        internals, groups, prepare, calls: as in `Schedule`.
    """

    def __init__(self, structure: Structure, externals: dict[str, External]) -> None:
        self.structure, self.externals = structure, externals
        self.internals: dict[str, Internal] = {}
        self.groups: dict[str, Group] = {}
        self.prepare: list[Call] = []
        self.calls: list[Call] = []

    def alone(self, name: str, stage: Stage, wires: Mapping[str, Wire] | None = None) -> None:
        """Add a stage that runs once, and its calls."""
        self.group(name, stage, 1, wires or {})
        for phase in range(len(stage.inputs)):
            parameters_only = phase == 0 and len(stage.inputs) > 1
            (self.prepare if parameters_only else self.calls).append(Call(name, phase, (0,)))

    def arms(
        self, name: str, stage: Stage, rows: Sequence[int], own: Iterable[str], wires: Mapping[str, Wire] | None = None
    ) -> None:
        """Add arms of one type, side by side, and the call of what depends on parameters only.

        Args:
            name: the group's.
            stage: the stage; its first phase takes parameters.
            rows: which arms.
            own: ports, if the stage has them, with an array of the group's own, `name.port`.
            wires: of ports that have another array's name.
        """
        tied = {**arm_wires(self.structure, rows), **(wires or {})}
        for port in own:
            if port in stage.shapes:
                self.internals[f"{name}.{port}"] = Internal(len(rows), stage.size(port))
                tied[port] = Wire(f"{name}.{port}", tuple(range(len(rows))))
        self.group(name, stage, len(rows), tied, side_by_side=True)
        self.prepare.append(Call(name, 0, tuple(range(len(rows)))))

    def group(
        self, name: str, stage: Stage, count: int, wires: Mapping[str, Wire], *, side_by_side: bool = False
    ) -> None:
        """Add a group; ports without a wire are tied to the one array of their name."""
        wired = {port: wires.get(port) or Wire(port.removesuffix("'"), (0,) * count) for port in stage.shapes}
        self.groups[name] = Group(stage, count, wired, side_by_side)
