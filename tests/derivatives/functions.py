"""Functions that solve nothing, at problems of all kinds, and the problems a little along their arguments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.inverse import trunk_torques
from holdfast.model.grasp import WrenchLimits
from holdfast.model.joint import Joint
from holdfast.questions.arrays import ARRAYS
from holdfast.questions.question import QUESTIONS, Question
from tests.derivatives.blocks import as_direction, flat_direction, names_for, size_of
from tests.derivatives.moved import moved_problem
from tests.questions.every import asked, case_of, computed, differentiable
from tests.systems.as_chain import Problem
from tests.systems.bushed import random_bushed
from tests.systems.lower_pairs import grasp_of
from tests.systems.problems import random_problem
from tests.systems.sprung import with_springs
from tests.systems.trunk_problems import on_trunk

FIVE_POINTS = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
STEP = 1e-3
OWN = ("qdd", "grasp_wrench", "floating_acceleration")  # what problems do not have
KINDS = ("plain", "springs", "bushing", "trunk", "floating")
LIMITED = ("limits", "trunk", "floating")
CASES = [(name, kind) for name in differentiable() for kind in (LIMITED if QUESTIONS[name].unlimited else KINDS)]


class FunctionCase(NamedTuple):
    """A function at a problem.

    Attributes:
        name: its name.
        p: the problem.
        own: what it is given besides, by name.
        result: forward dynamics, of the function that takes it with the wrenches in `own`.
    """

    name: str
    p: Problem
    own: Mapping[str, np.ndarray]
    result: Any = None

    @property
    def question(self) -> Question:
        """The question that it answers."""
        return QUESTIONS[self.name]

    @property
    def results(self) -> tuple[str, ...]:
        """The names of what it returns."""
        return self.question.names

    @property
    def by(self) -> tuple[str, ...]:
        """All of its arguments."""
        return self.question.arguments_at(self.p.chain)

    def called(self, kind: str = "", **options: Any) -> Any:
        """Return what the function, or one of its derivatives, returns."""
        p, given = self.p, {"tau": self.p.tau, **self.own}
        if self.result is not None:
            given["result"] = replace(self.result, grasp_wrench=self.own["grasp_wrench"])
        return asked(self.name, p.chain, p.state, p.inputs, given, kind, **options)

    def values(self) -> dict[str, np.ndarray]:
        """Return its results by name."""
        p, given = self.p, {"tau": self.p.tau, **self.own}
        return computed(self.question, case_of(self.question, p.chain, p.state, p.inputs, given))

    def directions(self, random: np.random.Generator) -> dict[str, np.ndarray]:
        """Return a direction of every argument; wrenches that are not the caller's to choose stay."""
        names = [name for name in self.by if name not in OWN]
        found = {name: as_direction(self.p, name, random.normal(size=size_of(self.p, name))) for name in names}
        return found | {name: random.normal(size=x.shape) * (x != 0.0) for name, x in self.own.items()}

    def moved(self, along: Mapping[str, np.ndarray], far: float) -> FunctionCase:
        """Return the same with some arguments displaced."""
        own = {name: x + far * along[name] if name in along else x for name, x in self.own.items()}
        flat = {name: flat_direction(self.p, name, far * x) for name, x in along.items() if name not in OWN}
        return with_base_wrench(self._replace(own=own, p=displaced(self.p, flat) if flat else self.p))

    def differences(self, along: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return how fast the results change along some arguments, by five points; what is infinite does not."""
        size = max(1.0, *(float(np.abs(x).max(initial=0.0)) for x in along.values()))
        far = [self.moved(along, k * STEP / size).values() for k in FIVE_POINTS]
        finite = [{name: np.where(np.isinf(x), 0.0, x) for name, x in one.items()} for one in far]
        return {
            of: sum(w * one[of] for w, one in zip(FIVE_POINTS.values(), finite, strict=True)) * size / STEP
            for of in self.results
        }


def with_base_wrench(of: FunctionCase) -> FunctionCase:
    """Return inverse dynamics with the external wrench on a floating base that lets it accelerate so.

    The drives do not feel that wrench.
    """
    if "floating_acceleration" not in of.own:
        return of
    p, own = of.p, of.own
    motion = chain_motion(p.chain, p.state, np.zeros(p.chain.joint_count), p.inputs.shaped(p.chain))
    lacking = trunk_torques(motion, own["qdd"], own["grasp_wrench"], own["floating_acceleration"]).base
    pushes = np.array(p.inputs.shaped(p.chain).trunk_link_wrenches)
    pushes[0] += lacking
    return of._replace(p=replace(p, inputs=replace(p.inputs, trunk_link_wrenches=pushes)))


def displaced(p: Problem, by: Mapping[str, Any]) -> Problem:
    """Return a problem with some arguments displaced, by name, flat."""
    names = names_for(p)
    ends = np.cumsum([0, *(size_of(p, x) for x in names)])
    at = {x: slice(a, b) for x, a, b in zip(names, ends, ends[1:], strict=False)}
    along = np.zeros(ends[-1])
    for name, flat in by.items():
        along[at[name]] = flat
    return moved_problem(p, at, along)


@cache
def problem(kind: str) -> Problem:
    """Return a problem of a kind.

    Args:
        kind: "plain", arms that hold rigidly and by a ball, on moving bases; "springs", these with springs; "bushing",
            one holds by a bushing; "trunk" and "floating", arms on a trunk and in the world, with springs; "limits",
            fingers with friction, a strong enough grip, one without limit, and limited joints.
    """
    arms = {"joints": (4, 6, 2), "grasps": ("rigid", "ball", None)}
    if kind == "bushing":
        return displaced(random_bushed(2), {"armature": 0.1, "damping": 0.1})  # none is on the bound, at 0
    if kind == "limits":
        return _limited(random_problem(3, joints=(6, 4, 6, 2), grasps=("softfinger", "ball", "rigid", None)))
    if kind in ("trunk", "floating"):
        p = on_trunk(random_problem(3, moving_base=False, **arms), 4, 2, floating=kind == "floating", in_world=0.4)
        return replace(p, chain=with_springs(p.chain))
    p = random_problem(3, moving_base=True, **arms)
    return p if kind == "plain" else replace(p, chain=with_springs(p.chain))


def _limited(p: Problem) -> Problem:
    first, second, third = p.chain.grasps.items()
    grasps = {
        first[0]: replace(first[1], contact=hf.Friction(0.6, torsion_radius=0.02)),
        second[0]: replace(second[1], wrench_limits=WrenchLimits(force=20.0, moment=3.0)),
        third[0]: third[1],
    }

    def limited(joint: Joint, k: int) -> Joint:
        ranges = [(-7.0, 9.0), (-np.inf, 8.0), (-np.inf, np.inf)]
        return replace(joint, position_limits=ranges[k % 3], rate_limit=(2.0, np.inf)[k % 2], effort_limit=30.0)

    arms = {
        name: replace(arm, joints=[limited(joint, k) for k, joint in enumerate(arm.joints)])
        for name, arm in p.chain.arms.items()
    }
    return replace(p, chain=replace(p.chain, arms=arms, grasps=grasps))


def function_case(name: str, kind: str) -> FunctionCase:
    """Return a function at one of the problems: accelerations at random, and wrenches that forward dynamics finds.

    Wrenches beside accelerations are at random, too.
    """
    return function_at(name, problem(kind), np.random.default_rng(5))


def function_at(name: str, p: Problem, random: np.random.Generator) -> FunctionCase:
    """Return a function at a problem; see `function_case`."""
    names, result = [x for x in QUESTIONS[name].own(p.chain) if x in OWN], None
    own = {x: random.normal(size=ARRAYS[x].shape(p.chain)) for x in names}
    if "qdd" in own:
        free = [arm not in p.chain.grasps or p.chain.grasps[arm].kind == "bushing" for arm in p.chain.arms]
        own["grasp_wrench"] = np.where(np.array(free)[:, None], 0.0, own["grasp_wrench"])
    elif "grasp_wrench" in own:
        result = hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
        own["grasp_wrench"] = result.grasp_wrench
    return with_base_wrench(FunctionCase(name, p, own, result))


def open_grasp(kind: str) -> FunctionCase:
    """Return the closure of two arms, one of which holds by a kind of grasp, far from closed."""
    p, random = random_problem(5, joints=(6, 5), grasps=("ball", "rigid"), moving_base=True), np.random.default_rng(6)
    name = p.chain.names[1]
    chain = p.chain.without_grasp(name).with_grasp(name, grasp_of(kind, p.chain.grasps[name].frame))
    loose = replace(p, chain=chain, state=replace(p.state, q=p.state.q + 0.3 * random.normal(size=chain.joint_count)))
    return FunctionCase("closure", displaced(loose, {"qd": random.normal(size=chain.joint_count)}), {})
