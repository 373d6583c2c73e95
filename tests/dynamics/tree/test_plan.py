"""The plan of a forest: parts, roots, order and width, from topology alone."""

from __future__ import annotations

import json
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from holdfast.dynamics.tree.forest_kkt import independent_rows_of
from holdfast.dynamics.tree.forest_motion import forest_motion
from holdfast.dynamics.tree.forest_rows import forest_rows
from holdfast.dynamics.tree.order import (
    ROOT,
    AddFree,
    CloseFrame,
    Couple,
    Cross,
    Measure,
    MeasureLeaf,
    MeasureLeaves,
    MoveFrame,
    widest,
)
from holdfast.dynamics.tree.plan import Condense, Settle, plan_of
from holdfast.io.case_file import load_cases
from holdfast.model.forest import GROUND, Forest, Topology
from tests.systems.problems import random_problem
from tests.systems.random_forests import random_forest

FILE = Path(__file__).parents[2] / "data" / "cases_tree.json"


@cache
def cases() -> list:
    """Return the stored forests, each with its notes."""
    notes = [case["tags"] for case in json.loads(FILE.read_text(encoding="utf-8"))["cases"]]
    return list(zip(load_cases(FILE), notes, strict=True))


def graph(parents: list[int], free: set[int] = frozenset(), ends=(), coupled=()) -> Topology:
    """Return a graph."""
    return Topology(tuple(parents), tuple(k in free for k in range(len(parents))), tuple(ends), tuple(coupled))


def chain(parents: list[int], start: int, count: int) -> int:
    """Add a chain of bodies and return the last."""
    for _ in range(count):
        parents.append(start)
        start = len(parents) - 1
    return start


def test_one_object():
    """One object with arms in the world is today's program: the object, its arms as leaves, nothing else open."""
    p = random_problem(2, arms=4)
    plan = plan_of(p.chain.forest.topology)
    held = p.chain.joint_count
    (part,), (steps,) = plan.parts, plan.steps
    assert part.root == GROUND and part.closures == (0, 1, 2, 3)
    joints = p.chain.joints
    leaves = [
        MeasureLeaf(None, tuple(range(joints[name].start, joints[name].stop)), i, False, 0)
        for i, name in enumerate(p.chain.grasps)
    ]
    assert steps == (AddFree(held, 0), MeasureLeaves(tuple(leaves), CloseFrame(0, held)))
    assert widest(steps) == 6


def test_feet_and_box():
    """Feet on the ground and a box in the hands: two parts, at the chest and at the world, each six numbers wide."""
    parents = [-1, -1]  # pelvis, box
    feet = [chain(parents, 0, 6) for _ in range(2)]
    chest = chain(parents, 0, 3)
    hands = [chain(parents, chest, 7) for _ in range(2)]
    ends = [(-1, foot) for foot in feet] + [(hand, 1) for hand in hands]
    plan = plan_of(graph(parents, {0, 1}, ends))
    by_root = {part.root: (part, steps) for part, steps in zip(plan.parts, plan.steps, strict=True) if steps}
    assert sorted(by_root) == [GROUND, chest]
    assert by_root[chest][0].closures == (2, 3) and by_root[GROUND][0].closures == (0, 1)
    assert all(widest(steps) == 6 for _, steps in by_root.values())


def test_hands_on_a_torso():
    """Fingers of two hands on one object settle at the torso, with the object and one palm open."""
    parents = [-1, -1]  # object, torso on a joint
    fingers = [chain(parents, palm, 2) for palm in (chain(parents, 1, 3), chain(parents, 1, 3)) for _ in range(3)]
    plan = plan_of(graph(parents, {0}, [(finger, 0) for finger in fingers]))
    (root,) = (part.root for part in plan.parts if part.closures)
    assert root == 1
    assert max(map(widest, plan.steps)) == 12


def test_loop_inside_an_arm():
    """A parallelogram in an arm that holds nothing settles on the link that it stands on."""
    parents = [-1]
    crank, rocker = chain(parents, 0, 1), chain(parents, 0, 1)
    coupler = chain(parents, crank, 1)
    chain(parents, coupler, 3)
    plan = plan_of(graph(parents, ends=[(coupler, rocker)]))
    assert [part.root for part in plan.parts if part.closures] == [0]


@pytest.mark.parametrize("count", [4, 8, 16])
def test_ring_of_torsos(count):
    """A ring of floating torsos and objects keeps 12 numbers open, however long it is."""
    parents, ends = [-1] * (2 * count), []
    for i in range(count):
        ends += [(chain(parents, i, 2), count + i), (chain(parents, i, 2), count + (i + 1) % count)]
    plan = plan_of(graph(parents, set(range(2 * count)), ends))
    assert max(map(widest, plan.steps)) == 12


@pytest.mark.slow
def test_every_step_once():
    """Every closure and coupling is imposed once, and every body settles once, after all that hangs on it."""
    forests = [case.forest for case, _ in cases()] + [random_forest(seed).forest for seed in range(60)]
    for forest in forests:
        for leaves in (True, False):
            plan, topology = plan_of(forest.topology, leaves), forest.topology
            imposed = Counter(
                (type(step) is Couple, step.coupling if isinstance(step, Couple) else step.closure)
                for steps in plan.steps
                for several in steps
                for step in (several.leaves if isinstance(several, MeasureLeaves) else [several])
                if isinstance(step, Measure | MeasureLeaf | Couple)
            )
            assert imposed == Counter(
                [(False, i) for i in range(len(forest.closures))] + [(True, i) for i in range(len(forest.couplings))]
            )
            done: list[int] = []
            for step in plan.inward:
                if isinstance(step, Settle):
                    assert all(k in done for k, parent in enumerate(topology.parents) if parent == step.body)
                    done.append(step.body)
                else:
                    assert isinstance(step, Condense)
                    done += [one.body for one in plan.steps[step.part] if isinstance(one, Cross)]
                    assert {*plan.parts[step.part].members} <= {*done}
            assert sorted(done) == list(range(len(forest.bodies)))


@pytest.mark.slow
def test_only_free_bodies_are_open_where_the_root_moves():
    """Neither a palm nor a noted joint is open; a coupling with what stays behind forbids the crossing."""
    for seed in (*range(60), 699):
        for steps in plan_of(random_forest(seed).forest.topology).steps:
            free, opened = set(), set()
            for step in steps:
                match step:
                    case AddFree():
                        free.add(step.frame)
                        opened.add(step.frame)
                    case MeasureLeaves(closes=CloseFrame(frame)) | CloseFrame(frame):
                        opened.remove(frame)
                    case Cross():
                        assert opened <= free
                    case _:
                        own = (getattr(step, "frame", None), getattr(step, "note", None))
                        opened |= {frame for frame in own if frame is not None}


@pytest.mark.slow
def test_frames_are_open_where_they_are_used():
    """A step names only frames that are open, and nothing stays open."""
    for seed in range(60):
        for steps in plan_of(random_forest(seed).forest.topology, False).steps:
            opened: set[int] = set()
            for step in steps:
                used = [getattr(step, name) for name in ("of", "a", "b", "other") if hasattr(step, name)]
                assert all(frame in (None, ROOT) or frame in opened for frame in used)
                match step:
                    case MoveFrame():
                        assert step.frame in opened
                        opened |= set() if step.note is None else {step.note}
                    case CloseFrame():
                        opened.remove(step.frame)
                    case Measure() | Couple():
                        pass
                    case _:
                        opened.add(step.frame)
            assert not opened


def test_width_of_stored_forests():
    """As many numbers are open as the search of whoever stored the forests found."""
    for case, notes in cases():
        steps = plan_of(case.forest.topology).steps
        assert max(map(widest, steps)) == notes["widest_state"], case.name


def test_parts_lose_no_rank():
    """The rank of the whole is the sum of the ranks of the parts with their roots locked, and as many are counted."""
    for case, notes in cases():
        forest = case.forest
        motion = forest_motion(forest, case.q, 0 * case.qd, 0 * case.qd, 0 * case.wrenches)
        rows, plan, total = forest_rows(motion), plan_of(forest.topology), 0
        for part in plan.parts:
            own = [i for k in part.closures for i in range(rows.closures[k].start, rows.closures[k].stop)]
            own += [rows.couplings[k] for k in part.couplings]
            inside = np.zeros(forest.velocity_count)
            for k in part.members:
                inside[forest.velocities[k]] = 1.0
            G = np.zeros_like(rows.G)
            G[own] = rows.G[own] * inside
            total += len(independent_rows_of(motion, rows._replace(G=G))) if own else 0
        assert total == len(independent_rows_of(motion, rows)) == notes["rank"], case.name


def test_same_graph_same_plan():
    """The plan belongs to the topology: another forest with the same graph does not search again."""
    p = random_forest(4)
    lighter = Forest(p.forest.bodies, p.forest.closures, p.forest.couplings, np.zeros(3))
    assert plan_of(p.forest.topology) is plan_of(lighter.topology)
