"""What the library calls frozen cannot be written: no array, list or mapping, however it is reached or copied."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.robots import panda
from holdfast.robots.primitive import Primitive
from tests.surface import PUBLIC
from tests.systems.branched import two_arms_with_grippers

WRITTEN_AGAIN = {"CompiledResult"}  # by `out=`
COPIES = {
    "itself": lambda x: x,
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    **{f"pickle {k}": lambda x, k=k: pickle.loads(pickle.dumps(x, protocol=k)) for k in (2, 4, 5)},
}


def torque(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
    """A law that pickles."""
    return -given["gain"] * state.qd, memory


@cache
def problem() -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms that hold a box."""
    arms = {"left": panda().at([1, 0, 0, 0, -0.55, 0, 0]), "right": panda().at([0, 0, 0, 1, 0.55, 0, 0])}
    grasps = {
        "left": hf.Grasp("rigid", hf.Pose.from_wxyz_xyz([0.5, -0.5, 0.5, -0.5, -0.15, 0, 0])),
        "right": hf.Grasp("ball", hf.Pose.from_wxyz_xyz([0.5, -0.5, -0.5, 0.5, 0.15, 0, 0]), hf.Friction(0.5)),
    }
    made = hf.assemble(arms, hf.HeldObject.box(3.0, 0.3, 0.2, 0.2), grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.72])
    return made.chain, made.state


def branched() -> list[Any]:
    """Return results of a chain that is a forest."""
    p = two_arms_with_grippers()
    return [
        hf.forward_dynamics(*p),
        hf.inverse_dynamics(p.chain, p.state, 0.0 * p.tau, object_acceleration=np.zeros(6)),
        hf.linearise(*p),
        hf.dynamics.attach(p.chain, p.state, ("arm2", "pad1"), hf.Grasp("ball"), here=True),
    ]


def shapes() -> dict[str, Any]:
    """Return shapes of the world of all kinds."""
    solids = hf.world.HalfSpace(normal=np.array([0.0, 0.0, 1.0])), hf.world.Box(half=np.ones(3))
    of_radius = hf.world.Ball(radius=1.0), hf.world.Cylinder(radius=1.0), hf.world.Cone(angle=0.4)
    of_edges = hf.world.Hole(radius=1.0, chamfer=0.1), hf.world.Rod(radius=1.0, half_length=1.0)
    free = hf.world.HeightField(heights=np.ones((4, 4)), spacing=0.1), hf.world.ConvexMesh(vertices=np.eye(4)[:, :3])
    return {type(one).__name__: one for one in (*solids, *of_radius, *of_edges, *free)}


@cache
def examples() -> dict[str, Any]:
    """Return an object of every public frozen dataclass by its type's name."""
    chain, state = problem()
    arm, grasp = chain.arms["left"], chain.grasps["left"]
    result = hf.forward_dynamics(chain, state, np.zeros(14))
    law = hf.ControlLaw(torque, [0.0], {"gain": [14]})
    rollout = hf.compile_rollout(chain)
    record = rollout.run(rollout.start(state.q, state.qd, state.object_pose, np.zeros(6), tau=np.zeros(14)), 1e-3, 1e-3)
    Y = hf.regressor(chain, state, 0 * state.q, np.zeros(6))
    weighed = [Y.object @ hf.dynamics.inertial_parameters(chain.held_object)] * 4
    wrists = np.zeros((4, 2, 6))
    wrists[:, 0] = np.random.default_rng(0).normal(size=(4, 6)) + weighed
    motion = {"qd": np.zeros((4, 14)), "qdd": np.zeros((4, 14)), "object_pose": [state.object_pose] * 4}
    rest = {"object_twist": np.zeros((4, 6)), "object_acceleration": np.zeros((4, 6))}
    recording = hf.identification.Recording(range(4), [state.q] * 4, wrist_wrench=wrists, **motion, **rest)
    box_seen = hf.calibration.FrameMeasurement("object", [state.object_pose] * 3)
    closures = hf.calibration.ClosureNoise(1e-3, 1e-3)
    still = hf.identification.Recording(np.arange(200) / 100, np.zeros((200, 1)))
    found = [
        *(Y, recording, payload := hf.identify(chain, recording, noise=np.full(6, 0.1))),
        hf.identification.Assessment(
            payload, "tau", ("left",), (np.zeros(4),), (Y.object,), (Y.object,), np.zeros(1), None, ()
        ),
        *(hf.identification.Prior(friction=np.ones(14)), hf.identification.prepared(still)[1]),
        postures := hf.calibration.Postures([state.q] * 3, {"left": [True] * 3}, {"box": box_seen}),
        *(box_seen, closures, hf.calibrate(chain, postures, noise=closures)),
        hf.identification.base_parameters(Y.object, [str(k) for k in range(10)]),
        *(arm, arm.links[0], arm.joints[0], chain, chain.held_object, grasp, chain.grasps["right"].contact),
        *(state, hf.Inputs(np.zeros(6)), hf.WrenchLimits(), state.object_frame, hf.Pose(np.eye(3), np.zeros(3))),
        *(result, result["left"], hf.diagnose(chain, state), hf.assembly.assembly_report(chain, state)),
        hf.dynamics.attach(chain.without_grasp("left"), state, "left", grasp),
        *(hf.dynamics.METHODS["kkt"], hf.control.GravityCompensation(chain), law, record),
        *(
            hf.control.RestToRest(state.object_pose),
            path := hf.control.PoseSpline([state.object_pose, hf.Pose.translation(0, 0, 1)], [0.0, 1.0]),
            hf.simulation.CarriedBase(path.at, hf.Pose.identity()),
            hf.control.ObjectTracking(chain, hf.control.RestToRest(state.object_pose).at),
            hf.control.ObjectImpedance(hf.control.RestToRest(state.object_pose), np.ones(6), 1.0, 2.0),
            hf.control.PostureControl(state.q),
            push := hf.control.InternalForce([1.0, 2.0]),
            hf.control.InternalImpedance(np.ones(6), 1.0, push),
            share := hf.control.LoadShare({"left": 1.0}),
            hf.control.RampedForces(push, share),
            hf.control.HybridForce(1.0, 1e-3, push, sensor=chain),
            hf.follow(chain, state, hf.control.RestToRest(state.object_pose), 1.0, 0.25),
            hf.time_path(chain, state, hf.control.RestToRest(state.object_pose, [0.0, 0.0, 0.1]), nodes=4),
            hf.dynamics.Posture({"left": 0.1}, np.ones(14)),
        ),
        *(
            hf.control.TorqueSchedule([0.0, 1.0], [np.ones((14, 2))] * 2),
            hf.Attach(0.1, "left", grasp),
            hf.Release(0.1, "left"),
        ),
        run := hf.simulate(chain, state, hf.control.GravityCompensation(chain), 2e-3, 1e-3),
        run.setting,
        hf.Spring(("world", [0, 0, 1]), ("object", [0, 0, 0]), 5.0),
        touching := hf.world.Touching({"tip": hf.world.Sphere(np.zeros(3), 0.1)}, shapes()),
        *(touching.points["tip"], *touching.world.values()),
        hf.world.Circle(np.zeros(3), [0.0, 0.0, 1.0], 0.1),
        hf.touch(replace(chain, touching=touching), state),
        hf.dynamics.solve_contacts(np.eye(6), np.eye(6)[None, 3:], [[0.0, 0.0, -1.0]], [0.2]),
        hf.Anchor(hf.Pose.translation(0, 0, 1)),
        *branched(),
        hf.Closure("left/link3", "right/link3", hf.Grasp("ball")),
        hf.Coupling({"left/joint1": 1.0, "right/joint1": -1.0}),
        hf.Trunk([hf.Joint()], [arm.links[0]], floating=arm.links[0]),
        Primitive("box", hf.Pose.identity(), (1.0, 1.0, 1.0)),
        *(hf.sweeps.Uniform(np.zeros(3), [1.0, 2.0, 3.0]), hf.sweeps.Normal(np.zeros(3), [1.0, 2.0, 3.0])),
        *(hf.forces.ForceLimits(last_wrench=np.zeros((2, 6)), wrench_change=1.0), hf.forces.ForceCost(np.ones(14))),
        hf.forces.distribute(chain, state, limits=hf.forces.ForceLimits(effort=1e-3), task=np.eye(6)[3:]),
        *(hf.gym.CarryTask(), hf.gym.HandOverTask(), hf.gym.PlaceOnTableTask()),
        *(hf.sweeps.NearPose(np.eye(7)[:1]), hf.sweeps.sweep.Progress(1, 2, {"RUNNING": 1}, 3.0)),
    ]
    return {type(x).__name__: x for x in found}


def public() -> list[str]:
    """Return the names of the public dataclasses."""
    types = {path.rpartition(".")[2]: x for path, x in PUBLIC.items() if isinstance(x, type) and is_dataclass(x)}
    return [name for name in types if name not in WRITTEN_AGAIN]


def held(x: Any, path: str = "", seen: frozenset[int] = frozenset()) -> Iterator[tuple[str, Any]]:
    """Yield every array, list, set and mapping that is reached from an object and stays, with the way to it."""
    if isinstance(x, np.ndarray | list | set | bytearray | Mapping):
        yield path, x
    if id(x) in seen:
        return
    seen |= {id(x)}
    if isinstance(x, Mapping):
        parts = {f"[{name!r}]": part for name, part in x.items()}
    elif isinstance(x, tuple):
        parts = {f"[{k}]": part for k, part in enumerate(x)}
    elif is_dataclass(x) and not isinstance(x, type):
        parts = {f".{field.name}": getattr(x, field.name) for field in fields(x)}
        for owner in type(x).__mro__:
            for name, kind in vars(owner).items():
                if isinstance(kind, property | cached_property) and getattr(x, name) is getattr(x, name):
                    parts[f".{name}"] = getattr(x, name)  # others are made anew whenever they are asked for
    else:
        return
    for name, part in parts.items():
        yield from held(part, path + name, seen)


def writes(x: Any) -> list[Any]:
    """Return what would change an array, list, set or mapping."""
    if isinstance(x, np.ndarray):
        return [partial(x.__setitem__, ..., 0.0), partial(x.fill, 0.0)]
    if isinstance(x, Mapping):
        by_key = [partial(x.__setitem__, "new", 0), partial(x.update, {"new": 0}), partial(x.setdefault, "new", 0)]
        return [*by_key, x.clear, partial(x.pop, "new", 0), x.popitem, partial(x.__ior__, {"new": 0})]
    return [x.clear]


@pytest.mark.slow
@pytest.mark.parametrize("way", COPIES)
def test_nothing_can_be_written(way):
    """Every public dataclass, itself, copied, and pickled."""
    made, written = examples(), set()
    for name in public():
        x = COPIES[way](made[name])
        for path, part in held(x):
            for write in writes(part):
                try:
                    write()
                except (ValueError, hf.errors.FrozenError):
                    continue
                written.add((name, path))
        for field in fields(x)[:1]:
            with pytest.raises(FrozenInstanceError):
                setattr(x, field.name, None)
    assert not written, sorted(written)


@pytest.mark.parametrize("kind", ["rigid", "ball", "hinge", "softfinger", "universal", "slider", "cylinder", "planar"])
def test_what_has_been_computed_is_not_pickled(kind):
    """A chain pickles after it has been used, whatever its caches hold."""
    grasp = hf.Grasp(kind)
    before = grasp.transmission
    again = pickle.loads(pickle.dumps(grasp))
    assert "of_kind" in vars(grasp) and "of_kind" not in vars(again)
    assert (again.transmission == before).all()
