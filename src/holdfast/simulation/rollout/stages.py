"""What a step does besides forward dynamics and projection, as stages: slopes, stage states, margins, the verdict.

The texts are those of `simulation/step`, `runge_kutta`, `friction` and `dynamics/margins`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import numpy as np

from holdfast.compiler.errors import CompileError
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import FIRST_BAD
from holdfast.compiler.stage import Stage, stage
from holdfast.dynamics.margins import friction_conditions, least_margin, limit_conditions
from holdfast.dynamics.projection import FARTHEST, LEFT_OPEN, moved
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import GraspKind
from holdfast.simulation.friction import friction_torque, joint_friction
from holdfast.simulation.instant import WORST_CONDITION
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.runge_kutta import Tableau, rotation_vector_rate, weighted
from holdfast.simulation.step import displaced
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, minimum, select, where
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import State

# Why a system stands still, as the machine code numbers it; 0: it does not. The last is found afterwards.
RUNNING, SLIPPED, SINGULAR, OPEN, BROKEN, TOO_LONG = range(6)

# What is known of a system at the end of a step.
KEPT = (
    "q",
    "qd",
    "object_pose",
    "object_twist",
    "slope",
    "qdd",
    "object_acceleration",
    "grasp_wrench",
    "base_wrench",
    "contact_acceleration",
    "drive",
    "memory",
    "rank",
    "condition",
    "margin",
)


def stage_state(tableau: Tableau, k: int, n: int) -> Stage:
    """Return the stage of the state at the scheme's stage k, or at the step's end (k = the number of stages)."""
    last = k == len(tableau.b)
    weights = tableau.b if last else tableau.a[k]
    slopes = [f"slope{j}" for j in range(min(k, len(weights))) if weights[j] != 0.0]
    own = weights[weights != 0.0]
    when = 1.0 if last else float(tableau.c[k])

    def text(
        q: Array, qd: Array, pose: Array, twist: Array, begin: Array, count: Array, step: Array, *rest: Array
    ) -> tuple[Array, ...]:
        h: Scalar = step[()]
        *slopes, held = rest
        y = h * weighted(own, slopes)
        before = State(q, qd, pose, twist)
        there = displaced(before, y)
        pose = select(held[()] > 0.5, pose, there.object_pose)  # a turn by nothing may cost the last bit
        t = begin[()] + (count[()] + when) * h
        turn = np.zeros(3) if last else y[2 * n : 2 * n + 3]
        return there.q, there.qd, pose, there.object_twist, turn, t, y[2 * n + 12 :]

    given: dict[str, Shape] = {
        "last.q": (n,),
        "last.qd": (n,),
        "last.object_pose": (7,),
        "last.object_twist": (6,),
        "begin": (),
        "last.count": (),
        "step": (),
    }
    found = ("q'", "qd'", "object_pose'", "object_twist'", "turn", "t", "work")
    return stage(f"stage_state{k}", text, [given | dict.fromkeys(slopes, (2 * n + 16,)) | {"held": ()}], [found])


def as_it_is(n: int) -> Stage:
    """Return the stage of the state where systems are, as the end of a step has it."""

    def text(q: Array, qd: Array, pose: Array, twist: Array, begin: Array, count: Array, step: Array) -> tuple:
        return q, qd, pose, twist, np.zeros(3), begin[()] + count[()] * step[()]

    given: dict[str, Shape] = {"last.q": (n,), "last.qd": (n,), "last.object_pose": (7,), "last.object_twist": (6,)}
    given |= {"begin": (), "last.count": (), "step": ()}
    return stage("as_it_is", text, [given], [("q'", "qd'", "object_pose'", "object_twist'", "turn", "t")])


def renewed(carried: Mapping[str, Shape]) -> Stage:
    """Return the stage that gives the systems that go on new arrays for those carried."""
    count = len(carried)

    def text(code: Array, *x: Array) -> tuple[Array, ...]:
        on = code[()] < 0.5
        return tuple(select(on, new, old) for new, old in zip(x[:count], x[count:], strict=True))

    new: dict[str, Shape] = dict(carried)
    old: dict[str, Shape] = {f"last.{name}": shape for name, shape in carried.items()}
    return stage("renewed", text, [{"last.code": ()} | new | old], [tuple(f"next.{name}" for name in carried)])


def control(law: ControlLaw, chain: ClosedChain) -> Stage:
    """Return the stage of the torques: the drives', and what joint friction leaves of them."""
    friction = joint_friction(chain)
    answer, shapes = law_text(law, chain)

    def text(t: Array, q: Array, qd: Array, *rest: Array) -> tuple[Array, ...]:
        drive, kept = answer(t, q, qd, *rest)
        return drive, drive - friction_torque(friction, qd), kept

    return stage("control", text, [shapes], [("drive", "tau", "memory")])


def law_text(law: ControlLaw, chain: ClosedChain) -> tuple[Callable[..., tuple[Array, Array]], dict[str, Shape]]:
    """Return a law as a function of arrays to torques and memory, and the arrays' shapes by name."""
    n, names = chain.joint_count, list(law.parameters)

    def text(
        t: Array, q: Array, qd: Array, pose: Array, twist: Array, memory: Array, *given: Array
    ) -> tuple[Array, Array]:
        told = dict(zip(names, given, strict=True))
        return _answer(law.torque(t[()], State(q, qd, pose, twist), memory, told), n, len(law.memory))

    told: dict[str, Shape] = {f"control.{name}": tuple(shape) for name, shape in law.parameters.items()}
    state: dict[str, Shape] = {"t": (), "q": (n,), "qd": (n,), "object_pose": (7,), "object_twist": (6,)}
    return text, state | {"last.memory": (len(law.memory),)} | told


def _answer(found: Any, joint_count: int, memory_count: int) -> tuple[Array, Array]:
    """Return a law's torques and memory, or say how they do not fit."""
    if not isinstance(found, tuple) or len(found) != 2:
        raise CompileError(f"control law: expected torques and memory, got {type(found).__name__}; try `tau, memory`")
    drive, kept = array(found[0]), array(found[1])
    for what, x, size in (("torques", drive, joint_count), ("memory", kept, memory_count)):
        if x.shape != (size,):
            raise CompileError(f"control law: {what}: expected shape ({size},), got {x.shape}")
    return drive, kept


def slope(chain: ClosedChain, base_motion: bool) -> Stage:
    """Return the stage of d/dt (q, qd, turn, p, V(C), work)."""
    n, l = chain.joint_count, len(chain.arms)
    friction = joint_friction(chain)
    damping = np.concatenate([arm.damping for arm in chain.arms.values()])

    def text(
        qd: Array, drive: Array, qdd: Array, turn: Array, twist: Array, acceleration: Array, wrench: Array, *base: Array
    ) -> tuple[Array]:
        lost = damping * qd + friction_torque(friction, qd)
        from_bases = base[0].ravel() @ base[1].ravel() if base else 0.0
        power = array([drive @ qd, -(lost @ qd), from_bases, wrench @ twist])
        return (concatenate([qd, qdd, rotation_vector_rate(turn, twist[:3]), twist[3:], acceleration, power]),)

    given: dict[str, Shape] = {"qd": (n,), "drive": (n,), "qdd": (n,), "turn": (3,), "object_twist": (6,)}
    given |= {"object_acceleration": (6,), "object_wrench": (6,)}
    given |= {"base_wrench": (l, 6), "base_twist": (l, 6)} if base_motion else {}
    return stage("slope", text, [given], [("slope",)])


def closed_in_position(n: int) -> Stage:
    """Return the stage that moves arms and object by the changes a position projection found, unless they are held."""

    def text(q: Array, pose: Array, change: Array, alpha: Array, held: Array) -> tuple[Array, ...]:
        there = moved(State(q, q, pose), change, alpha)
        return select(held[()] > 0.5, q, there.q), select(held[()] > 0.5, pose, there.object_pose)

    given: dict[str, Shape] = {"q": (n,), "object_pose": (7,), "change": (n,), "alpha": (6,), "held": ()}
    return stage("closed_in_position", text, [given], [("q'", "object_pose'")])


def closed_in_velocity(n: int) -> Stage:
    """Return the stage that does the same in velocity."""

    def text(qd: Array, twist: Array, change: Array, alpha: Array, held: Array) -> tuple[Array, ...]:
        return select(held[()] > 0.5, qd, qd + change), select(held[()] > 0.5, twist, twist + alpha)

    given: dict[str, Shape] = {"qd": (n,), "object_twist": (6,), "change": (n,), "alpha": (6,), "held": ()}
    return stage("closed_in_velocity", text, [given], [("qd'", "object_twist'")])


def largest_gaps() -> Stage:
    """Return the stage that takes one more arm's gaps into the largest, in position and in velocity."""

    def text(gaps: Array, position: Array, velocity: Array) -> tuple[Array]:
        return (array([maximum(gaps[0], position[()]), maximum(gaps[1], velocity[()])]),)

    return stage("largest_gaps", text, [{"gaps": (2,), "position": (), "velocity": ()}], [("gaps'",)])


def no_gaps() -> Stage:
    """Return the stage that begins looking for the largest gaps, the object being where it is now."""

    def text(pose: Array) -> tuple[Array, Array]:
        return np.zeros(2), Pose.unchecked_seven(pose).R

    return stage("no_gaps", text, [{"object_pose": (7,)}], [("gaps'", "R")])


def drift() -> Stage:
    """Return the stage that keeps the gaps found before projection."""
    return stage("drift", lambda gaps: (gaps,), [{"gaps": (2,)}], [("drift",)])


def margin(kind: GraspKind) -> Stage:
    """Return the stage of one grasp's margin; infinite for a two-sided one without wrench limits.

    `contact` is [whether it is one-sided, mu, torsion radius or half length, largest moment, largest force, lever].
    """

    def text(contact: Array, grasp_R: Array, wrench: Array, object_R: Array) -> tuple[Scalar]:
        one_sided, mu, size, moment, force, lever = contact
        f = unrotate(object_R @ grasp_R, wrench)
        strength = least_margin(limit_conditions(moment, force, lever), f)
        if kind == "rigid":
            return (strength,)
        pressed = least_margin(friction_conditions(kind, mu, size), f)
        return (minimum(strength, where(one_sided > 0.5, pressed, float("inf"))),)

    given: dict[str, Shape] = {"contact": (6,), "grasp_R": (3, 3), "grasp_wrench": (6,), "object_R": (3, 3)}
    return stage(f"margin_{kind}", text, [given], [("margin",)])


def worst(first: bool) -> Stage:
    """Return the stage that takes one more evaluation into the worst [condition, status] of a step.

    Args:
        first: whether it is the step's first.
    """

    def text(condition: Array, status: Array, *before: Array) -> tuple[Array]:
        now = array([condition[()], status[()]])
        return (now if first else array([maximum(b, x) for b, x in zip(before[0], now, strict=True)]),)

    given: dict[str, Shape] = {"condition": (), "status": ()}
    return stage("first" if first else "worst", text, [given | ({} if first else {"worst": (2,)})], [("worst'",)])


def verdict(sizes: Mapping[str, int], grasps: int) -> Stage:
    """Return the stage that accepts a step, or leaves the system at its start and says why.

    Args:
        sizes: numbers of each kept array.
        grasps: their number.
    """
    kept: dict[str, Shape] = {name: (size,) for name, size in sizes.items()}
    now: dict[str, Shape] = {"worst": (2,), "drift": (2,), "gaps": (2,), "work": (4,), "t": (), "least_margin": ()}
    now["held"] = ()
    books: dict[str, Shape] = {"work": (4,), "gaps": (4,), "code": (), "count": ()}
    if "memory" in sizes:
        books["before"] = (sizes["memory"],)
    if grasps:
        books |= {"worst_margin": (grasps,), "worst_time": (grasps,)}
    last = {f"last.{name}": shape for name, shape in (kept | books).items()}

    def text(*given: Array) -> tuple[Any, ...]:
        x = dict(zip([*kept, *now, *last], given, strict=True))
        # x - x, which tells as much, is folded to zero
        total = sum(sum(abs(entry) for entry in x[name]) for name in kept if name != "margin")
        least = reduce(minimum, x["margin"]) if grasps else float("inf")
        fault = where(least < x["least_margin"][()], float(SLIPPED), float(RUNNING))
        fault = where(x["worst"][0] <= WORST_CONDITION, fault, float(SINGULAR))
        fault = where(x["worst"][1] < FIRST_BAD, fault, float(SINGULAR))
        fault = where(x["drift"][0] <= FARTHEST, fault, float(OPEN))
        left = where(x["held"][()] > 0.5, 0.0, x["gaps"][0])  # what is held is not closed
        fault = where(left <= LEFT_OPEN, fault, float(OPEN))
        fault = where(total < float("inf"), fault, float(BROKEN))
        code = where(x["last.code"][()] > 0.5, x["last.code"][()], fault)
        on = code < 0.5
        found = [select(on, x[name], x[f"last.{name}"]) for name in kept]
        found.append(select(on, x["last.work"] + x["work"], x["last.work"]))
        found.append(select(on, concatenate([x["drift"], x["gaps"]]), x["last.gaps"]))
        found += [array(code), array(x["last.count"][()] + where(on, 1.0, 0.0))]
        if "memory" in sizes:
            found.append(select(on, x["last.memory"], x["last.before"]))
        if grasps:
            worst, since = x["last.worst_margin"], x["last.worst_time"]
            lower = [where(on, m, float("inf")) < w for m, w in zip(x["margin"], worst, strict=True)]
            found.append(array([where(l, m, w) for l, m, w in zip(lower, x["margin"], worst, strict=True)]))
            found.append(array([where(l, x["t"][()], t) for l, t in zip(lower, since, strict=True)]))
        return tuple(found)

    return stage("verdict", text, [kept | now | last], [tuple(f"next.{name}" for name in (*kept, *books))])


def handed_on(carried: Mapping[str, Shape]) -> Stage:
    """Return the stage that makes the step's results the next one's beginning."""
    given: dict[str, Shape] = {f"next.{name}": shape for name, shape in carried.items()}
    return stage("handed_on", lambda *x: x, [given], [tuple(f"last.{name}" for name in carried)])
