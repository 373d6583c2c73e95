"""Forward dynamics as a schedule: arms outward, the object's filter out and back, arms back.

    object -> arms (side by side) -> filter, arm after arm -> turning point
           <- arms (side by side) <- filter, arm after arm <-
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

from holdfast.compiled import object_stages
from holdfast.compiled.arm_stages import ArmType, held_arm, lone_arm
from holdfast.compiled.packing import upper_count
from holdfast.compiled.structure import Structure
from holdfast.compiler.schedule import Call, External, Group, Internal, Schedule, Wire
from holdfast.compiler.stage import Stage
from holdfast.model.grasp import Grasp

GUARDED = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")


def forward_externals(structure: Structure) -> dict[str, External]:
    """Return the arrays of compiled forward dynamics: inputs, parameters, results."""
    chain, options = structure.chain, structure.options
    n, l, g = chain.joint_count, len(chain.arms), len(chain.grasps)
    inputs: dict[str, tuple[int, ...]] = {
        "q": (n,),
        "qd": (n,),
        "tau": (n,),
        "object_pose": (7,),
        "object_twist": (6,),
        "object_wrench": (6,),
    }
    if options.link_wrenches:
        inputs["link_wrench"] = (n, 6)
    parameters: dict[str, tuple[int, ...]] = {
        "gravity": (3,),
        "generic_rank": (),
        "object_mass": (),
        "object_com": (3,),
        "object_inertia": (3, 3),
        "base_R": (l, 3, 3),
        "base_twist": (l, 6),
        "base_acceleration": (l, 6),
        "grasp_R": (g, 3, 3),
        "grasp_p": (g, 3),
    }
    if options.link_inertia:
        parameters |= {"link_mass": (n,), "link_com": (n, 3), "link_inertia": (n, 3, 3)}
    outputs: dict[str, tuple[int, ...]] = {
        "qdd": (n,),
        "grasp_wrench": (l, 6),
        "object_acceleration": (6,),
        "contact_acceleration": (chain.contact_freedom_count,),
        "base_wrench": (l, 6),
        "rank": (),
        "status": (),
        "condition": (),
    }
    return (
        {name: External(shape, "input") for name, shape in inputs.items()}
        | {name: External(shape, "parameter") for name, shape in parameters.items()}
        | {name: External(shape, "output") for name, shape in outputs.items()}
    )


def forward_schedule(structure: Structure) -> Schedule:
    """Return the schedule of one chain's forward dynamics."""
    return _Writer(structure).schedule()


class _Writer:
    """Collects groups, arrays and calls."""

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        self.externals = forward_externals(structure)
        self.internals: dict[str, Internal] = {}
        self.groups: dict[str, Group] = {}
        self.prepare: list[Call] = []
        self.calls: list[Call] = []
        rows = structure.filter_order
        self.dense_first = bool(rows) and structure.parallel(rows[0])
        self.dense_last = bool(rows) and structure.parallel(rows[-1])

    def schedule(self) -> Schedule:
        self._object()
        arms = [self._arms(f"arms{k}", rows) for k, rows in enumerate(self.structure.types.values())]
        runs = self._filter()
        for group, held in arms:
            self.calls.append(Call(group, 1, tuple(range(len(held)))))
        self._share()
        self._outward(runs)
        self._alone("turning_point", object_stages.turning_point(self.dense_last, 6 * len(self.structure.held_rows)))
        for group, items in reversed(runs):
            self.calls.append(Call(group, 1, tuple(reversed(items))))
        for group, rows in arms:
            if self.structure.kind(rows[0]):
                self.calls.append(Call(group, 2, tuple(range(len(rows)))))
        guarded = tuple(name for name in GUARDED if self.externals[name].size)
        return Schedule(
            self.externals, self.internals, self.groups, tuple(self.prepare), tuple(self.calls), "status", guarded
        )

    def _object(self) -> None:
        """The object alone; it begins the filter."""
        replaced = {"x": 6, "kept": 1, "weakest": 1, "share": 1, "s": 6, "P": upper_count(6), "D": 6, "w": 36}
        for name, size in replaced.items():
            self.internals[name] = Internal(1, size, replaced=True)
        for name, size in {"R": 9, "mobility": upper_count(6), "size": 6, "alpha": 6}.items():
            self.internals[name] = Internal(1, size)
        freedoms = self.structure.chain.contact_freedom_count
        self._alone("object", object_stages.held_object(self.dense_first, freedoms))

    def _alone(self, name: str, stage: Stage) -> None:
        """A stage that runs once."""
        self._group(name, stage, 1, {}, side_by_side=False)
        for phase in range(len(stage.inputs)):
            parameters_only = phase == 0 and len(stage.inputs) > 1
            (self.prepare if parameters_only else self.calls).append(Call(name, phase, (0,)))

    def _arms(self, name: str, rows: list[int]) -> tuple[str, list[int]]:
        """The arms of one type, in lanes."""
        structure, chain = self.structure, self.structure.chain
        kind, arm, options = structure.kind(rows[0]), structure.arm(rows[0]), structure.options
        of = ArmType(arm, kind, options.link_inertia, options.link_wrenches)
        stage = held_arm(of, options.route) if kind else lone_arm(of, options.route)
        joints = tuple(chain.joints[chain.names[row]].start for row in rows)
        wires = {port: Wire(port, joints) for port in ("q", "qd", "tau", "qdd", "link_mass")}
        wires |= {"link_wrench": Wire("link_wrench", tuple(6 * j for j in joints))}
        wires |= {"link_com": Wire("link_com", tuple(3 * j for j in joints))}
        wires |= {"link_inertia": Wire("link_inertia", tuple(9 * j for j in joints))}
        for port, size in {"base_R": 9, "base_twist": 6, "base_acceleration": 6}.items():
            wires[port] = Wire(port, tuple(size * row for row in rows))
        for port in ("grasp_wrench", "base_wrench"):
            wires[port] = Wire(port, tuple(6 * row for row in rows))
        wires |= {port: Wire(port, (0,) * len(rows)) for port in ("gravity", "object_twist")}
        wires |= {"object_R": Wire("R", (0,) * len(rows)), "mobility": Wire("mobility", (0,) * len(rows))}
        wires["alpha"] = Wire("alpha", (0,) * len(rows))
        if kind:
            holding = [structure.held_rows.index(row) for row in rows]
            freedoms = tuple(chain.contact_freedoms[chain.names[row]].start for row in rows)
            wires |= {"grasp_R": Wire("grasp_R", tuple(9 * i for i in holding))}
            wires |= {"grasp_p": Wire("grasp_p", tuple(3 * i for i in holding))}
            wires["contact_acceleration"] = Wire("contact_acceleration", freedoms)
            for port in ("noise", "measured", "ratio", "rows", "object_size", "from_arm"):
                if port in stage.shapes:
                    array = f"{name}.{port}"
                    self.internals[array] = Internal(len(rows), stage.size(port))
                    wires[port] = Wire(array, tuple(range(len(rows))))
        self.groups[name] = Group(stage, len(rows), {p: wires[p] for p in stage.shapes}, side_by_side=True)
        self.prepare.append(Call(name, 0, tuple(range(len(rows)))))
        return name, rows

    def _filter(self) -> list[tuple[str, tuple[int, ...]]]:
        """The filter's stages; returns which arms of which type follow each other."""
        structure = self.structure
        types = {row: (k, i) for k, rows in enumerate(structure.types.values()) for i, row in enumerate(rows)}
        runs = []
        made: dict[tuple[str, int], Stage] = {}
        for k, part in groupby(structure.filter_order, key=lambda row: types[row][0]):
            items = tuple(types[row][1] for row in part)
            name, group = f"filter{k}", f"arms{k}"
            runs.append((name, items))
            if name in self.groups:
                continue
            row = list(structure.types.values())[k][0]
            kind, joints = structure.kind(row), structure.arm(row).joint_count
            assert kind is not None
            if structure.parallel(row):
                stage = made.setdefault(("parallel", 6), object_stages.rigid_arm(6))
            else:
                most = min(joints, len(Grasp(kind).transmitted))  # type: ignore[arg-type]
                stage = made.setdefault((kind, most), object_stages.rows_arm(kind, most))
            count = self.groups[group].count
            wires = {
                port: Wire(f"{group}.{port}", tuple(range(count)))
                for port in ("noise", "measured", "rows", "from_arm")
            }
            own_size = f"{group}.object_size" in self.internals
            wires["size"] = Wire(f"{group}.object_size" if own_size else "size", tuple(range(count)))
            if not own_size:
                wires["size"] = Wire("size", (0,) * count)
            self._group(name, stage, count, wires, side_by_side=False)
        return runs

    def _share(self) -> None:
        """The arms' share in the scale of pivots."""
        stage = object_stages.share()
        for k, rows in enumerate(self.structure.types.values()):
            if self.structure.kind(rows[0]):
                wires = {"ratio": Wire(f"arms{k}.ratio", tuple(range(len(rows))))}
                self._group(f"share{k}", stage, len(rows), wires, side_by_side=False)
                self.calls.append(Call(f"share{k}", 0, tuple(range(len(rows)))))

    def _outward(self, runs: list[tuple[str, tuple[int, ...]]]) -> None:
        """The filter from the object through all arms, in factors from the first rows on."""
        dense = self.dense_first
        for name, items in runs:
            if dense and "D'" in self.groups[name].stage.shapes:
                self._alone("into_factors", object_stages.into_factors())
                dense = False
            self.calls.append(Call(name, 0, items))

    def _group(self, name: str, stage: Stage, count: int, wires: Mapping[str, Wire], side_by_side: bool) -> None:
        """Add a group; ports without a wire are tied to the one array of their name."""
        shared = {port: Wire(port.removesuffix("'"), (0,) * count) for port in stage.shapes}
        wired = {port: wires.get(port, shared[port]) for port in stage.shapes}
        self.groups[name] = Group(stage, count, wired, side_by_side)
