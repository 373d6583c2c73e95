"""The order of the steps in which a part is eliminated, and the steps as data.

The state of the elimination consists of the accelerations of open frames, which are added, moved outward over joints,
measured by closures, and left out again. Of all ways on, the one after which the fewest numbers are open comes next
(least front). Numbers of frames identify them within their part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeGuard

from holdfast.dynamics.tree.branches import Branches, ForestPart
from holdfast.model.forest import GROUND, Topology

ROOT = -1  # "frame" of the root, whose acceleration is given; GROUND in `OpenFrame.of` is written as None


class AddFree(NamedTuple):
    """A frame opens at a free body."""

    body: int
    frame: int


class OpenFrame(NamedTuple):
    """A frame opens at a body as a copy of an open frame, of the root (`ROOT`), or of the world (None)."""

    of: int | None
    frame: int


class MoveFrame(NamedTuple):
    """A frame moves outward over the joint of a body; `note` is the frame that its accelerations open, or None."""

    body: int
    frame: int
    note: int | None


class Measure(NamedTuple):
    """A closure is imposed; its ends are open frames, `ROOT` or the world (None)."""

    closure: int
    a: int | None
    b: int | None


class Couple(NamedTuple):
    """A coupling is imposed; per coupled body, the frame of its joint accelerations."""

    coupling: int
    noted: tuple[tuple[int, int], ...]


class MeasureLeaf(NamedTuple):
    """A closure is imposed at the end of a chain of joints that nothing else needs.

    Attributes:
        of: the frame from which the chain leads outward, `ROOT`, or the world (None).
        joints: the bodies of the chain.
        closure: the closure.
        is_b: whether the end of the chain is the closure's body b.
        other: the frame of the closure's other body, `ROOT` or the world (None).
    """

    of: int | None
    joints: tuple[int, ...]
    closure: int
    is_b: bool
    other: int | None


class MeasureLeaves(NamedTuple):
    """Leaves one after the other; with the last of them a free body may leave, if nothing else is open."""

    leaves: tuple[MeasureLeaf, ...]
    closes: CloseFrame | None

    @property
    def leaving(self) -> int:
        """The free body that leaves with the last of them."""
        assert self.closes is not None and self.closes.body is not None
        return self.closes.body


class Cross(NamedTuple):
    """The root moves inward over the joint of a body, on which all that was measured hangs; only free bodies are open.

    If the body is free, the root moves to the world.
    """

    body: int


class CrossAll(NamedTuple):
    """The root moves to the world over several joints together; the part's columns are their rates.

    Attributes:
        bodies: their bodies, from the world outward.
    """

    bodies: tuple[int, ...]


class CloseFrame(NamedTuple):
    """A frame is left out; `body` is the free body that has stayed at it, or None."""

    frame: int
    body: int | None


PlanStep = AddFree | OpenFrame | MoveFrame | Measure | Couple | MeasureLeaves | Cross | CrossAll | CloseFrame


def widest(steps: Sequence[PlanStep]) -> int:
    """Return the most numbers that are open at a time; the accelerations of a coupled joint count as one."""
    size: dict[int, int] = {}
    most = 0
    for step in steps:
        match step:
            case AddFree() | OpenFrame():
                size[step.frame] = 6
            case MoveFrame() if step.note is not None:
                size[step.note] = 1
            case CloseFrame():
                del size[step.frame]
            case MeasureLeaves(closes=CloseFrame(frame)):
                del size[frame]
        most = max(most, sum(size.values()))
    return most


@dataclass(frozen=True)
class Front:
    """The search after some steps; `way` returns it after further ones.

    Attributes:
        of: the part's branches.
        steps: the steps so far.
        frames: open frames, the youngest last, by body; those of joint accelerations by (body,).
        next_frame: number of the next frame.
        closures, couplings: those that have not been imposed.
        root: the vertex whose acceleration is given at present.
        ahead: by vertex, the children to which no frame has moved.
        added: the free bodies that have been added.
        firm: vertices that do not move freely: what was closed with the root, the world, or a body on joints.
        loose: number of closures between two free bodies of which none was firm.
    """

    of: Branches
    steps: tuple[PlanStep, ...]
    frames: dict[int | tuple[int], int]
    next_frame: int
    closures: frozenset[int]
    couplings: frozenset[int]
    root: int
    ahead: dict[int, frozenset[int]]
    added: frozenset[int] = frozenset()
    firm: frozenset[int] = field(default_factory=frozenset)
    loose: int = 0

    @property
    def width(self) -> int:
        """Number of open numbers."""
        return sum(6 if isinstance(of, int) else 1 for of in self.frames)

    @property
    def measured(self) -> int:
        """Number of closures and couplings that have been imposed."""
        return sum(isinstance(step, Measure | Couple) for step in self.steps)

    def frame(self, vertex: int) -> int | None:
        """Return the frame at a vertex, `ROOT`, or None for the world."""
        if vertex in self.frames:
            return self.frames[vertex]
        return ROOT if vertex == self.root and vertex != GROUND else None

    def at(self, vertex: int) -> bool:
        """Return whether the acceleration of a vertex is in the state, or given."""
        return vertex in self.given or vertex in self.frames

    @property
    def given(self) -> tuple[int, ...]:
        """The vertices whose accelerations are given: the root, and the world unless the root has to move inward."""
        return (self.root, GROUND) if self.root == self.of.part.root else (self.root,)

    def ways(self) -> list[tuple[int | None, int]]:
        """Return the ways on: from a vertex to a child, or None and a free body to add."""
        tops = [*self.given, *(v for v in self.frames if isinstance(v, int))]
        found = [(v, k) for v in dict.fromkeys(tops) for k in sorted(self.ahead.get(v, ()))]
        if self.root == self.of.part.root:
            needed = {*self.of.part.members}
        else:
            needed = {v for i in self.closures if self._hangs(i) for v in self.of.topology.ends[i]}
        free = [k for k in self.of.part.members if self.of.topology.free[k] and k not in self.added and k in needed]
        return [*found, *((None, k) for k in sorted(free))]

    def _hangs(self, closure: int) -> bool:
        """Return whether an end of a closure hangs on the present root."""
        return any(self.root in self.of.above(v) for v in self.of.topology.ends[closure] if v != GROUND)

    def crossed(self) -> Front:
        """Return the front after the root has moved inward over its joint."""
        parent = self.of.topology.parents[self.root]
        now = replace(self, steps=(*self.steps, Cross(self.root)), root=parent)
        return now._closed()

    def way(self, start: int | None, k: int) -> Front:
        """Return the front after a way from a vertex along the joints to the next body that matters."""
        now = self._added(k) if start is None else self._moved(start, k)
        return now._closed()

    def _added(self, k: int) -> Front:
        new = self.next_frame
        return replace(
            self,
            steps=(*self.steps, AddFree(k, new)),
            frames={**self.frames, k: new},
            next_frame=new + 1,
            added=self.added | {k},
        )

    def _moved(self, start: int, k: int) -> Front:
        of, steps, frames, new = self.of, list(self.steps), dict(self.frames), self.next_frame
        ahead = {**self.ahead, start: self.ahead[start] - {k}}
        own = start in frames and not of.topology.free[start] and not ahead[start]
        if own and not any(i in self.closures for i in of.closures_at[start]):
            frame = frames.pop(start)  # nothing else needs it: it moves on
        else:
            frame, new = new, new + 1
            steps.append(OpenFrame(self.frame(start), frame))
        while True:
            note = None
            if of.noted[k]:
                note, new = new, new + 1
                frames[(k,)] = note
            steps.append(MoveFrame(k, frame, note))
            if of.closures_at[k] or of.noted[k] or len(ahead[k]) != 1:
                break
            (following,) = ahead[k]
            ahead[k] = frozenset()
            k = following
        frames[k] = frame
        return replace(self, steps=tuple(steps), frames=frames, next_frame=new, ahead=ahead)

    def _closed(self) -> Front:
        """Return the front after imposing all closures and couplings that can be, and leaving out frames."""
        of, steps, frames, firm, loose = self.of, list(self.steps), dict(self.frames), set(self.firm), self.loose
        done = [i for i in sorted(self.closures) if all(self.at(v) for v in of.topology.ends[i])]
        for i in done:
            ends = of.topology.ends[i]
            held = any(v in firm or v == GROUND or not of.topology.free[v] for v in ends)
            firm, loose = (firm | {*ends}, loose) if held else (firm, loose + 1)
            steps.append(Measure(i, *map(self.frame, ends)))
        coupled = [i for i in sorted(self.couplings) if all((k,) in frames for k in of.topology.coupled[i])]
        steps += [Couple(i, tuple((k, frames[(k,)]) for k in of.topology.coupled[i])) for i in coupled]
        closures, couplings = self.closures - {*done}, self.couplings - {*coupled}
        for at in reversed(list(frames)):  # the youngest first, so that a leaf closes at once
            needed = (
                closures & {*of.closures_at[at]} or self.ahead[at]
                if isinstance(at, int)
                else (couplings & {*of.noted[at[0]]})
            )
            if not needed:
                free = isinstance(at, int) and of.topology.free[at]
                steps.append(CloseFrame(frames.pop(at), at if isinstance(at, int) and free else None))
        return replace(
            self,
            steps=tuple(steps),
            frames=frames,
            closures=closures,
            couplings=couplings,
            firm=frozenset(firm),
            loose=loose,
        )

    def absorbed(self) -> Front:
        """Return the front after all ways that close again what they open: leaves between open frames."""
        now = self
        while True:
            tried = (now.way(v, k) for v, k in now.ways() if v is not None)
            better = next((t for t in tried if t.measured > now.measured and t.width <= now.width), None)
            if better is None:
                return now
            now = better


def ordered(
    topology: Topology, part: ForestPart, leaves: bool = True, trunk: Sequence[int] | None = None, rates: bool = False
) -> tuple[PlanStep, ...]:
    """Return the steps of a part: always the way after which the fewest numbers are open.

    Args:
        topology: the forest's graph.
        part: the part.
        leaves: whether chains to one closure are one step.
        trunk: bodies over which the root moves, even if only one closure needs them; a closure of what does not move
            with a free body is a leaf without joints then. None if the part may decide.
        rates: whether the root moves over consecutive joints in one step.
    """
    if not part.closures and not part.couplings:
        own = tuple(k for k in trunk or () if k in part.members)
        return () if not own else (CrossAll(own),) if rates else tuple(map(Cross, reversed(own)))
    of = Branches.of(topology, part)
    backbone = of.backbone(trunk or ()) if leaves else []
    now = Front(
        of,
        (),
        {},
        0,
        frozenset(part.closures),
        frozenset(part.couplings),
        backbone[0] if backbone else part.root,
        {v: frozenset(ks) - {*backbone} for v, ks in of.children.items()},
        added=frozenset(k for k in backbone if topology.free[k]),
        firm=frozenset({part.root, GROUND, *backbone}),
    )
    now = _searched(now._closed())
    for _ in backbone:
        now = _searched(now.crossed())
    steps = now.steps if trunk is None else [_leaf_without_joints(step) for step in now.steps]
    steps = _with_leaves(steps, topology) if leaves else now.steps
    bodies = tuple(step.body for step in reversed(steps) if isinstance(step, Cross))
    if not (rates and bodies):
        return steps
    at = next(i for i, step in enumerate(steps) if isinstance(step, Cross))
    return *steps[:at], CrossAll(bodies), *steps[at + len(bodies) :]


def _searched(now: Front) -> Front:
    """Return the front after everything that can be reached from its root."""
    now = now.absorbed()
    while ways := now.ways():
        before, found = now.measured, []
        for start, k in ways:
            then = now.way(start, k).absorbed()
            more = then.measured - before
            found.append(((then.loose, then.width - (more > 0), -more, start is None, k), then))
        now = min(found, key=lambda one: one[0])[1]
    return now


def _with_leaves(steps: Sequence[PlanStep | MeasureLeaf], topology: Topology) -> tuple[PlanStep, ...]:
    """Return the steps with every chain that opens, moves to one closure and closes again as one step.

    What is measured at the same frames commutes; leaves come first, so that a light free body is soon held by joints.
    """
    found: list[PlanStep] = []
    i = 0
    while i < len(steps):
        step, last = steps[i], found[-1] if found else None
        leaf, count = (step, 1) if isinstance(step, MeasureLeaf) else _leaf(steps[i:], topology)
        if isinstance(leaf, MeasureLeaf):
            at = len(found)
            while at and isinstance(found[at - 1], Measure | Couple):
                at -= 1
            last = found[at - 1] if at else None
            if isinstance(last, MeasureLeaves) and last.closes is None:
                found[at - 1] = MeasureLeaves((*last.leaves, leaf), None)
            else:
                found.insert(at, MeasureLeaves((leaf,), None))
        elif isinstance(last, MeasureLeaves) and last.closes is None and _is_of_free_body(step):
            found[-1] = MeasureLeaves(last.leaves, step)
        else:
            found.append(leaf)
        i += count
    return tuple(found)


def _leaf_without_joints(step: PlanStep) -> PlanStep | MeasureLeaf:
    """Return a closure of the root or the world with a free body's frame as a leaf."""
    if isinstance(step, Measure) and step.a in (ROOT, None) and step.b not in (ROOT, None):
        return MeasureLeaf(step.a, (), step.closure, False, step.b)
    return step


def _is_of_free_body(step: PlanStep | MeasureLeaf) -> TypeGuard[CloseFrame]:
    """Return whether a step leaves out the frame of a free body."""
    return isinstance(step, CloseFrame) and step.body is not None


def _leaf(steps: Sequence[PlanStep | MeasureLeaf], topology: Topology) -> tuple[PlanStep | MeasureLeaf, int]:
    """Return the leaf with which the steps begin, or their first step, and how many steps it replaces."""
    first = steps[0]
    if not isinstance(first, OpenFrame):
        return first, 1
    j = 1
    joints: list[int] = []
    while isinstance(move := steps[j], MoveFrame) and move.frame == first.frame and move.note is None:
        joints.append(move.body)
        j += 1
    closing, measure = steps[j + 1] if j + 1 < len(steps) else None, steps[j]
    if not joints or not isinstance(measure, Measure) or closing != CloseFrame(first.frame, None):
        return first, 1
    is_b = topology.ends[measure.closure][1] == joints[-1]
    if (measure.b if is_b else measure.a) != first.frame:
        return first, 1
    return MeasureLeaf(first.of, tuple(joints), measure.closure, is_b, measure.a if is_b else measure.b), j + 2
