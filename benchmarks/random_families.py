"""Random chains, and what is asked of them, of every kind that `simulate` knows: the families of `random_runs`.

They use public names, so that several versions of the library understand them; chains come from the tests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from tests.control.two_pandas import rubber_pandas, two_pandas
from tests.simulation.gantries import squeezed
from tests.systems.anchored import pinned
from tests.systems.as_chain import Problem, as_chain
from tests.systems.bricard import bricard, line_symmetric
from tests.systems.bushed import bushed
from tests.systems.lower_pairs import MOTIONS, grasp_of
from tests.systems.n_four_bar import n_four_bar
from tests.systems.parallel_cranks import parallel_cranks
from tests.systems.problems import random_problem
from tests.systems.special_systems import one_straight_arm_of_three
from tests.systems.sprung import with_springs
from tests.systems.stewart_platform import stewart_platform
from tests.systems.trunk_runs import still_base, swaying

import holdfast as hf
from benchmarks.random_laws import LAWS, MODELS, Random, hold
from holdfast import Attach, Friction, Grasp, Pose, Release, WrenchLimits
from holdfast.control import GravityCompensation, ObjectTracking, RestToRest, TorqueSchedule
from holdfast.dynamics import project_velocity
from holdfast.robots import three_finger_hand
from holdfast.simulation import CarriedBase

KINDS = ("rigid", "hinge", "softfinger", "ball", "universal", "slider", "cylinder", "screw", "planar", *MOTIONS)
PLAIN = {"moving_base": False, "extras": False, "gravity": (0.0, 0.0, -9.81), "joint_speed": 0.4}


@dataclass(frozen=True)
class Scene:
    """A chain, its state, and what its family prescribes; everything else is drawn.

    Attributes:
        chain: the chain.
        state: at the start.
        given: arguments of `simulate` that are not drawn.
        laws: names of the laws among which one is drawn.
        push: of every arm along its contact normal [N].
        step: shortest and longest step [s].
        continued: whether the run is continued from one of its checkpoints, and the rest is what counts.
    """

    chain: hf.ClosedChain
    state: hf.State
    given: dict[str, Any] = field(default_factory=dict)
    laws: tuple[str, ...] = tuple(LAWS)
    push: float = 0.0
    step: tuple[float, float] = (3e-4, 2e-3)
    continued: bool = False


def arms_of(random: Random, kinds: tuple[str, ...], **options: Any) -> Problem:
    """Return arms of six or seven joints that move, holding by kinds of grasps; those of a list hold rigidly first."""
    joints = tuple(int(n) for n in random.integers(6, 8, len(kinds)))
    given = {"joints": joints, "grasps": tuple("rigid" for _ in kinds), **PLAIN, **options}
    p = random_problem(int(random.integers(1000)), **given)
    grasps = {
        name: grasp_of(kind, grasp.frame) for (name, grasp), kind in zip(p.chain.grasps.items(), kinds, strict=True)
    }
    chain = replace(p.chain, grasps=grasps)
    return replace(p, chain=chain, state=project_velocity(chain, p.state), inputs=hf.Inputs())


def two_kinds(random: Random) -> tuple[str, ...]:
    """Return a random kind of grasp and one that holds what the other leaves free, mostly."""
    return str(random.choice(KINDS)), str(random.choice(["rigid", "rigid", "hinge", "ball", "softfinger"]))


def with_joints(chain: hf.ClosedChain, make: Callable[[], dict[str, Any]]) -> hf.ClosedChain:
    """Return the chain with further properties of the joints of its arms, made for each anew."""
    arms = {name: replace(arm, joints=[replace(j, **make()) for j in arm.joints]) for name, arm in chain.arms.items()}
    return replace(chain, arms=arms)


def unlike_limits(random: Random, chain: hf.ClosedChain) -> hf.ClosedChain:
    """Return the chain with limits of joints each of which is a little different, so that none are reached together."""

    def scaled(joint: hf.Joint) -> hf.Joint:
        low, high, rate, effort = (*joint.position_limits, joint.rate_limit, joint.effort_limit) * random.uniform(
            0.9, 1, 4
        )
        return replace(joint, position_limits=(low, high), rate_limit=rate, effort_limit=effort)

    arms = {name: replace(arm, joints=[scaled(joint) for joint in arm.joints]) for name, arm in chain.arms.items()}
    return replace(chain, arms=arms)


def grasp_kinds(random: Random) -> Scene:
    """Two or three arms that hold by any kinds."""
    p = arms_of(random, two_kinds(random) + (("rigid",) if random.random() < 0.3 else ()))
    return Scene(p.chain, p.state)


def trunks(random: Random) -> Scene:
    """Two arms on a trunk, whose base may move."""
    arms = {"joints": (7, 6), "grasps": tuple(random.choice(["rigid", "hinge", "ball"], 2).tolist())}
    options = {name: x for name, x in PLAIN.items() if name != "moving_base"}
    p = still_base(int(random.integers(100)), int(random.integers(1, 5)), floating=False, arms={**arms, **options})
    assert p.chain.trunk is not None
    motion = {"base_motion": {"trunk": swaying(p.chain.trunk.base)}}
    return Scene(p.chain, p.state, motion if random.random() < 0.4 else {})


def floating_bases(random: Random) -> Scene:
    """Two arms on a body that floats, weightless."""
    arms = {"joints": (7, 6), "grasps": ("rigid", str(random.choice(["rigid", "hinge", "ball"])))}
    options = {**PLAIN, "gravity": (0.0, 0.0, 0.0)}
    del options["moving_base"]
    p = still_base(int(random.integers(100)), int(random.integers(0, 3)), floating=True, arms={**arms, **options})
    laws = tuple(name for name in LAWS if name != "holding law")
    return Scene(p.chain, p.state, {"inputs": None}, laws)


def springs(random: Random) -> Scene:
    """Springs between the world, links and the object."""
    p = arms_of(random, ("rigid", str(random.choice(["rigid", "ball", "hinge"]))))
    return Scene(with_springs(p.chain, int(random.integers(100)), damped=random.random() < 0.7), p.state)


def bushings(random: Random) -> Scene:
    """A bushing beside a grasp."""
    p = arms_of(random, ("rigid", "rigid"))
    p = bushed(p, (p.chain.names[1],), int(random.integers(100)), damped=random.random() < 0.7)
    return Scene(p.chain, p.state)


def soft_joints(random: Random) -> Scene:
    """Springs, dampers, friction and armatures in all joints, soft enough for explicit steps."""
    p = arms_of(random, two_kinds(random))

    def soft() -> dict[str, Any]:
        named = {"damping": 0.3, "friction": 0.5, "stiffness": 20.0, "armature": 0.2}
        return {name: float(random.uniform(0.0, most)) for name, most in named.items()} | {"rest": random.normal()}

    return Scene(with_joints(p.chain, soft), p.state)


def stiff_joints(random: Random) -> Scene:
    """Dampers and springs in some joints that explicit steps cannot follow."""
    p = arms_of(random, two_kinds(random))

    def stiff() -> dict[str, Any]:
        some = random.random() < 0.4
        damping, stiffness = 10 ** random.uniform(2.0, 4.5), 10 ** random.uniform(1.0, 5.0)
        return {"damping": damping * some, "stiffness": stiffness * some, "rest": 0.1 * random.normal()}

    given = (
        {} if random.random() < 0.2 else {"scheme": str(random.choice(["rk4", "midpoint", "imex"], p=[0.6, 0.2, 0.2]))}
    )
    return Scene(with_joints(p.chain, stiff), p.state, given, step=(5e-4, 2e-3))


def high_gains(random: Random) -> Scene:
    """A law's dampers, from well below to beyond what the scheme follows at this step."""
    p = arms_of(random, ("rigid", "rigid"))
    tau, q = hold(p.chain, p.state), p.state.q
    gain = 10 ** random.uniform(2.0, 4.0) * random.uniform(0.2, 1.0, len(q)) * (random.random(len(q)) < 0.5)

    def controller(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        return tau + 2.0 * np.sin(30.0 * t) - gain * (now.qd + 3.0 * (now.q - q)), memory

    return Scene(p.chain, p.state, {"controller": controller, "scheme": str(random.choice(["rk4", "midpoint"]))})


def moving_bases(random: Random) -> Scene:
    """Arms whose bases move, by a function or by a path."""
    p = arms_of(random, two_kinds(random))
    motion = {}
    for name, arm in p.chain.arms.items():
        shift, turn = 0.05 * random.normal(size=(2, 3))
        path = RestToRest(arm.base, shift, turn, duration=float(random.uniform(0.1, 0.5)))
        motion[name] = swaying(arm.base) if random.random() < 0.5 else CarriedBase(path, Pose.identity())
    some = {name: one for name, one in motion.items() if random.random() < 0.8}
    return Scene(p.chain, p.state, {"base_motion": some}, ("constant law", "function", "counting", "joint springs"))


def anchors(random: Random) -> Scene:
    """The object is pinned to the world besides."""
    p = arms_of(random, ("rigid", "rigid"))
    p = pinned(p, (str(random.choice(["ball", "hinge", "universal"])),), int(random.integers(100)), moving=False)
    return Scene(p.chain, project_velocity(p.chain, p.state))


def free_arms(random: Random) -> Scene:
    """Arms of which some hold nothing, and an object that nothing holds."""
    p = arms_of(random, ("rigid", "rigid", "rigid")[: int(random.integers(1, 4))])
    kept = dict(list(p.chain.grasps.items())[: int(random.integers(0, len(p.chain.grasps)))])
    chain = replace(p.chain, grasps=kept)
    laws = tuple(name for name in LAWS if kept or name not in MODELS)
    return Scene(chain, p.state, laws=laws)


def slipping_fingers(random: Random) -> Scene:
    """A block between two gantries, one-sided contacts: their squeeze fades, the lift grows, or the wrists turn it."""
    kind = str(random.choice(["ball", "softfinger", "hinge"]))
    sizes: dict[str, Any] = {"softfinger": {"torsion_radius": 0.02}, "hinge": {"half_length": 0.03}}
    contact = Friction(float(random.uniform(0.4, 0.8)), **sizes.get(kind, {}))
    chain, state = squeezed((kind, kind), contact, ("zx", "z") if kind != "ball" else ("", ""), gravity=9.81)
    first, last = hold(chain, state, 60.0), hold(chain, state, float(random.uniform(-5.0, 60.0)))
    first, last = first + 0.2 * random.normal(size=len(first)), last + 5.0 * random.normal(size=len(last))
    given: dict[str, Any] = {"duration": 0.1, "step": 0.1 / random.uniform(15.0, 60.0)}
    if random.random() < 0.7:
        given["controller"] = TorqueSchedule.linear(np.array([0.0, 0.1]), [first, last])
    else:

        def controller(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
            return first + (last - first) * np.sin(20.0 * t) - 0.1 * now.qd, memory

        given["controller"] = controller
    return Scene(chain, state, given)


def rubber_fingers(random: Random) -> Scene:
    """Two Pandas or a hand of three fingers that press with friction, tightly or hardly."""
    if random.random() < 0.6:
        chain, state = rubber_pandas(float(random.uniform(0.3, 1.0)))
        push, shift = float(random.uniform(15.0, 80.0)), 0.05
    else:
        chain, state = hf.assemble(*three_finger_hand())
        push, shift = float(random.uniform(0.4, 3.0)), 0.01
    chain = unlike_limits(random, chain)
    duration = float(random.uniform(0.05, 0.15))
    path = RestToRest(state.object_frame, shift * random.normal(size=3), 0.1 * random.normal(size=3), duration=duration)
    law = ObjectTracking(chain, path, push) if random.random() < 0.5 else GravityCompensation(chain, push, 0.1)
    given = {"duration": duration, "controller": law}
    return Scene(chain, state, given if random.random() < 0.7 else {}, push=push, step=(1e-3, 4e-3))


def rated_grasps(random: Random) -> Scene:
    """Grasps with wrench limits, near those that the motion takes."""
    p = arms_of(random, two_kinds(random))
    tau = hold(p.chain, p.state)
    taken = hf.forward_dynamics(p.chain, p.state, tau).grasp_wrench
    grasps = {}
    for i, (name, grasp) in enumerate(p.chain.grasps.items()):
        sizes = np.maximum(np.linalg.norm(taken[i].reshape(2, 3), axis=1), 1.0)
        grasps[name] = replace(grasp, wrench_limits=WrenchLimits(*(sizes * random.uniform(0.95, 2.0, 2))))
    return Scene(replace(p.chain, grasps=grasps), p.state)


def joint_limits(random: Random) -> Scene:
    """Joints near their limits of position, rate and effort."""
    p = arms_of(random, ("rigid", str(random.choice(["rigid", "ball"]))))
    tau, numbers = hold(p.chain, p.state), iter(range(p.chain.joint_count))
    tight = random.uniform(1.2, 3.0)

    def limited() -> dict[str, Any]:
        k = next(numbers)
        q, rate = float(p.state.q[k]), abs(float(p.state.qd[k]))
        room = 0.1 * random.uniform(0.05, 3.0, 2)
        return {
            "position_limits": (q - room[0], q + room[1]),
            "rate_limit": (rate + 0.3) * random.uniform(1.0, 3.0),
            "effort_limit": (abs(float(tau[k])) + 2.0) * tight * random.uniform(0.7, 2.0),
        }

    return Scene(with_joints(p.chain, limited), p.state)


def limited_robots(random: Random) -> Scene:
    """Two Pandas with their own limits, pushed about."""
    chain, state = two_pandas()
    chain, tau = unlike_limits(random, chain), hold(chain, state, 20.0)
    shove, rate = 60.0 * random.normal(size=14), random.uniform(5.0, 40.0)

    def controller(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        return tau + shove * np.sin(rate * t) - 1.0 * now.qd, memory

    return Scene(chain, state, {"controller": controller} if random.random() < 0.6 else {}, step=(1e-3, 3e-3))


def events(random: Random) -> Scene:
    """Arms that let go and grip again, or others, at given times."""
    p = arms_of(random, tuple(random.choice(["rigid", "hinge", "ball", "softfinger"], 3).tolist()))
    names, duration = list(p.chain.names), float(random.uniform(0.02, 0.06))
    first, second, third = (float(t) for t in np.sort(random.uniform(0.1, 0.95, 3)) * duration)
    grasp = Grasp(str(random.choice(["rigid", "hinge", "ball"])), p.chain.grasps[names[2]].frame)  # type: ignore[arg-type]
    happening: list[Any] = [Release(first, names[2]), Attach(second, names[2], grasp, here=True)]
    if random.random() < 0.5:
        happening.append(Release(third, names[1]))
    return Scene(p.chain, p.state, {"duration": duration, "events": happening}, push=float(random.choice([0.0, 10.0])))


def hand_over(random: Random) -> Scene:
    """A robot grips the box that another one carries, which lets go."""
    chain, state = two_pandas()
    alone = unlike_limits(random, chain.without_grasp("right"))
    grip, go = sorted(float(t) for t in random.uniform(0.01, 0.07, 2))
    path = RestToRest(state.object_frame, [0.0, 0.0, 0.02], duration=0.08)
    law = ObjectTracking(alone, path) if random.random() < 0.5 else GravityCompensation(alone, joint_damping=0.1)
    given = {"duration": 0.08, "controller": law}
    given["events"] = [Attach(grip, "right", chain.grasps["right"], here=True), Release(go, "left")]
    return Scene(alone, state, given, step=(1e-3, 4e-3))


def singular_cranks(random: Random) -> Scene:
    """A bar on parallel cranks, which pass a singular configuration, or unequal ones, which pass near one."""
    longer = float(10 ** random.uniform(-5.0, -2.0)) if random.random() < 0.2 else 0.0
    cranks = parallel_cranks(int(random.integers(1000)), longer)
    given: dict[str, Any] = {"duration": float(random.uniform(0.25, 0.35)), "inputs": None}
    law = hf.ControlLaw(lambda t, now, memory, given: (0.0 * now.qd, memory))
    given["controller"] = law if random.random() < 0.5 else lambda t, now, memory: (0.0 * now.qd, memory)
    given["on_singular"] = "continue" if random.random() < 0.7 else "stop"
    given["scheme"] = str(random.choice(["rk4", "dop853"], p=[0.75, 0.25]))
    return Scene(cranks.chain, cranks.state, given, step=(5e-3, 1e-2))


def singular_four_bars(random: Random) -> Scene:
    """The N-four-bar just before a singular configuration."""
    cranks, angle = int(random.integers(2, 5)), float(random.uniform(0.05, 0.4))
    chain, _ = n_four_bar(cranks)
    rate = -float(random.uniform(2.0, 5.0))
    pose = [1, 0, 0, 0, 0.5 * (cranks - 1) + np.cos(angle), np.sin(angle), 0]
    twist = [0, 0, 0, -rate * np.sin(angle), rate * np.cos(angle), 0]
    state = hf.State(np.full(cranks, angle), np.full(cranks, rate), pose, twist)
    given: dict[str, Any] = {"duration": float(random.uniform(0.05, 0.2)), "inputs": None, "largest_drift": None}
    given["on_singular"] = "continue" if random.random() < 0.7 else "stop"
    given["scheme"] = str(random.choice(["rk4", "dop853"], p=[0.75, 0.25]))
    return Scene(chain, state, given, ("no torques", "constant", "constant law", "function"), step=(1e-3, 5e-3))


def straight_arms(random: Random) -> Scene:
    """Arms that are straight, or nearly so."""
    bend = float(random.choice([0.0, 1e-6, 1e-3, 0.03, 0.1]))
    p = as_chain(one_straight_arm_of_three(bend, (0,), int(random.integers(8))))
    return Scene(p.chain, p.state, {"inputs": None}, ("no torques", "constant", "function", "object tracking"))


def dependent_rows(random: Random) -> Scene:
    """Mechanisms with rows of the constraint that follow from others."""
    if random.random() < 0.5:
        chain, state = line_symmetric(int(random.integers(1000)))
    else:
        chain, state = bricard(tuple(random.uniform(-2.0, 2.0, 2)))
    laws = ("no torques", "constant", "constant law", "function", "linear schedule", "joint springs")
    return Scene(chain, state, laws=laws, step=(1e-3, 8e-3))


def platforms(random: Random) -> Scene:
    """A Stewart platform on balls: six arms whose forces are unique together."""
    p = as_chain(stewart_platform(int(random.integers(1000)), joint_speed=0.3))
    return Scene(p.chain, p.state, {"inputs": None}, ("no torques", "constant law", "function"))


def continued(random: Random) -> Scene:
    """Runs that are continued from a checkpoint."""
    scene = (grasp_kinds, events, joint_limits, slipping_fingers)[int(random.integers(4))](random)
    return replace(scene, continued=True)


def refused(random: Random) -> Scene:
    """Runs that are refused, or end by what a controller, a wrench or a state says."""
    p = arms_of(random, ("rigid", str(random.choice(["rigid", "ball"]))))
    chain, state, tau = p.chain, p.state, hold(p.chain, p.state)
    duration = 0.03
    late, n = float(random.uniform(0.0, duration)), chain.joint_count

    def turning(bad: Any) -> Callable[..., Any]:
        return lambda t, now, memory: (tau if t < late else bad, memory)

    cases: list[dict[str, Any]] = [
        {"controller": turning(np.full(n, np.nan))},
        {"controller": turning(np.zeros(n + 1))},
        {"controller": turning(1e9 * tau + 1e9)},
        {"controller": turning(1e200 * (tau + 1.0))},
        {"controller": lambda t, now, memory: (tau, memory) if t < late else tau},
        {"controller": lambda t, now, memory: (tau / (t < late) if t < late else 1 // 0, memory)},
        {"state": replace(state, q=state.q + 0.05)},
        {"state": replace(state, qd=state.qd + 0.5)},
        {"scheme": "euler"},
        {"events": [Attach(late + 1e-3, chain.names[0], chain.grasps[chain.names[0]])]},
        {"events": [Release(1e-3, chain.names[0]), Attach(late + 2e-3, chain.names[0], chain.grasps[chain.names[0]])]},
        {"inputs": lambda t: hf.Inputs(object_wrench=np.full(6, 1.0 if t < late else np.nan))},
        {"sample_time": -1.0},
        {"parameters": {"gain": np.zeros(3)}},
    ]
    chosen = cases[int(random.integers(len(cases)))]
    return Scene(chain, state, {"duration": duration, "inputs": None, **chosen})


FAMILIES: dict[str, Callable[[Random], Scene]] = {
    made.__name__.replace("_", " "): made
    for made in (
        grasp_kinds, trunks, floating_bases, springs, bushings, soft_joints, stiff_joints, high_gains, moving_bases,
        anchors, free_arms, slipping_fingers, rubber_fingers, rated_grasps, joint_limits, limited_robots, events,
        hand_over, singular_cranks, singular_four_bars, straight_arms, dependent_rows, platforms, continued, refused,
    )
}  # fmt: skip
