"""A single program as a schedule: one stage, one item."""

from __future__ import annotations

from holdfast.compiler.program import Program
from holdfast.compiler.schedule import Call, External, Group, Schedule, Wire
from holdfast.compiler.stage import stage_of


def schedule_of(program: Program) -> Schedule:
    """Return the schedule that runs one program; inputs are named in0, in1 ..., outputs out0 ..."""
    inputs = {f"in{k}": shape for k, shape in enumerate(program.input_shapes)}
    outputs = {f"out{k}": output.shape for k, output in enumerate(program.outputs)}
    externals = {name: External(shape, "input") for name, shape in inputs.items()}
    externals |= {name: External(shape, "output") for name, shape in outputs.items()}
    wires = {name: Wire(name, (0,)) for name in externals}
    stage = stage_of("program", program, [inputs], [tuple(outputs)])
    group = Group(stage, 1, wires, side_by_side=False)
    return Schedule(externals, {}, {"program": group}, (), (Call("program", 0, (0,)),))
