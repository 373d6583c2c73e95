"""Programs and schedules as kernels, random ones, and bits compared.

A random schedule has items side by side and one after the other, with values between them that are handed on:

object -> items of every group, in lanes -> one after the other, "s" handed on -> turn
       <- items of every group, in lanes <- one after the other, "t" handed on <-
"""

import random
from collections.abc import Callable, Sequence

import numpy as np
from hypothesis import strategies as st

from holdfast.compiler.graph import Graph
from holdfast.compiler.kernel import Kernel
from holdfast.compiler.lowering import lowered
from holdfast.compiler.program import Program, Shape
from holdfast.compiler.schedule import Call, External, Group, Internal, Schedule
from holdfast.compiler.stage import Stage, Wire, stage_of
from holdfast.compiler.targets import cpu
from holdfast.compiler.trace import program_of, trace

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


COUNTS = (1, 2, 3, 5, 8, 9, 17)
Ports = dict[str, Shape]

KINDS = ["add", "subtract", "multiply", "divide", "fma", "select", "negate", "absolute", "sqrt", "sin"]
WEIGHTS = [6, 6, 8, 2, 4, 2, 2, 1, 1, 0.3]


def stage(name: str, function: Callable, inputs: Sequence[Ports], outputs: Sequence[Sequence[str]]) -> Stage:
    """Return the stage of a function that is given the inputs of all phases; it is cut by what is known when."""
    program = trace(function, [shape for phase in inputs for shape in phase.values()])
    return stage_of(name, lowered(program, cpu.has_fma()), inputs, outputs, program.operation_count)


def random_stage(draw: random.Random, name: str, inputs: list[Ports], outputs: list[Ports], steps: int = 12) -> Stage:
    """Return a stage of random operations whose outputs depend on any input that is known by then."""
    graph = Graph()
    arrays = [[graph.input() for shape in given.values() for _ in range(int(np.prod(shape)))] for given in inputs]
    numbers: list[object] = [draw.choice([0.5, -1.25, 3.0])]
    results = []
    for entries, wanted in zip(arrays, outputs, strict=True):
        numbers += entries
        for _ in range(draw.randint(0, steps)):
            numbers.append(_operation(draw, graph, numbers[-8:] if draw.random() < 0.5 else numbers))
        for shape in wanted.values():
            chosen = [draw.choice(numbers) for _ in range(int(np.prod(shape)))]
            results.append((shape, [graph.constant(x) if isinstance(x, float) else x for x in chosen]))
    shapes = tuple(shape for given in inputs for shape in given.values())
    program = lowered(program_of(graph, shapes, results))
    return stage_of(name, program, inputs, [tuple(wanted) for wanted in outputs])


def _operation(draw: random.Random, graph: Graph, numbers: list[object]) -> object:
    kind = draw.choices(KINDS, WEIGHTS)[0]
    x, y, z, w = (draw.choice(numbers) for _ in range(4))
    if kind == "select":
        return graph.apply("select", graph.apply(draw.choice(["less", "less_equal"]), x, y), z, w)
    if kind == "fma":
        return graph.apply(kind, x, y, z)
    if kind in ("add", "subtract", "multiply", "divide"):
        return graph.apply(kind, x, y)
    return x if isinstance(x, float) else graph.apply(kind, x)


class Writer:
    """Writes one random schedule."""

    def __init__(self, draw: random.Random, counts: list[int], side_by_side: list[bool]) -> None:
        self.draw, self.counts, self.side_by_side = draw, counts, side_by_side
        total = sum(counts)
        self.externals = {
            "x": External((2 * total + 3,), "input"),
            "y": External((3,), "input"),
            "code": External((), "input"),
            "p": External((total, 1), "parameter"),
            "g": External((2,), "parameter"),
            "z": External((total, 2), "output"),
            "seen": External((total,), "output"),
            "sum": External((3,), "output"),
            "status": External((), "output"),
        }
        self.internals = {
            "frame": Internal(1, 2),
            "alpha": Internal(1, 3),
            "s": Internal(total + 1, 3),
            "t": Internal(total + 1, 2),
        }
        self.groups: dict[str, Group] = {}
        self.prepare: list[Call] = []
        self.calls: list[Call] = []

    def schedule(self, guarded: tuple[str, ...]) -> Schedule:
        """Return the schedule."""
        groups, total = range(len(self.counts)), sum(self.counts)
        runs = self._runs()
        back = self.draw.choice([[(k, items[::-1]) for k, items in reversed(runs)], self._runs()])
        self._alone("object", [{"g": (2,)}, {"y": (3,)}], [{}, {"frame": (2,), "s'": (3,)}])
        for k in groups:
            self._items(k)
            self._filter(k, _places(runs, k), _places(back, k))
        self._all("items", 1)
        self.calls += [Call(f"filter{k}", 0, items) for k, items in runs]
        self._alone("turn", [{"s": (3,)}], [{"t'": (2,), "sum": (3,)}], {"s": Wire("s", (total,))})
        self.calls += [Call(f"filter{k}", 1, items) for k, items in back]
        self._alone("end", [{"t": (2,), "y": (3,)}], [{"alpha": (3,)}], {"t": Wire("t", (total,))})
        self._all("items", 2)
        self._group("status", stage_of("status", _same(), [{"code": ()}], [("status",)]), 1, {}, False)
        self.calls.append(Call("status", 0, (0,)))
        return Schedule(
            self.externals, self.internals, self.groups, tuple(self.prepare), tuple(self.calls), "status", guarded
        )

    def _alone(
        self, name: str, inputs: list[Ports], outputs: list[Ports], wires: dict[str, Wire] | None = None
    ) -> None:
        self._group(name, random_stage(self.draw, name, inputs, outputs), 1, wires or {}, False)
        for phase in range(len(inputs)):
            (self.prepare if phase < len(inputs) - 1 else self.calls).append(Call(name, phase, (0,)))

    def _items(self, k: int) -> None:
        """The items of a group, in three phases: parameters, out, back."""
        count, name = self.counts[k], f"items{k}"
        inputs = [{"p": (1,), "g": (2,)}, {"x": (2,), "y": (3,), "frame": (2,)}, {"from": (2,), "alpha": (3,)}]
        stage = random_stage(self.draw, name, inputs, [{}, {"m": (2,), "seen": (1,)}, {"z": (2,)}])
        self.internals |= {f"m{k}": Internal(count, 2), f"from{k}": Internal(count, 2)}
        first = sum(self.counts[:k])
        own = self.draw.sample(range(first, first + count), count)  # any order in the caller's arrays
        every = tuple(range(count))
        wires = {
            "p": Wire("p", tuple(own)),
            "x": Wire("x", tuple(self.draw.randint(0, 2 * sum(self.counts)) for _ in own)),  # they may overlap
            "seen": Wire("seen", tuple(own)),
            "z": Wire("z", tuple(2 * i for i in own)),
            "m": Wire(f"m{k}", every),
            "from": Wire(f"from{k}", every),
        }
        self._group(name, stage, count, wires, self.side_by_side[k])
        self.prepare.append(Call(name, 0, every))

    def _filter(self, k: int, out: list[int], back: list[int]) -> None:
        """The items of a group one after the other, out and back; each is handed a value and hands one on."""
        count = self.counts[k]
        every = tuple(range(count))
        inputs = [{"m": (2,), "s": (3,)}, {"t": (2,)}]
        stage = random_stage(self.draw, f"filter{k}", inputs, [{"s'": (3,)}, {"t'": (2,), "from": (2,)}])
        wires = {"m": Wire(f"m{k}", every), "from": Wire(f"from{k}", every)}
        for port, places in (("s", out), ("t", back)):
            wires |= {port: Wire(port, tuple(places)), f"{port}'": Wire(port, tuple(i + 1 for i in places))}
        self._group(f"filter{k}", stage, count, wires, False)

    def _runs(self) -> list[tuple[int, tuple[int, ...]]]:
        """Return all items of all groups in a random order, or in order or reversed; runs of a group together."""
        order = [(k, i) for k, count in enumerate(self.counts) for i in range(count)]
        way = self.draw.choice(["forward", "reverse", "mixed", "blocks"])
        if way == "reverse":
            order.reverse()
        elif way == "mixed":
            self.draw.shuffle(order)
        runs: list[tuple[int, tuple[int, ...]]] = []
        for k, i in order:
            if runs and runs[-1][0] == k and (way != "blocks" or len(runs[-1][1]) < 4):
                runs[-1] = k, (*runs[-1][1], i)
            else:
                runs.append((k, (i,)))
        return runs

    def _all(self, name: str, phase: int) -> None:
        for k, count in enumerate(self.counts):
            self.calls.append(Call(f"{name}{k}", phase, tuple(range(count))))

    def _group(self, name: str, stage: Stage, count: int, wires: dict[str, Wire], side_by_side: bool) -> None:
        alone = {port: Wire(port.removesuffix("'"), (0,) * count) for port in stage.shapes}
        self.groups[name] = Group(stage, count, {p: wires.get(p, alone[p]) for p in alone}, side_by_side)


def _places(runs: list[tuple[int, tuple[int, ...]]], group: int) -> list[int]:
    """Return when each item of a group has its turn."""
    turns = {one: turn for turn, one in enumerate((k, i) for k, items in runs for i in items)}
    return [turns[group, i] for i in range(sum(k == group for k, _ in turns))]


def _same():
    graph = Graph()
    x = graph.input()
    return program_of(graph, ((),), [((), [x])])


@st.composite
def schedules(draw: st.DrawFn) -> Schedule:
    """Return a random schedule of one to three groups; its status is its input `code`."""
    counts = draw(st.lists(st.sampled_from(COUNTS), min_size=1, max_size=3))
    side_by_side = [draw(st.booleans()) for _ in counts]
    guarded = draw(st.lists(st.sampled_from(["z", "seen", "sum"]), unique=True))
    return Writer(random.Random(draw(st.integers(0, 2**32))), counts, side_by_side).schedule(tuple(guarded))


def inputs_of(schedule: Schedule, seed: int, wild: bool) -> dict[str, np.ndarray]:
    """Return random inputs and parameters; wild ones make infinities and NaN likely."""
    numbers = np.random.default_rng(seed)
    found = {}
    for name in schedule.names("input", "parameter"):
        x = numbers.normal(size=schedule.externals[name].shape)
        if wild:
            x = np.where(numbers.random(x.shape) < 0.2, numbers.choice([0.0, -0.0, 1e300, -1e-300, 1e6], x.shape), x)
        found[name] = np.asarray(x, dtype=float)
    found["code"] = np.array(float(numbers.choice([0, 0, 0, 1, 2, 3, 4, 5])))
    return found
