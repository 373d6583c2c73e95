"""One chain for each capability of the model, at a state that keeps its grasps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import holdfast as hf
from holdfast.dynamics import project_velocity
from tests.systems.anchored import pinned
from tests.systems.as_chain import Problem
from tests.systems.branched import two_arms_with_grippers
from tests.systems.bushed import bushed
from tests.systems.lower_pairs import grasp_of
from tests.systems.parallel_cranks import parallel_cranks
from tests.systems.problems import random_problem
from tests.systems.sprung import with_springs
from tests.systems.trunk_runs import still_base, swaying

PLAIN = {"moving_base": False, "extras": False, "gravity": (0.0, 0.0, -9.81), "joint_speed": 0.3}


def two_arms(*grasps: str, **options) -> Problem:
    """Return two arms of seven joints without external wrenches on bases at rest."""
    kinds = grasps or ("rigid", "rigid")
    p = random_problem(4, joints=(7,) * len(kinds), grasps=kinds, **{**PLAIN, **options})
    return replace(p, inputs=hf.Inputs())


def held_by(kind: str) -> Problem:
    """Return two arms, one of which holds by a kind of grasp in the place of a rigid one."""
    p = two_arms()
    name = p.chain.names[1]
    chain = replace(p.chain, grasps={**p.chain.grasps, name: grasp_of(kind, p.chain.grasps[name].frame)})
    return replace(p, chain=chain, state=project_velocity(chain, p.state))


def with_losses() -> Problem:
    """Return two arms whose joints have springs, dampers and friction."""
    p = two_arms()
    some = {"damping": 0.2, "friction": 0.1, "stiffness": 3.0, "armature": 0.05}
    arms = {
        name: replace(arm, joints=[replace(joint, **some) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    return replace(p, chain=replace(p.chain, arms=arms))


def with_wrenches() -> Problem:
    """Return two arms with wrenches on all links and on the object."""
    p, random = two_arms(), np.random.default_rng(1)
    n = p.chain.joint_count
    return replace(p, inputs=hf.Inputs(object_wrench=random.normal(size=6), link_wrenches=random.normal(size=(n, 6))))


def with_limits() -> Problem:
    """Return two arms with friction at one contact and wrench limits at the other."""
    p = two_arms("ball", "rigid")
    limits = {"contact": hf.Friction(0.8)}, {"wrench_limits": hf.WrenchLimits(moment=1e4, force=1e4)}
    grasps = {
        name: replace(grasp, **limit) for (name, grasp), limit in zip(p.chain.grasps.items(), limits, strict=True)
    }
    return replace(p, chain=replace(p.chain, grasps=grasps))


def one_arm_free() -> Problem:
    """Return three arms, one of which holds nothing."""
    p = two_arms("rigid", "rigid", "rigid")
    grasps = {name: grasp for name, grasp in p.chain.grasps.items() if name != p.chain.names[2]}
    return replace(p, chain=replace(p.chain, grasps=grasps))


def planar_cranks() -> Problem:
    """Return parallel cranks, a planar mechanism: the forces across its plane are not unique."""
    cranks = parallel_cranks(1)
    chain = cranks.chain
    return Problem(chain, cranks.state, np.zeros(chain.joint_count), hf.Inputs())


def with_moving_bases() -> Problem:
    """Return two arms on bases that begin to move: see `motions_of`."""
    p = two_arms()
    moves = [motion(0.0) for motion in motions_of("moving bases", p.chain).values()]
    twists, accelerations = (np.array([move[k] for move in moves]) for k in (1, 2))
    return replace(p, inputs=hf.Inputs(base_twists=twists, base_accelerations=accelerations))


def motions_of(capability: str, chain: hf.ClosedChain) -> dict[str, Callable]:
    """Return the motions of the bases that move, by arm."""
    moving = chain.arms if capability == "moving bases" else {}
    return {name: swaying(arm.base) for name, arm in moving.items()}


def on_base(joints: int, *, floating: bool) -> Problem:
    """Return two arms on a trunk, without external wrenches; weightless where nothing holds the trunk's base."""
    options = {name: x for name, x in PLAIN.items() if name != "moving_base"}
    options |= {"gravity": (0.0, 0.0, 0.0)} if floating else {}
    p = still_base(2, joints, floating=floating, arms={"joints": (7, 7), "grasps": ("rigid", "rigid"), **options})
    return replace(p, inputs=hf.Inputs())


CHAINS: dict[str, Callable[[], Problem]] = {
    "rigid grasps": two_arms,
    "balls, hinges, soft fingers": lambda: two_arms("ball", "hinge", "softfinger"),
    "universal joints": lambda: held_by("universal"),
    "sliders": lambda: held_by("slider"),
    "cylinders": lambda: held_by("cylinder"),
    "screws": lambda: held_by("screw"),
    "planar grasps": lambda: held_by("planar"),
    "motions given by hand": lambda: held_by("two slides"),
    "bushings": lambda: bushed(two_arms(), ("arm2",)),
    "anchors": lambda: pinned(two_arms(), ("ball",), moving=False),
    "springs between bodies": lambda: (lambda p: replace(p, chain=with_springs(p.chain)))(two_arms()),
    "springs, dampers, friction in joints": with_losses,
    "wrenches on links and object": with_wrenches,
    "friction cones and wrench limits": with_limits,
    "moving bases": with_moving_bases,
    "an arm that holds nothing": one_arm_free,
    "forces that are not unique": planar_cranks,
    "a trunk": lambda: on_base(3, floating=False),
    "a floating base": lambda: on_base(2, floating=True),
}


def still(**more: object) -> Problem:
    """Return two arms at rest with further parts of the chain."""
    p = two_arms()
    return replace(p, chain=replace(p.chain, **more), state=p.state.at_rest())


def with_grippers() -> Problem:
    """Return two arms with fingers that move by themselves."""
    p = two_arms_with_grippers()
    arms = {name: replace(arm, couplings=()) for name, arm in p.chain.arms.items()}
    return Problem(replace(p.chain, arms=arms), p.state, p.tau, hf.Inputs())


def with_loop() -> Problem:
    """Return two arms whose third links a ball joint ties together."""
    p = still()
    ends = {n: hf.dynamics.link_poses(arm, p.state.q[p.chain.joints[n]])[2] for n, arm in p.chain.arms.items()}
    arms = {name: replace(arm, frames={"third": (2, hf.Pose.identity())}) for name, arm in p.chain.arms.items()}
    (a, at_a), (b, at_b) = ends.items()
    tie = hf.Closure(f"{a}/third", f"{b}/third", hf.Grasp("ball"), at_a.inverse() @ at_b)
    return replace(p, chain=replace(p.chain, arms=arms, loops={"tie": tie}))


def with_ball_joint() -> Problem:
    """Return two arms, and a pendulum on a spherical joint."""
    p = still()
    pendulum = hf.Arm([hf.Joint("spherical")], [hf.Link(1.0, [0.0, 0.1, -0.3], 0.01 * np.eye(3))])
    chain = replace(p.chain, arms={**p.chain.arms, "pendulum": pendulum})
    state = hf.State([*p.state.q, 1.0, 0.0, 0.0, 0.0], [*p.state.qd, 0.0, 0.0, 0.0], p.state.object_pose)
    return replace(p, chain=chain, state=state, tau=np.append(p.tau, np.zeros(3)))


def with_lid() -> Problem:
    """Return two arms that hold an object, and another one, which falls."""
    p = still(objects={"lid": hf.HeldObject.box(1.0, 0.2, 0.2, 0.01)})
    return replace(p, state=hf.State(p.state.q, p.state.qd, [p.state.object_pose, np.eye(7)[0]]))


def with_passive_joint() -> Problem:
    """Return two arms, one joint of which has no drive."""
    p = still()
    name, arm = next(iter(p.chain.arms.items()))
    idle = arm.of([replace(arm.joints[0], actuated=False), *arm.joints[1:]])
    tau = p.tau.copy()
    tau[p.chain.joints[name].start] = 0.0
    return replace(p, chain=replace(p.chain, arms={**p.chain.arms, name: idle}), tau=tau)


# chains that are answered as forests
FORESTS: dict[str, Callable[[], Problem]] = {
    "branches": with_grippers,
    "an inner loop": with_loop,
    "mimic joints": lambda: still(couplings=[hf.Coupling({"arm1/joint1": 1.0, "arm1/joint2": -1.0}, offset=None)]),
    "several objects": with_lid,
    "a spherical joint": with_ball_joint,
    "a passive joint": with_passive_joint,
}


@dataclass(frozen=True)
class Case(Problem):
    """What is asked about.

    Attributes:
        base_motion: motions of the bases that move, by arm.
    """

    base_motion: Mapping[str, Callable]

    @property
    def wrenches(self) -> hf.Inputs:
        """External wrenches alone."""
        return replace(self.inputs, base_twists=None, base_accelerations=None)


@cache
def chain_with(capability: str) -> Case:
    """Return the chain of a capability, a state and torques."""
    p = (CHAINS | FORESTS)[capability]()
    return Case(**vars(p), base_motion=motions_of(capability, p.chain))
