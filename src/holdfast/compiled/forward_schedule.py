"""Forward dynamics as a schedule: arms outward, the object's filter out and back, arms back.

object -> arms (side by side) -> filter, arm after arm -> turning point
<- arms (side by side) <- filter, arm after arm <-
"""

from __future__ import annotations

from itertools import groupby

from holdfast.compiled import object_stages
from holdfast.compiled.arm_stages import BASE_MOTION, LINKS, ArmType, held_arm, lone_arm
from holdfast.compiled.packing import upper_count
from holdfast.compiled.structure import Structure
from holdfast.compiled.wiring import ScheduleWriter, externals, shapes
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import Call, External, Internal, Schedule, Wire
from holdfast.compiler.stage import Stage
from holdfast.model.grasp import Grasp

Run = tuple[str, tuple[int, ...]]  # arms of one type that follow each other in the filter

GUARDED = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")


def forward_externals(structure: Structure) -> dict[str, External]:
    """Return the arrays of compiled forward dynamics: inputs, parameters, results."""
    chain, options = structure.chain, structure.options
    inputs = ["q", "qd", "tau", "object_pose", "object_twist", "object_wrench"]
    parameters = ["gravity", "generic_rank", "object_mass", "object_com", "object_inertia"]
    parameters += ["base_R", *(BASE_MOTION if options.base_motion else ()), "grasp_R", "grasp_p"]
    if options.link_wrenches:
        inputs.append("link_wrench")
    if options.link_inertia:
        parameters += LINKS
    verdict: dict[str, Shape] = {"generic_rank": (), "rank": (), "status": (), "condition": ()}
    outputs = (*GUARDED, "rank", "status", "condition")
    return externals(inputs, parameters, outputs, shapes(chain) | verdict)


def forward_schedule(structure: Structure) -> Schedule:
    """Return the schedule of one chain's forward dynamics."""
    return _Writer(structure).schedule()


class _Writer(ScheduleWriter):
    """Collects groups, arrays and calls."""

    def __init__(self, structure: Structure) -> None:
        super().__init__(structure, forward_externals(structure))
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
        row_count = 6 * len(self.structure.held_rows)
        if self.dense_last:
            runs, last = self._without_last(runs)
            self._outward(runs)
            self.alone("turning_point", object_stages.last_rigid_arm(row_count), last)
        else:
            self._outward(runs)
            self.alone("turning_point", object_stages.turning_point(row_count))
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
        self.alone("object", object_stages.held_object(self.dense_first, freedoms))

    def _arms(self, name: str, rows: list[int]) -> tuple[str, list[int]]:
        """The arms of one type, in lanes."""
        structure, options = self.structure, self.structure.options
        kind, arm = structure.kind(rows[0]), structure.arm(rows[0])
        of = ArmType(arm, kind, options)
        stage = held_arm(of, options.route) if kind else lone_arm(of, options.route)
        own = ("noise", "measured", "ratio", "rows", "object_size", "from_arm")
        self.arms(name, stage, rows, own, {"object_R": Wire("R", (0,) * len(rows))})
        return name, rows

    def _filter(self) -> list[Run]:
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
                stage = made.setdefault(("parallel", 6), object_stages.rigid_arm())
            else:
                most = min(joints, len(Grasp(kind).transmitted))  # type: ignore[arg-type]
                stage = made.setdefault((kind, most), object_stages.rows_arm(kind, most))
            count = self.groups[group].count
            wires = {
                port: Wire(f"{group}.{port}", tuple(range(count))) for port in ("noise", "measured", "rows", "from_arm")
            }
            own_size = f"{group}.object_size" in self.internals
            wires["size"] = Wire(f"{group}.object_size" if own_size else "size", tuple(range(count)))
            if not own_size:
                wires["size"] = Wire("size", (0,) * count)
            self.group(name, stage, count, wires)
        return runs

    def _without_last(self, runs: list[Run]) -> tuple[list[Run], dict[str, Wire]]:
        """Return the runs without their last arm, and what that one's ports are tied to."""
        *before, (name, items) = runs
        wires = {}
        for port in ("noise", "measured", "from_arm"):
            wire = self.groups[name].wires[port]
            wires[port] = Wire(wire.array, (wire.places[items[-1]],))
        return [*before, *([(name, items[:-1])] if len(items) > 1 else [])], wires

    def _share(self) -> None:
        """The arms' share in the scale of pivots."""
        stage = object_stages.share()
        for k, rows in enumerate(self.structure.types.values()):
            if self.structure.kind(rows[0]):
                wires = {"ratio": Wire(f"arms{k}.ratio", tuple(range(len(rows))))}
                self.group(f"share{k}", stage, len(rows), wires)
                self.calls.append(Call(f"share{k}", 0, tuple(range(len(rows)))))

    def _outward(self, runs: list[Run]) -> None:
        """The filter from the object through all arms, in factors from the first rows on."""
        dense = self.dense_first
        for name, items in runs:
            if dense and "D'" in self.groups[name].stage.shapes:
                self.alone("into_factors", object_stages.into_factors())
                dense = False
            self.calls.append(Call(name, 0, items))
