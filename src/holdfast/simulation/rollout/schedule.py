"""A time step as a schedule: the scheme's stages, back onto the grasps, and the verdict.

for each stage of the scheme after the first: state -> control -> forward dynamics -> slope
end of the step -> projection of positions, twice -> projection of velocities
-> control -> forward dynamics -> slope (the next step's first) -> margins -> verdict
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from holdfast.compiled import object_stages
from holdfast.compiled.arm_stages import BASE_MOTION, ArmType
from holdfast.compiled.filter_writer import FilterWriter
from holdfast.compiled.forward_schedule import forward_calls
from holdfast.compiled.structure import Structure
from holdfast.compiled.tied_arm import Level, arm_gaps, tied_arm, untied_arm
from holdfast.compiled.wiring import externals, shapes
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import Call, External, Internal, Schedule, Wire
from holdfast.compiler.stage import Stage
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout import stages
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.runge_kutta import Tableau

ROUNDS = 2  # Newton rounds on the positions: a step is closed to rounding after them
PARAMETERS = ("gravity", "generic_rank", "object_mass", "object_com", "object_inertia", "base_R", "base_p")


def carried_shapes(chain: ClosedChain, law: ControlLaw) -> dict[str, Shape]:
    """Return what a system is between two steps, by name; arrays without numbers are left out."""
    n, grasps = chain.joint_count, len(chain.grasps)
    own: dict[str, Shape] = {
        "slope": (2 * n + 16,),
        "drive": (n,),
        "memory": (len(law.memory),),
        "rank": (),
        "condition": (),
        "margin": (grasps,),
    }
    kept = {name: (shapes(chain) | own)[name] for name in stages.KEPT}
    books: dict[str, Shape] = {"work": (4,), "gaps": (4,), "code": (), "count": (), "before": (len(law.memory),)}
    found = kept | books | {"worst_margin": (grasps,), "worst_time": (grasps,)}
    return {name: shape for name, shape in found.items() if math.prod(shape)}


def step_externals(structure: Structure, law: ControlLaw) -> dict[str, External]:
    """Return the arrays of a step: inputs, parameters, and what is carried on."""
    chain = structure.chain
    own: dict[str, Shape] = {
        "begin": (),
        "step": (),
        "held": (),
        "least_margin": (),
        "generic_rank": (),
        "contact": (len(chain.grasps), 6),
    }
    told = {f"control.{name}": tuple(shape) for name, shape in law.parameters.items()}
    inputs = ["begin", "step", "held", "least_margin", "object_wrench", *told]
    parameters = [
        *PARAMETERS,
        *(BASE_MOTION if structure.options.base_motion else ()),
        "grasp_R",
        "grasp_p",
        "contact",
    ]
    carried = {f"last.{name}": External(shape, "carried") for name, shape in carried_shapes(chain, law).items()}
    return externals(inputs, parameters, (), shapes(chain) | own | told) | carried


def step_schedule(structure: Structure, law: ControlLaw, tableau: Tableau) -> Schedule:
    """Return the schedule of one step."""
    writer = _StepWriter(structure, law)
    writer.step(tableau)
    return Schedule(writer.externals, writer.internals, writer.groups, tuple(writer.prepare), tuple(writer.calls))


def evaluation_schedule(structure: Structure, law: ControlLaw) -> Schedule:
    """Return the schedule that finds the slope at a step's start anew, under other torques or parameters."""
    writer = _StepWriter(structure, law)
    writer.evaluation()
    return Schedule(writer.externals, writer.internals, writer.groups, tuple(writer.prepare), tuple(writer.calls))


class _StepWriter(FilterWriter):
    """Collects the groups, arrays and calls of a step."""

    def __init__(self, structure: Structure, law: ControlLaw) -> None:
        super().__init__(structure, step_externals(structure, law))
        self.chain, self.law = structure.chain, law
        self.carried = carried_shapes(self.chain, law)
        self.control, self.slope = (
            stages.control(law, self.chain),
            stages.slope(self.chain, structure.options.base_motion),
        )
        n, l = self.chain.joint_count, len(self.chain.arms)
        # what arms or stages replace as a whole while others still read it
        for name, size in {"q": n, "qd": n, "object_pose": 7, "object_twist": 6, "gaps": 2, "worst": 2}.items():
            self.internals[name] = Internal(size, 1, replaced=True)
        freedoms = self.chain.contact_freedom_count
        numbers = {"tau": n, "drive": n, "qdd": n, "change": n, "grasp_wrench": 6 * l, "base_wrench": 6 * l}
        numbers |= {"contact_acceleration": freedoms, "object_acceleration": 6, "memory": len(law.memory), "turn": 3}
        numbers |= {"t": 1, "work": 4, "rank": 1, "status": 1, "condition": 1, "slope": 2 * n + 16, "no_wrench": 6}
        numbers |= {"drift": 2, "margin": len(self.chain.grasps), "unused.object_acceleration": 6}
        numbers |= {"unused.rank": 1, "unused.status": 1, "unused.condition": 1, "unused.memory": len(law.memory)}
        for name, size in numbers.items():
            self.internals[name] = Internal(size, 1)
        for name, shape in self.carried.items():
            self.internals[f"next.{name}"] = Internal(math.prod(shape), 1)

    def step(self, tableau: Tableau) -> None:
        """Add all calls."""
        stage_count, n = len(tableau.b), self.chain.joint_count
        evaluation = self._forward()
        slopes = ["last.slope"]
        for k in range(1, stage_count):
            self._stage_state(tableau, k, slopes)
            self._evaluate(str(k), evaluation, {"memory": Wire("unused.memory", (0,))}, first=k == 1)
            slopes.append(f"slope{k}")
            self.internals[slopes[-1]] = Internal(2 * n + 16, 1)
            self._slope(slopes[-1])
        self._stage_state(tableau, stage_count, slopes)
        self._look()
        self.alone("drift", stages.drift())
        self._project("position", ROUNDS)
        self._project("velocity", 1)
        self._evaluate("end", evaluation, {})
        self._look()
        self._slope("slope")
        self._margins()
        sizes = {name: math.prod(self.carried[name]) for name in stages.KEPT if name in self.carried}
        self.alone("verdict", stages.verdict(sizes, len(self.chain.grasps)))
        self._hand_on(self.carried)

    def evaluation(self) -> None:
        """Add the calls of the slope where the systems are; the law's memory moves on from before it did last."""
        self.alone("as_it_is", stages.as_it_is(self.chain.joint_count))
        self._evaluate("now", self._forward(), {"last.memory": Wire("last.before", (0,))}, first=True)
        self._slope("slope")
        found = {name: self.carried[name] for name in ("slope", "memory") if name in self.carried}
        self.alone("renewed", stages.renewed(found))
        self._hand_on(found)

    def _hand_on(self, names: Mapping[str, Shape]) -> None:
        flat = {name: (math.prod(shape),) if shape else () for name, shape in names.items()}
        self.alone("handed_on", stages.handed_on(flat))

    def _forward(self) -> list[Call]:
        """Return the calls of one evaluation, without adding them."""
        before = list(self.calls)
        forward_calls(self)
        evaluation, self.calls = self.calls[len(before) :], before
        return evaluation

    def _stage_state(self, tableau: Tableau, k: int, slopes: list[str]) -> None:
        wires = {f"slope{j}": Wire(name, (0,)) for j, name in enumerate(slopes)}
        self.alone(f"stage_state{k}", stages.stage_state(tableau, k, self.chain.joint_count), wires)

    def _evaluate(self, name: str, evaluation: list[Call], memory: Mapping[str, Wire], first: bool = False) -> None:
        """Torques, then forward dynamics; `memory`: where the law's is read and written, if not in its own place."""
        self.alone(f"control {name}", self.control, memory)
        self.calls += evaluation
        self.alone(f"worst {name}", stages.worst(first))

    def _slope(self, into: str) -> None:
        self.alone(f"slope into {into}", self.slope, {"slope": Wire(into, (0,))})

    def _project(self, level: Level, rounds: int) -> None:
        """Back onto the grasps in position or in velocity."""
        structure, prefix = self.structure, f"{level} "
        before = list(self.calls)

        def kind(row: int) -> str | None:
            found = structure.kind(row)
            return "ball" if level == "position" and found == "softfinger" else found

        def arm(row: int) -> Stage:
            of = ArmType(structure.arm(row), structure.kind(row), structure.options)
            return tied_arm(of, level, structure.options.route) if of.kind else untied_arm(of)

        # a projection's own rank is not looked at: no contact freedoms to count
        self.alone(f"{prefix}object", object_stages.resting_object(self.dense_first))
        self.arm_groups(prefix, arm, by_joint=("change",))
        turning = {
            name: Wire(f"unused.{name}", (0,)) for name in ("object_acceleration", "rank", "status", "condition")
        }
        self.solve(prefix, kind, 6 * len(structure.held_rows), turning | {"object_wrench": Wire("no_wrench", (0,))})
        closed = stages.closed_in_position if level == "position" else stages.closed_in_velocity
        self.alone(f"{prefix}closed", closed(self.chain.joint_count))
        once, self.calls = self.calls[len(before) :], before
        self.calls += once * rounds

    def _look(self) -> None:
        """How far the grasps are from holding where the systems are now."""
        structure = self.structure
        self.alone("no_gaps", self.once("no_gaps", stages.no_gaps))
        for k, rows in enumerate(structure.types.values()):
            kind = structure.kind(rows[0])
            if kind is None:
                continue
            name, items = f"gaps{k}", tuple(range(len(rows)))
            if name not in self.groups:
                stage = arm_gaps(ArmType(structure.arm(rows[0]), kind, structure.options))
                wires = {"object_R": Wire("R", (0,) * len(rows)), "object_p": Wire("object_pose", (4,) * len(rows))}
                self.arms(name, stage, rows, ("position", "velocity"), wires)
                own = {port: Wire(f"{name}.{port}", items) for port in ("position", "velocity")}
                self.group(f"largest {name}", self.once("largest_gaps", stages.largest_gaps), len(rows), own)
            self.calls += [Call(name, 1, items), Call(f"largest {name}", 0, items)]

    def _margins(self) -> None:
        """Every grasp's margin."""
        structure = self.structure
        for k, rows in enumerate(structure.types.values()):
            kind = structure.kind(rows[0])
            if kind is None:
                continue
            holding = [structure.held_rows.index(row) for row in rows]
            stage = stages.margin(kind)  # type: ignore[arg-type]
            wires = {
                "contact": Wire("contact", tuple(6 * i for i in holding)),
                "grasp_R": Wire("grasp_R", tuple(9 * i for i in holding)),
                "grasp_wrench": Wire("grasp_wrench", tuple(6 * row for row in rows)),
                "object_R": Wire("R", (0,) * len(rows)),
                "margin": Wire("margin", tuple(holding)),
            }
            self.group(f"margin{k}", stage, len(rows), wires)
            self.calls.append(Call(f"margin{k}", 0, tuple(range(len(rows)))))
