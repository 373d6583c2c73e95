"""Gradients through rollouts against five-point differences of the discrete map, kept or taken again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import holdfast as hf
from holdfast.compiled.parameters import parameters_of
from holdfast.model.grasp import WrenchLimits
from holdfast.spatial import rotation
from holdfast.spatial.scalar import array, cos, sin
from tests.derivatives.chains import random_chain
from tests.systems import random_system
from tests.systems.as_chain import Problem, as_chain
from tests.systems.sprung import with_springs

STEP, STEPS, SYSTEMS = 2e-3, 9, 3
TOLERANCE = 1e-8


def damped(t: Any, state: hf.State, memory: Any, given: Any) -> Any:
    """Drive and damp; what it remembers of its gain enters the next step."""
    return given["tau"] - memory * state.qd, 0.9 * memory + 0.1 * given["gain"]


def law(n: int) -> hf.ControlLaw:
    """Return a law with two parameters and a memory."""
    return hf.ControlLaw(damped, memory=np.full(n, 0.2), parameters={"tau": (n,), "gain": (n,)})


def two_arms() -> Problem:
    """Return two arms that hold an object, one of which may slide."""
    return as_chain(random_system(5, arms=2, joints=[5, 4], grasps=["rigid", "hinge"], moving_base=False))


def five_points(at: Any, far: float) -> Any:
    """Return the derivative at 0 of a function of how far, by five points."""
    ends = [at(k * far) for k in (1, -1, 2, -2)]
    return (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * far)


OF_BODIES = ("link_mass", "link_com", "trunk_link_mass", "trunk_link_com")


class Rolled:
    """A rollout as a function of what gradients are by, and a scalar of its result for every system.

    Attributes:
        p: the chain, a state and torques.
        rollout: what steps.
        cotangents: at the end, and along the steps.
    """

    def __init__(self, p: Problem, along: tuple[str, ...] = ("grasp_wrench", "qd"), **options: Any) -> None:
        random, n = np.random.default_rng(0), p.chain.joint_count
        self.p, self.rollout = p, hf.compile_rollout(p.chain, law(n), **options)
        self.tau = p.tau + random.normal(size=(STEPS, SYSTEMS, n))
        shapes = {"grasp_wrench": (len(p.chain.arms), 6), "qd": (n,), "qdd": (n,)}
        shapes |= {"margin": (len(p.chain.grasps),), "work": (4,)}
        sizes = {"q": n, "object_twist": 6, "memory": n}
        self.final = {name: random.normal(size=(SYSTEMS, k)) for name, k in sizes.items()}
        self.along = {name: 1e-2 * random.normal(size=(STEPS, SYSTEMS, *shapes[name])) for name in along}

    def tape(self, changed: dict[str, Any], far: float, **options: Any) -> Any:
        """Return the steps with something changed."""
        d = {name: far * x for name, x in changed.items()}
        n, body, at = self.p.chain.joint_count, self.p.chain.held_object, self.p.state
        frames = [grasp.frame for grasp in self.p.chain.grasps.values()]
        bases = [arm.base for arm in self.p.chain.arms.values()]
        given = {"gain": np.full(n, 0.5) + d.get("gain", 0.0), "grasp_pose": moved(frames, d.get("grasp_pose", 0.0))}
        given |= {"base_pose": moved(bases, d["base_pose"])} if "base_pose" in d else {}
        given |= {"object_mass": body.mass + d.get("object_mass", 0.0), "object_inertia": np.array(body.inertia)}
        given |= {"object_wrench": np.full(6, 0.5) + d.get("object_wrench", 0.0)}
        for name in OF_BODIES:
            given |= {name: parameters_of(self.p.chain, None)[name] + d[name]} if name in d else {}
        floating = {} if at.base_pose is None else {"floating_pose": at.base_pose, "floating_twist": at.base_twist}
        pose = at.object_pose + np.concatenate([np.zeros(4), np.reshape(d.get("object_pose", np.zeros(6)), 6)[3:]])
        tau = self.tau + d.get("tau", 0.0)
        q, qd = np.repeat((at.q + d.get("q", 0.0))[None], SYSTEMS, 0), at.qd + d.get("qd", 0.0)
        given |= {"memory": np.full(n, 0.2) + d.get("memory", 0.0), "tau": tau[0]}
        systems = self.rollout.start(q, qd, pose, at.object_twist, **floating, **given)
        step = STEP + d.get("step", 0.0)
        return self.rollout.tape(systems, step, steps=STEPS, schedule={"tau": tau}, record=(*self.along,), **options)

    def value(self, tape: Any) -> np.ndarray:
        """Return the scalar of every system."""
        found = sum((x * getattr(tape.systems, name)).sum(axis=1) for name, x in self.final.items())
        for name, x in self.along.items():
            record = np.where(np.isinf(tape.records[name]), 0.0, tape.records[name])  # margins without a limit
            found = found + (x * record).reshape(STEPS, SYSTEMS, -1).sum(axis=(0, 2))
        return found

    def worst(self, names: tuple[str, ...], far: float = 1e-4) -> float:
        """Return how far gradients are from differences."""
        tape, random, off = self.tape({}, 0.0), np.random.default_rng(2), [0.0]
        found = tape.vjp(self.final, self.along, by=names)
        for name in names:
            x = found[name]
            direction = random.normal(size=x.shape[1:] if name != "tau" else x.shape)
            if name == "object_pose":
                direction[..., :3] = 0.0  # shifts
            size = np.abs(direction).max() or 1.0
            change = {name: direction / size}
            expected = five_points(lambda x, change=change: self.value(self.tape(change, x)), far)
            axes = tuple(range(1, x.ndim)) if name != "tau" else (0, 2)
            slope = (x * direction / size).sum(axis=axes)
            off.append(float((np.abs(slope - expected) / np.maximum(np.abs(expected), 0.1)).max()))
            print(f"\n{name}: {off[-1]:.1e}")
        return max(off)


def moved(poses: list[hf.Pose], changes: Any) -> np.ndarray:
    """Return poses, each turned and shifted by six numbers, as wxyz_xyz."""
    each = np.broadcast_to(np.reshape(changes, (-1, 6)) if np.ndim(changes) else changes, (len(poses), 6))
    found = [hf.Pose(rotation.exp(x[:3]) @ pose.R, pose.p + x[3:]) for pose, x in zip(poses, each, strict=True)]
    return np.array([pose.wxyz_xyz for pose in found])


NAMES = ("q", "qd", "object_pose", "memory", "gain", "tau", "step", "object_mass", "grasp_pose")


@pytest.fixture(scope="module")
def rolled():
    """Return two arms, one that may slide; their first velocities do not fit the grasps."""
    p = two_arms()
    return Rolled(replace(p, state=replace(p.state, qd=p.state.qd + 0.1)))


@pytest.mark.slow
def test_gradients(rolled):
    """Everything that a rollout is given, the state that `start` brings onto the grasps included."""
    assert rolled.worst(NAMES) < TOLERANCE


@pytest.mark.slow
def test_bits(rolled):
    """The same bits whether states are kept or steps taken again, on threads, and for one system."""
    tape = rolled.tape({}, 0.0)
    found = tape.vjp(rolled.final, rolled.along, by=NAMES)
    for every in (2, 4):
        again = rolled.tape({}, 0.0, every=every).vjp(rolled.final, rolled.along, by=NAMES, threads=2)
        assert all(np.array_equal(again[name], found[name]) for name in NAMES)
    assert tape.every == 1
    assert repr(tape) == "<Tape of 9 steps of 3 systems, states kept every 1>"


@pytest.mark.slow
def test_standing_still(rolled):
    """A system that stops passes on what comes back unchanged; of one that never went there is only that."""
    systems = rolled.tape({}, 0.0).systems
    bad = systems.q.copy()
    bad[1, 0] = np.nan
    started = rolled.rollout.start(
        bad, systems.qd, systems.object_pose, systems.object_twist, tau=rolled.tau[0], gain=np.full(9, 0.5)
    )
    tape = rolled.rollout.tape(started, STEP, steps=2, schedule={"tau": rolled.tau[:2]})
    along = {name: 0.0 * x[:2] for name, x in rolled.along.items()}
    found = tape.vjp({"q": np.ones((SYSTEMS, 9)), "memory": np.zeros((SYSTEMS, 9))}, along, by=NAMES)
    assert (found.q[1] == 1.0).all()
    assert not found.gain[1].any()
    assert found.gain[0].any()
    with pytest.raises(hf.errors.StateError, match="system 1, which took none"):
        tape.vjp({"memory": np.zeros((SYSTEMS, 9))}, {name: 1.0 + x for name, x in along.items()}, by=NAMES)


@pytest.mark.slow
def test_refusals(rolled):
    """Names and shapes that mean nothing are named."""
    tape = rolled.tape({}, 0.0)
    for options, text in (
        ({"final": rolled.final, "by": ("gian",)}, "tape: by: no 'gian'"),
        ({"final": {"qdd": np.zeros((SYSTEMS, 9))}}, "tape: final: no 'qdd'"),
        ({"along": {"qd": np.zeros((2, SYSTEMS, 9))}}, r"along: qd: expected shape"),
    ):
        with pytest.raises(hf.errors.StateError, match=text):
            tape.vjp(**options)
    for options, text in (
        ({"steps": 0}, "steps"),
        ({"steps": 2, "every": 0}, "every"),
        ({"steps": 2, "schedule": {"tau": np.zeros((3, 9))}}, "expected 2 rows"),
        ({"steps": 2, "schedule": {"mass": np.zeros(2)}}, "no 'mass'"),
        ({"steps": 2, "record": ("qqq",)}, "no array 'qqq'"),
    ):
        with pytest.raises(hf.errors.StateError, match=text):
            rolled.rollout.tape(tape.systems, STEP, **options)


def limited(p: Problem) -> Problem:
    """Return the problem with friction at its hinge, and a largest force and moment at its rigid grasp."""
    how = {
        "rigid": {"wrench_limits": WrenchLimits(force=900.0, moment=300.0)},
        "hinge": {"contact": hf.Friction(0.6, half_length=0.05)},
    }
    grasps = {name: replace(grasp, **how.get(grasp.kind, {})) for name, grasp in p.chain.grasps.items()}
    return replace(p, chain=replace(p.chain, grasps=grasps))


def swaying(base: hf.Pose) -> Any:
    """Return the motion of a base along x, about where it stands."""

    def motion(t: Any) -> Any:
        x, v, a = 0.01 * sin(30.0 * t), 0.3 * cos(30.0 * t), -9.0 * sin(30.0 * t)
        pose = array([*base.wxyz_xyz[:4], base.p[0] + x, *base.p[1:]])
        return pose, array([0.0, 0.0, 0.0, v, 0.0, 0.0]), array([0.0, 0.0, 0.0, a, 0.0, 0.0])

    return motion


@pytest.mark.long
def test_margins_and_work():
    """Margins at the ends of steps, and the work since the start: of drives, damping, springs and external wrenches."""
    p = two_arms()
    p = limited(replace(p, chain=with_springs(p.chain)))
    rolled = Rolled(p, along=("margin", "work", "qd"))
    assert np.isfinite(rolled.tape({}, 0.0).records["margin"]).all()
    assert rolled.worst((*NAMES, "base_pose"), far=5e-5) < TOLERANCE
    alone = Rolled(p, along=("margin",))
    assert alone.worst(("q", "object_pose", "grasp_pose", "tau")) < TOLERANCE
    tape, every = rolled.tape({}, 0.0), rolled.tape({}, 0.0, every=4)
    found, again = (x.vjp(rolled.final, rolled.along, by=NAMES) for x in (tape, every))
    assert all(np.array_equal(again[name], found[name]) for name in NAMES)
    at_end = tape.vjp({"work": rolled.along["work"][-1]}, by=NAMES)
    along = np.zeros_like(rolled.along["work"])
    along[-1] = rolled.along["work"][-1]
    assert all(np.array_equal(at_end[name], x) for name, x in tape.vjp(along={"work": along}, by=NAMES).parts.items())


@pytest.mark.slow
def test_work_of_a_moving_base():
    """The wrench of a base that moves does work, and so does a wrench on the object."""
    p = two_arms()
    name, arm = next(iter(p.chain.arms.items()))
    rolled = Rolled(p, along=("work",), base_motion={name: swaying(arm.base)})
    assert np.abs(rolled.tape({}, 0.0).records["work"][-1, :, 2]).min() > 1e-3
    assert rolled.worst(("q", "qd", "gain", "tau", "object_mass", "object_wrench")) < TOLERANCE
    with pytest.raises(hf.errors.StateError, match="tape: by: no 'step'"):
        rolled.tape({}, 0.0).vjp(rolled.final, by=("step",))


@pytest.mark.long
@pytest.mark.parametrize("springs", [False, True])
@pytest.mark.parametrize("trunk", ["fixed", "floating"])
def test_trunks(trunk, springs):
    """Arms on a trunk, which may float, with springs between bodies and without."""
    p, names = random_chain(1, trunk), ("q", "qd", "memory", "gain", "tau", "step", "object_mass")
    if springs:
        assert sprung(p).worst(names, far=5e-5) < TOLERANCE
    else:
        assert Rolled(p, parameters=("link_inertia",)).worst((*names, *OF_BODIES)) < TOLERANCE


def sprung(p: Problem) -> Rolled:
    """Return the problem's rollout with springs between all kinds of bodies."""
    return Rolled(replace(p, chain=with_springs(p.chain)))


@pytest.mark.slow
def test_springs_between_bodies():
    """Their wrenches follow the state, the object and the bases from stage to stage."""
    p = two_arms()
    assert sprung(p).worst((*NAMES, "base_pose"), far=5e-5) < TOLERANCE


@pytest.mark.long
def test_many_holds():
    """A planar loop in space: rows of the grasps follow from others, and forces are refused."""
    turned, inertia = np.eye(3)[[1, 2, 0]], np.eye(3) / 12  # hinges turn about z
    links = [hf.Link(1.0, (0.5, 0, 0), inertia)]
    crank = hf.Arm([hf.Joint("revolute", (0, 0, 1))], links, tip=hf.Pose(turned, (1.0, 0, 0)))
    arms = {"left": crank, "right": crank.at(hf.Pose.translation(1.0, 0, 0))}
    grasps = {name: hf.Grasp("hinge", hf.Pose(turned, (x, 0, 0))) for name, x in (("left", -0.5), ("right", 0.5))}
    chain = hf.ClosedChain(arms, hf.HeldObject(1.0, inertia), grasps, gravity=(0, -9.81, 0))
    state = hf.State([2.2] * 2, [0.3] * 2, [1, 0, 0, 0, 0.5 + np.cos(2.2), np.sin(2.2), 0])
    p = Problem(chain, hf.project(chain, state)[0], np.array([0.1, -0.2]), hf.Inputs())
    rolled = Rolled(p, along=("qdd",))
    assert rolled.worst(("q", "qd", "memory", "gain", "tau", "step", "object_mass")) < TOLERANCE
    with pytest.raises(hf.errors.MethodNotApplicable, match="unique"):
        rolled.tape({}, 0.0).vjp(along={"grasp_wrench": np.zeros((STEPS, SYSTEMS, 2, 6))})


@pytest.mark.long
def test_implicit_steps():
    """Dampers and friction that make steps implicit."""
    p = two_arms()
    arms = {
        name: arm.of([replace(joint, damping=300.0, friction=0.5) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    rolled = Rolled(replace(p, chain=replace(p.chain, arms=arms)))
    assert rolled.tape({}, 0.0)._stored[0].stiff.all()
    assert rolled.worst(("q", "qd", "memory", "gain", "tau", "object_mass")) < 1e-7


@pytest.mark.long
def test_events():
    """A thousand steps: a grasp closes on a moving object, is lost where its force passes a bound, and stays open.

    The step that ends at the loss has a length h such that m(x(h)) = 0, so dh = -(grad m . dx) / (dm / dh).
    """
    p = two_arms()
    n, chain = p.chain.joint_count, p.chain
    free, last = list(chain.grasps)
    alone, both = (hf.compile_rollout(c, law(n)) for c in (replace(chain, grasps={free: chain.grasps[free]}), chain))
    random, given = np.random.default_rng(3), {"tau": hf.holding_torques(chain, p.state.at_rest())}
    cotangent = {"q": random.normal(size=(1, n)), "object_twist": random.normal(size=(1, 6))}
    turn = random.normal(size=n)
    row, h = list(chain.arms).index(last), 1e-4

    def force(tape):
        return tape.records["grasp_wrench"][0, 0, row, 3:].sum()

    def run(gain, far, bound=None):
        given["gain"] = np.full(n, gain)
        qd = p.state.qd + (np.arange(n) >= 5) * 0.1 * (1.0 + far * turn)
        begin = alone.start(p.state.q, qd, p.state.object_pose, p.state.object_twist, **given)
        first = alone.tape(begin, 1e-8, steps=2)
        second = both.tape(both.take_over(first.systems, **given), h, steps=400)

        def after(x):
            return both.tape(second.systems, x * h, steps=1, record=("grasp_wrench",))

        bound = 0.5 * (force(after(20.0)) + force(after(30.0))) if bound is None else bound
        third = after(brentq(lambda x: force(after(x)) - bound, 1e-3, 60.0, xtol=1e-15, rtol=1e-15))
        fourth = alone.tape(alone.take_over(third.systems, **given), h, steps=597)
        value = sum((x * getattr(fourth.systems, name)).sum() for name, x in cotangent.items())
        return value, bound, (first, second, third, fourth)

    _, bound, tapes = run(0.5, 0.0)
    by, states = ("q", "qd", "object_pose", "object_twist", "memory", "gain"), slice(0, 5)
    names, gains = by[states], 0.0
    back = tapes[3].vjp(cotangent, by=by)
    gains += back.gain
    of_state = {name: back[name] for name in names}
    after = tapes[2].vjp(of_state, by=(*by, "step"))
    unit = np.zeros((1, 1, len(chain.arms), 6))
    unit[0, 0, row, 3:] = 1.0
    margin = tapes[2].vjp(along={"grasp_wrench": unit}, by=(*by, "step"))
    share = after.step[0] / margin.step[0]
    of_state = {name: after[name] - share * margin[name] for name in by}
    gains += of_state.pop("gain")
    for tape in tapes[1::-1]:
        back = tape.vjp(of_state, by=by)
        of_state, gains = {name: back[name] for name in names}, gains + back.gain
    by_qd = of_state["qd"][0] @ ((np.arange(n) >= 5) * 0.1 * turn)
    for slope, at in ((gains.sum(), lambda x: run(0.5 + x, 0.0, bound)[0]), (by_qd, lambda x: run(0.5, x, bound)[0])):
        expected = five_points(at, 3e-4)
        print(f"\n{abs(slope - expected) / abs(expected):.1e}")
        assert abs(slope - expected) < TOLERANCE * abs(expected)
