"""Count the operations of every forward dynamics algorithm, from its own text.

    python benchmarks/operation_counts.py [--write docs/operation_counts.md]

Arms have generic geometry (nothing folds away), the first joint prismatic, the others revolute; q, qd,
tau, object pose and twist are run-time inputs, the model is constant. Counts are additions,
multiplications, divisions, roots and sines of everything the method returns, as they stand in the compiler's graph:
equal operations are one, constants are folded, signs are free. Its nodes carry values here, as some methods choose
pivots by them.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from pathlib import Path

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Inputs, Joint, Link, Pose, State, Trunk
from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.graph import Graph
from holdfast.compiler.node import Node
from holdfast.compiler.trace import as_node, program_of
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.methods import METHODS
from holdfast.model.trunk import BASE
from holdfast.robots import HOME, ROBOTS
from holdfast.spatial import rotation

KINDS = {
    "add": "add",
    "subtract": "add",
    "multiply": "mul",
    "divide": "div",
    "sqrt": "sqrt",
    "sin": "trig",
    "cos": "trig",
}
CHOICES = ("less", "less_equal", "select")
EVALUATED = {**OPERATIONS, "sin": math.sin, "cos": math.cos}
GRASP_KINDS = ("rigid", "hinge", "softfinger", "ball")


class Evaluated(Node):
    """A node whose value is known, so that a method may branch on it."""

    __slots__ = ()
    __hash__ = Node.__hash__

    def __bool__(self) -> bool:
        self.graph.branches += 1  # type: ignore[attr-defined]
        return bool(self.value)


class CountingGraph(Graph):
    """The compiler's graph, of evaluated nodes.

    Attributes:
        branches: how often an algorithm branched on a value.
    """

    def __init__(self) -> None:
        super().__init__()
        self.branches = 0

    def new(self, kind: str, args: tuple[Node, ...], value: float) -> Node:
        """Add a node to the graph and return it."""
        node = Evaluated(self, len(self.nodes), kind, args, value)
        self.nodes.append(node)
        return node

    def make(self, kind: str, *args: Node | float) -> Node:
        """Return the node of an operation, evaluated."""
        node = super().make(kind, *args)
        if not isinstance(node, Evaluated):
            node.__class__ = Evaluated
            node.value = EVALUATED[kind](*(a.value for a in node.args))
        return node

    def array(self, values: np.ndarray) -> np.ndarray:
        """Return an array of run-time inputs of the given values."""
        return np.array([self.new("input", (), float(x)) for x in values], dtype=object)

    def count(self, outputs: np.ndarray) -> Counter[str]:
        """Return how many operations of each kind the outputs need."""
        needed = program_of(self, (), [(outputs.shape, [as_node(self, x) for x in outputs.flat])])
        counts: Counter[str] = Counter()
        for kind, n in needed.counts.items():
            if kind in KINDS or kind in CHOICES:
                counts[KINDS.get(kind, "select")] += n
        counts["total"] = sum(counts[kind] for kind in set(KINDS.values()))
        return counts


def generic_arm(seed: int, joint_count: int) -> Arm:
    """Return an arm with no special directions or zeros: one prismatic joint, then revolute ones."""
    random = np.random.default_rng(seed)
    joints, links = [], []
    for k in range(joint_count):
        axis = random.standard_normal(3)
        placement = Pose(rotation.exp(random.uniform(0.3, 1.0, 3)), random.uniform(0.1, 0.4, 3))
        kind = "revolute" if k else "prismatic"
        joints.append(Joint(kind, axis / np.linalg.norm(axis), placement, armature=0.1, damping=0.1))
        root = random.uniform(0.1, 0.5, (3, 3)) + np.eye(3)
        inertia = root @ root.T
        links.append(Link(random.uniform(1, 5), random.uniform(0.05, 0.2, 3), inertia, physical=False))
    tip = Pose(rotation.exp(random.uniform(0.3, 1.0, 3)), random.uniform(0.1, 0.3, 3))
    base = Pose(rotation.exp(random.uniform(0.3, 1.0, 3)), random.uniform(0.1, 0.3, 3))
    return Arm(joints, links, tip, base)


def generic_trunk(joint_count: int, *, floating: bool) -> Trunk:
    """Return a trunk of such joints; its base, or what floats in its place, is the same for every length."""
    below = generic_arm(97, 1)
    if floating and not joint_count:
        return Trunk(floating=below.links[0])
    serial = generic_arm(98, joint_count)
    return Trunk(serial.joints, serial.links, below.base, below.links[0] if floating else None)


def generic_chain(
    arm_count: int, joint_count: int, kind: str, trunk: Trunk | None = None, in_world: int = 0
) -> ClosedChain:
    """Return a chain of such arms; it need not close, only be counted.

    Args:
        arm_count: arms.
        joint_count: joints of each.
        kind: of every grasp.
        trunk: on whose last body the arms stand, or None.
        in_world: how many of them stand in the world for all that.
    """
    random = np.random.default_rng(99)
    arms = {f"arm{i}": generic_arm(i, joint_count) for i in range(arm_count)}
    grasps = {
        name: Grasp(kind, Pose(rotation.exp(random.uniform(0.3, 1.0, 3)), random.uniform(0.1, 0.4, 3)))  # type: ignore[arg-type]
        for name in arms
    }
    root = np.random.default_rng(7).uniform(0.1, 0.5, (3, 3)) + np.eye(3)
    held = HeldObject(3.0, root @ root.T, np.array([0.1, 0.2, 0.3]), physical=False)
    if trunk is None:
        return ClosedChain(arms, held, grasps)
    last = trunk.joint_count - 1 if trunk.joint_count else BASE
    return ClosedChain(arms, held, grasps, trunk=trunk, mounts=dict.fromkeys([*arms][in_world:], last))


def two_pandas() -> ClosedChain:
    """Return the chain of the headline benchmark: two pandas, a box, rigid grasps."""
    arms = {"left": ROBOTS["panda"](), "right": ROBOTS["panda"]().at(Pose.translation(1.0, 0.0, 0.0))}
    side = {"left": Pose.translation(-0.2, 0.0, 0.0), "right": Pose.translation(0.2, 0.0, 0.0)}
    return ClosedChain(arms, HeldObject.box(3.0, 0.4, 0.3, 0.2), {n: Grasp("rigid", f) for n, f in side.items()})


def floating_base(graph: CountingGraph) -> list[np.ndarray]:
    """Return pose and twist of a floating base, run-time inputs."""
    random = np.random.default_rng(4)
    quaternion = rotation.quaternion_exp(random.uniform(0.3, 1.0, 3))
    pose, twist = np.r_[quaternion, random.uniform(0.3, 1.0, 3)], random.uniform(0.3, 1.0, 6)
    return [graph.array(pose), graph.array(twist)]


def operations(chain: ClosedChain, method: str, route: str = "recursive") -> tuple[Counter[str], int]:
    """Return the counts of one method on a chain, and how often it branched on a value."""
    graph = CountingGraph()
    random = np.random.default_rng(3)
    n = chain.joint_count
    quaternion = rotation.quaternion_exp(random.uniform(0.3, 1.0, 3))
    state = State(
        graph.array(random.uniform(0.3, 1.0, n)),
        graph.array(random.uniform(0.3, 1.0, n)),
        graph.array(np.r_[quaternion, random.uniform(0.3, 1.0, 3)]),
        graph.array(random.uniform(0.3, 1.0, 6)),
        *(floating_base(graph) if chain.floats else []),
    )
    motion = chain_motion(chain, state, graph.array(random.uniform(0.3, 1.0, n)), Inputs().shaped(chain))
    before = graph.branches
    solution = sequential(motion, route) if method == "sequential" else METHODS[method].solve(motion)  # type: ignore[arg-type]
    outputs = [*solution.qdd, *solution.wrenches, solution.object_acceleration, *(solution.base_wrenches or [])]
    if solution.trunk is not None:
        outputs += [solution.trunk.qdd, np.zeros(0) if solution.trunk.base is None else solution.trunk.base]
    return graph.count(np.concatenate(outputs)), graph.branches - before


def total(arm_count: int, joint_count: int, method: str, kind: str = "rigid", route: str = "recursive") -> int:
    """Return the total count on generic arms."""
    return operations(generic_chain(arm_count, joint_count, kind), method, route)[0]["total"]


def on_trunk(
    arm_count: int, joint_count: int, trunk_joints: int, kind: str, *, floating: bool = False, in_world: int = 1
) -> int:
    """Return the total count of `sequential` on generic arms on the last body of a generic trunk, one in the world.

    That arm comes last, when all joints of the trunk have been crossed.
    """
    trunk = generic_trunk(trunk_joints, floating=floating)
    return operations(generic_chain(arm_count, joint_count, kind, trunk, in_world), "sequential")[0]["total"]


def departures(sizes: list[int], counts: list[int]) -> int:
    """Return the largest departure of the counts from the line through the first two (0: exactly linear)."""
    slope, rest = divmod(counts[1] - counts[0], sizes[1] - sizes[0])
    return max(abs(c - counts[0] - slope * (x - sizes[0])) for x, c in zip(sizes, counts, strict=True)) + rest


def report() -> str:
    """Return the tables as Markdown."""
    lines = [
        "# Operation counts",
        "",
        "Generated by `make counts` (`benchmarks/operation_counts.py`) from the algorithms' own code: additions,",
        "multiplications, divisions, roots and sines that the outputs need, in the compiler's graph: constants are",
        "folded, and equal subexpressions are shared, also those that differ only in sign. Generic arms; model",
        "constant; q, qd, tau, object pose and twist are inputs. Rigid grasps unless said; `sequential` by its",
        "recursive route (the mass-matrix route is compared below).",
        "",
        "## Every method",
        "",
        "| method | cost | 2 x 7 | 4 x 7 | 8 x 7 | 2 x 14 | 2 x 28 |",
        "|---|---|---|---|---|---|---|",
    ]
    sizes = [(2, 7), (4, 7), (8, 7), (2, 14), (2, 28)]
    for name, method in METHODS.items():
        cells = " | ".join(f"{total(l, N, name):,}" for l, N in sizes)
        lines.append(f"| `{name}` | {method.cost} | {cells} |")

    lines += [
        "",
        "## `sequential`: linear in joints and arms",
        "",
        "The arms have six joints or more, so that they can follow every motion of the object; shorter arms cost less.",
        "",
    ]
    for kind in GRASP_KINDS:
        joints, arms = range(6, 63, 7), (3, 4, 5, 6, 10, 20, 39, 40)
        by_joints = [total(2, N, "sequential", kind) for N in joints]
        by_arms = [total(l, 5, "sequential", kind) for l in arms]
        lines.append(
            f"* {kind}: 2 arms, N = 6, 13 .. 62: {by_joints[0]:,} .. {by_joints[-1]:,}, departure from a straight line"
            f" {departures(list(joints), by_joints)}; N = 5, l = 3 .. 40: {by_arms[0]:,} .. {by_arms[-1]:,}, departure"
            f" {departures(list(arms), by_arms)}"
        )
    lines += [
        "",
        "## `sequential` on a trunk: linear in its joints too",
        "",
        "Three arms of 6 joints unless said, two on the trunk's last body and one in the world. Grasps that do not",
        "hold rigidly keep the mobility in 6 to 12 factors, one more with every joint crossed, so lengths seven apart",
        "are compared.",
        "",
    ]
    for kind in GRASP_KINDS:
        for floating, lengths in ((False, range(7, 29, 7)), (True, range(2, 24, 7))):
            counts = [on_trunk(3, 6, m, kind, floating=floating) for m in lengths]
            below = "floating base and" if floating else "trunk of"
            lines.append(
                f"* {kind}, {below} {lengths[0]}, {lengths[1]} .. {lengths[-1]}"
                f" joints: {counts[0]:,} .. {counts[-1]:,}, departure {departures(list(lengths), counts)}"
            )
        arms, joints = range(3, 13), range(7, 29, 3)
        by_arms, by_joints = [on_trunk(l, 5, 7, kind) for l in arms], [on_trunk(3, N, 7, kind) for N in joints]
        lines.append(
            f"* {kind}, trunk of 7 joints: N = 5, l = 3 .. 12: {by_arms[0]:,} .. {by_arms[-1]:,}, departure"
            f" {departures(list(arms), by_arms)}; N = 7, 10 .. 28: {by_joints[0]:,} .. {by_joints[-1]:,}, departure"
            f" {departures(list(joints), by_joints)}"
        )
    third = np.diff([total(l, 6, "rccfd2") for l in range(3, 9)], 3)
    lines += [
        "",
        "## The paper's recursions: cubic in arms",
        "",
        f"* `rccfd2`, N = 6, l = 3 .. 8: third differences {sorted(set(third.tolist()))} (a cubic's are constant)",
        "",
        "## Routes of one arm",
        "",
        "| joints | mass_matrix | recursive |",
        "|---|---|---|",
    ]
    for N in (4, 6, 7, 8, 10, 12, 14, 16, 24):
        lines.append(
            f"| {N} | {total(2, N, 'sequential', route='mass_matrix') // 2:,} | {total(2, N, 'sequential') // 2:,} |"
        )
    pandas = {route: operations(two_pandas(), "sequential", route) for route in ("mass_matrix", "recursive")}
    lines += [
        "",
        "## Two pandas and a box, all outputs",
        "",
        *(
            f"* `{route}`: {counts['total']:,} operations"
            f" ({', '.join(f'{counts[k]:,} {k}' for k in ('add', 'mul', 'div', 'sqrt', 'trig', 'select'))}),"
            f" {branches} branches on values"
            for route, (counts, branches) in pandas.items()
        ),
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Print the tables, or write them to a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, default=None)
    path = parser.parse_args().write
    text = report()
    assert HOME  # the built-in robots are there
    if path is None:
        print(text)
    else:
        path.write_text(text)
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
