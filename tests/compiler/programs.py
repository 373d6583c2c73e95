"""Programs as kernels, random programs, and bits compared."""

import numpy as np
from hypothesis import strategies as st

from holdfast.compiler.graph import Graph
from holdfast.compiler.kernel import Kernel
from holdfast.compiler.lowering import lowered
from holdfast.compiler.program import Program
from holdfast.compiler.schedule import Call, External, Group, Schedule, Wire
from holdfast.compiler.stage import stage_of
from holdfast.compiler.trace import program_of

BINARY = ("add", "subtract", "multiply", "divide")
UNARY = ("negate", "absolute", "sqrt", "sin", "cos")

# Halves of ranges, zeros of both signs, numbers near overflow and below the normal ones.
NUMBERS = st.one_of(
    st.floats(-4.0, 4.0),
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 1e-300, 5e-324, 1e300, -1e308, 1e5, np.pi]),
    st.floats(allow_nan=False, allow_infinity=False),
)


@st.composite
def programs(draw: st.DrawFn, steps: int = 40) -> Program:
    """Return a random program of two inputs, (3,) and (2, 2), and two results."""
    graph = Graph()
    numbers: list[object] = [graph.input() for _ in range(7)]
    truths: list[object] = []
    for _ in range(draw(st.integers(1, steps))):
        operand = st.one_of(st.sampled_from(numbers), NUMBERS)
        kind = draw(st.sampled_from([*BINARY, *BINARY, *UNARY, "fma", "less", "less_equal", "select"]))
        if kind == "select" and truths:
            result = graph.apply(kind, draw(st.sampled_from(truths)), draw(operand), draw(operand))
        elif kind in ("less", "less_equal"):
            result = graph.apply(kind, draw(st.sampled_from(numbers[:7])), draw(operand))
            truths.append(result)
            continue
        elif kind in UNARY:
            result = graph.apply(kind, draw(st.sampled_from([x for x in numbers if not isinstance(x, float)])))
        elif kind == "fma":
            result = graph.apply(kind, draw(st.sampled_from(numbers)), draw(operand), draw(operand))
        else:
            result = graph.apply("add" if kind == "select" else kind, draw(st.sampled_from(numbers)), draw(operand))
        numbers.append(result)
    nodes = [graph.constant(x) if isinstance(x, float) else x for x in numbers]
    chosen = draw(st.lists(st.sampled_from(nodes), min_size=5, max_size=5))
    return program_of(graph, ((3,), (2, 2)), [((5,), chosen), ((), [nodes[-1]])])


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether two arrays hold the same bits; a NaN is a NaN."""
    a, b = np.array(a, dtype=float), np.array(b, dtype=float)
    if a.shape != b.shape or not np.array_equal(np.isnan(a), np.isnan(b)):
        return False
    fine = ~np.isnan(a)
    return np.array_equal(a[fine].view(np.int64), b[fine].view(np.int64))


def all_same_bits(a: tuple[np.ndarray, ...], b: tuple[np.ndarray, ...]) -> bool:
    """Return whether two lists of arrays hold the same bits."""
    return len(a) == len(b) and all(same_bits(x, y) for x, y in zip(a, b, strict=True))


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


class ArrayKernel(Kernel):
    """A kernel that takes plain arrays, inputs before parameters: one system's, or a batch's by a leading axis."""

    def __call__(self, *inputs: object, threads: int = 1) -> tuple[np.ndarray, ...]:
        """Return the results; an array without the batch axis is shared by all systems."""
        given = {name: e for name, e in self.externals.items() if e.role != "output"}
        returned = {name: e for name, e in self.externals.items() if e.role == "output"}
        arrays = [np.require(x, float, ["C", "A"]) for x in inputs]
        shapes = zip(arrays, given.values(), strict=True)
        sizes = {len(a) for a, e in shapes if a.ndim > len(e.shape)}
        if not sizes:
            bound = self.bind()
            for name, x in zip(given, arrays, strict=True):
                bound.arrays[name][...] = x
            bound.prepare()
            bound.run()
            return tuple(bound.arrays[name].copy() for name in returned)
        (batch,) = sizes
        results = [np.empty((batch, *e.shape)) for e in returned.values()]
        all_arrays = dict(zip([*given, *returned], [*arrays, *results], strict=True))
        rows = [
            (all_arrays[name].ctypes.data, e.size if all_arrays[name].ndim > len(e.shape) else 0)
            for name, e in self.externals.items()
        ]
        self.run_batch(np.array(rows, dtype=np.int64), batch, threads)
        return tuple(results)


def compile_program(program: Program, fused: bool = True, lanes: int | None = None) -> ArrayKernel:
    """Return a program as a kernel."""
    schedule = schedule_of(lowered(program, fused))
    return ArrayKernel(schedule.externals, lambda: schedule, lanes=lanes)
