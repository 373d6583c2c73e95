"""The object's filter as calls of a schedule: arms outward, the filter out and back, arms back.

Forward dynamics runs it with the arms' free accelerations, projection with gaps at the grasps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import groupby

from holdfast.compiled import object_stages
from holdfast.compiled.packing import upper_count
from holdfast.compiled.structure import Structure
from holdfast.compiled.wiring import ScheduleWriter
from holdfast.compiler.schedule import Call, External, Internal, Wire
from holdfast.compiler.stage import Stage
from holdfast.model.grasp import Grasp

Run = tuple[str, tuple[int, ...]]  # arms of one type that follow each other in the filter

# What an arm's stage and the filter hand to each other.
BETWEEN = ("noise", "measured", "extent", "rows", "from_arm")


class FilterWriter(ScheduleWriter):
    """Collects groups, arrays and calls of object filters.

    Attributes:
        dense_first: whether the object's mobility begins as a matrix, for a parallel sum.
        dense_last: whether the filter turns round at a parallel sum.
    """

    def __init__(self, structure: Structure, externals: dict[str, External]) -> None:
        super().__init__(structure, externals)
        rows = structure.filter_order
        self.dense_first = bool(rows) and structure.parallel(rows[0])
        self.dense_last = bool(rows) and structure.parallel(rows[-1])
        self._made: dict[str, Stage] = {}
        replaced = {"x": 6, "kept": 1, "weakest": 1, "size": 3, "s": 6, "P": upper_count(6), "D": 6, "w": 36}
        for name, size in replaced.items():
            self.internals[name] = Internal(1, size, replaced=True)
        for name, size in {"R": 9, "centre": 3, "centripetal": 3, "own": 3, "alpha": 6}.items():
            self.internals[name] = Internal(1, size)

    def arm_groups(self, prefix: str, stage_of: Callable[[int], Stage], by_joint: Iterable[str] = ()) -> None:
        """Add the arms, type by type, as groups `prefix arms0`, ...

        Args:
            prefix: of the groups' names.
            stage_of: row of an arm -> the stage of its type.
            by_joint: ports with a place for each joint in the array of their name.
        """
        for k, rows in enumerate(self.structure.types.values()):
            wires = {"object_R": Wire("R", (0,) * len(rows)), "object_p": Wire("object_pose", (4,) * len(rows))}
            starts = tuple(self.structure.joint_start(row) for row in rows)
            wires |= {port: Wire(port, starts) for port in by_joint}
            self.arms(f"{prefix}arms{k}", stage_of(rows[0]), rows, BETWEEN, wires)

    def solve(
        self,
        prefix: str,
        kind_of: Callable[[int], str | None],
        row_count: int,
        turning: Mapping[str, Wire] | None = None,
    ) -> None:
        """Add the calls of one filter, arms included; `R`, `centre`, `x`, ... are those of the object.

        Args:
            prefix: of the arms' groups, and of the filter's.
            kind_of: row of an arm -> the kind of grasp that counts; None: it holds nothing.
            row_count: of the constraint, contact freedoms included.
            turning: wires of the turning point where they differ from the ports' names.
        """
        arms = [(f"{prefix}arms{k}", rows) for k, rows in enumerate(self.structure.types.values())]
        runs = self._filter(prefix, kind_of)
        for group, rows in arms:
            self.calls.append(Call(group, 1, tuple(range(len(rows)))))
        self._most_mobile(prefix, kind_of)
        wires = dict(turning or {})
        if self.dense_last:
            runs, last = self._without_last(runs)
            self._outward(prefix, runs)
            self._turn(prefix, object_stages.last_rigid_arm(row_count), wires | last)
        else:
            self._outward(prefix, runs)
            self._turn(prefix, object_stages.turning_point(row_count), wires)
        for group, items in reversed(runs):
            self.calls.append(Call(group, 1, tuple(reversed(items))))
        for group, rows in arms:
            if kind_of(rows[0]):
                self.calls.append(Call(group, 2, tuple(range(len(rows)))))

    def _turn(self, prefix: str, stage: Stage, wires: Mapping[str, Wire]) -> None:
        self.alone(f"{prefix}turning_point", stage, wires)

    def _filter(self, prefix: str, kind_of: Callable[[int], str | None]) -> list[Run]:
        """The filter's stages; returns which arms of which type follow each other."""
        structure = self.structure
        types = {row: (k, i) for k, rows in enumerate(structure.types.values()) for i, row in enumerate(rows)}
        runs = []
        for k, part in groupby(structure.filter_order, key=lambda row: types[row][0]):
            items = tuple(types[row][1] for row in part)
            name, group = f"{prefix}filter{k}", f"{prefix}arms{k}"
            runs.append((name, items))
            if name in self.groups:
                continue
            row = list(structure.types.values())[k][0]
            stage = self._arm_in_filter(row, kind_of(row))
            count = self.groups[group].count
            wires = {
                port: Wire(f"{group}.{port}", tuple(range(count)))
                for port in ("noise", "measured", "extent", "rows", "from_arm")
            }
            self.group(name, stage, count, wires)
        return runs

    def _arm_in_filter(self, row: int, kind: str | None) -> Stage:
        """Return the filter's stage for an arm, made once for all that are alike."""
        assert kind is not None
        if self.structure.parallel(row):
            return self.once("rigid_arm", object_stages.rigid_arm)
        most = min(self.structure.arm(row).joint_count, len(Grasp(kind).transmitted))  # type: ignore[arg-type]
        return self.once(f"{kind} {most}", lambda: object_stages.rows_arm(kind, most))

    def once(self, key: str, make: Callable[[], Stage]) -> Stage:
        """Return a stage that several groups share, made when first asked for."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def _without_last(self, runs: list[Run]) -> tuple[list[Run], dict[str, Wire]]:
        """Return the runs without their last arm, and what that one's ports are tied to."""
        *before, (name, items) = runs
        wires = {}
        for port in ("noise", "measured", "extent", "from_arm"):
            wire = self.groups[name].wires[port]
            wires[port] = Wire(wire.array, (wire.places[items[-1]],))
        return [*before, *([(name, items[:-1])] if len(items) > 1 else [])], wires

    def _most_mobile(self, prefix: str, kind_of: Callable[[int], str | None]) -> None:
        """The size of the most mobile arm, by which pivots are judged."""
        stage = self.once("most_mobile", object_stages.most_mobile)
        for k, rows in enumerate(self.structure.types.values()):
            if kind_of(rows[0]):
                wires = {"extent": Wire(f"{prefix}arms{k}.extent", tuple(range(len(rows))))}
                self.group(f"{prefix}most_mobile{k}", stage, len(rows), wires)
                self.calls.append(Call(f"{prefix}most_mobile{k}", 0, tuple(range(len(rows)))))

    def _outward(self, prefix: str, runs: list[Run]) -> None:
        """The filter from the object through all arms, in factors from the first rows on."""
        dense = self.dense_first
        for name, items in runs:
            if dense and "D'" in self.groups[name].stage.shapes:
                self.alone(f"{prefix}into_factors", object_stages.into_factors())
                dense = False
            self.calls.append(Call(name, 0, items))
