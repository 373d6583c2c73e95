"""Sound calls of parts, paths and controllers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import control, dynamics
from holdfast.model import forest
from tests.fuzz.calls import Later, call, everything, fixed, named, numbers_of, rigid, shown, state_of, stay
from tests.systems.branched import two_arms_with_grippers

# Parts.

POSE = [1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3]
LINK = {"mass": 2.0, "com": np.zeros(3), "inertia": 0.1 * np.eye(3), "name": "body"}
JOINT = {
    "kind": "revolute",
    "axis": np.array([0.0, 0.0, 1.0]),
    "placement": np.array(POSE),
    "name": "waist",
    "position_limits": (-1.0, 1.0),
    "stiffness": 3.0,
    "rest": 0.1,
    "damping": 0.5,
}


@call(
    "Trunk", joints=[JOINT, {"axis": np.array([0.0, 1.0, 0.0])}], links=[LINK, LINK], base=np.array(POSE), floating=LINK
)
def _trunk(joints: Any, links: Any, base: Any, floating: Any) -> Any:
    made = [hf.Joint(**x) if named(x, hf.Joint) else x for x in joints] if isinstance(joints, list) else joints
    bodies = [hf.Link(**x) if named(x, hf.Link) else x for x in links] if isinstance(links, list) else links
    found = hf.Trunk(made, bodies, base, hf.Link(**floating) if named(floating, hf.Link) else floating)
    return repr(found), found.serial, found.freedoms


@call(
    "Spring",
    a=("world", np.zeros(3)),
    b=("arm1", 1, np.ones(3)),
    stiffness=10.0,
    length=0.3,
    damping=1.0,
    chain=Later(lambda: everything().chain),
    state=Later(lambda: numbers_of(everything().state)),
)
def _spring(chain: Any, state: Any, **given: Any) -> Any:
    sprung = replace(chain, springs=[hf.Spring(**given)]) if isinstance(chain, hf.ClosedChain) else chain
    return dynamics.potential_energy(sprung, state_of(state))


call(
    "bushing",
    kind="bushing",
    frame=np.array(POSE),
    stiffness=np.diag([1.0, 2.0, 3.0, 40.0, 50.0, 60.0]),
    damping=np.ones(6),
)(shown(hf.Grasp))
call("grasp by subspace", kind="subspace", frame=np.array(POSE), motion=np.eye(6)[:, [2, 5]])(shown(hf.Grasp))
call("screw", kind="screw", frame=np.array(POSE), pitch=0.01)(shown(hf.Grasp))
call("Anchor", base=np.array(POSE), tip=np.array(POSE), name="pin")(shown(hf.Anchor))
call("Coupling", terms={"left/joint1": 1.0, "left/joint2": -0.5}, offset=0.1)(shown(hf.Coupling))
call("Closure", a="left/rod", b="left/hand", grasp=hf.Grasp("hinge"), tip=np.array(POSE), name="pin")(shown(hf.Closure))
call(
    "Arm with branches",
    joints=[hf.Joint(name=f"j{k}") for k in range(3)],
    links=[hf.Link(1.0, inertia=np.eye(3), name=f"l{k}") for k in range(3)],
    parents=[None, 0, "l0"],
    frames={"pad": ("l2", np.array(POSE))},
    couplings=[hf.Coupling({"j1": 1.0, "j2": -1.0})],
    loops={"pin": hf.Closure("pad", "l1", hf.Grasp("ball"))},
)(shown(hf.Arm))
call(
    "chain with branches",
    arms=Later(lambda: dict(two_arms_with_grippers().chain.arms)),
    grasps=Later(lambda: dict(two_arms_with_grippers().chain.grasps)),
    objects={"object": hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)},
    loops={"tie": hf.Closure("arm1/pad1", "arm2/pad2", hf.Grasp("ball"))},
    couplings=[hf.Coupling({"arm1/joint1": 1.0, "arm2/joint1": -1.0})],
)(shown(hf.ClosedChain))
call(
    "State",
    q=np.zeros(4),
    qd=np.zeros(4),
    object_pose=np.array(POSE),
    object_twist=np.zeros(6),
    base_pose=np.array(POSE),
    base_twist=np.zeros(6),
)(shown(hf.State))
call(
    "ClosedChain",
    arms=Later(lambda: dict(everything().chain.arms)),
    held_object=Later(lambda: everything().chain.held_object),
    grasps=Later(lambda: dict(everything().chain.grasps)),
    gravity=np.array([0.0, 0.0, -9.81]),
    trunk=Later(lambda: everything().chain.trunk),
    mounts=Later(lambda: dict(everything().chain.mounts)),
    springs=Later(lambda: list(everything().chain.springs)),
)(shown(hf.ClosedChain))


call(
    "assemble",
    arms=Later(lambda: dict(fixed().chain.arms)),
    held_object=Later(lambda: fixed().chain.held_object),
    grasps=Later(lambda: dict(fixed().chain.grasps)),
    q=Later(lambda: {name: np.zeros(arm.joint_count) for name, arm in fixed().chain.arms.items()}),
    gravity=np.array([0.0, 0.0, -9.81]),
)(hf.assemble)


call(
    "state_from_joints",
    chain=Later(lambda: rigid().chain),
    q=Later(lambda: np.array(rigid().state.q)),
    qd=Later(lambda: np.zeros(13)),
    check=False,
)(dynamics.state_from_joints)


@call(
    "attach",
    chain=Later(lambda: fixed().chain.without_grasp("arm1")),
    state=Later(lambda: numbers_of(fixed().state)),
    name="arm1",
    grasp=Later(lambda: fixed().chain.grasps["arm1"]),
    here=False,
    tolerance=1e-6,
)
def _attach(state: Any, **given: Any) -> Any:
    return dynamics.attach(state=state_of(state), **given)


@call("a name", theme="dynamics", name="closure")
def _name(theme: Any, name: Any) -> Any:
    return repr(getattr(getattr(hf, str(theme)), str(name)))


@call("a name at the top", name="forward_dynamics")
def _top(name: Any) -> Any:
    return repr(getattr(hf, str(name)))


@call("inertial_parameters", body=hf.HeldObject.box(1.0, 1.0, 1.0, 1.0))
def _inertial(body: Any) -> Any:
    return dynamics.inertial_parameters(body)


@call("of one arm", arm=Later(lambda: fixed().chain.arms["arm1"]), q=np.zeros(4))
def _of_arm(arm: Any, q: Any) -> Any:
    asked = (dynamics.tip_pose, dynamics.tip_jacobian, dynamics.link_poses, dynamics.joint_mass_matrix)
    return [ask(arm, q) for ask in asked]


_FOREST = {
    "link": LINK,
    "joint": {"kind": "planar", "across": np.array([1.0, 0.0, 0.0]), "armature": 0.1, "damping": 0.5},
    "tip": np.array(POSE),
    "terms": [(0, 0, 1.0)],
    "parent": None,
    "gravity": np.array([0.0, 0.0, -9.81]),
}
_FOREST_STATE = {"q": np.zeros(3), "qd": np.zeros(3)}
_FOREST_INPUTS = {**_FOREST_STATE, "tau": np.ones(3), "wrenches": np.zeros((1, 6))}


def _forest(link: Any, joint: Any, tip: Any, terms: Any, parent: Any, gravity: Any) -> Any:
    made = forest.BodyJoint(**joint) if named(joint, forest.BodyJoint) else joint
    body = forest.ForestBody(hf.Link(**link) if named(link, hf.Link) else link, made, parent)
    pin = forest.Closure(None, 0, hf.Grasp("ball", tip), tip)
    return forest.Forest([body], [pin], [forest.JointCoupling(terms)], gravity)


def of_forest(ask: Callable[..., Any], **own: Any) -> None:
    """Add a function of a forest, which is made of numbers, with its own arguments."""

    def asked(link: Any, joint: Any, tip: Any, terms: Any, parent: Any, gravity: Any, **given: Any) -> Any:
        return repr(ask(_forest(link, joint, tip, terms, parent, gravity), **given))

    call(ask.__name__, **_FOREST, **own)(asked)


of_forest(dynamics.forest_dynamics, **_FOREST_INPUTS, method="kkt")
of_forest(dynamics.forest_dynamics_vjp, **_FOREST_INPUTS, by=("q", "link_mass"), qdd=np.ones(3))
of_forest(dynamics.forest_dynamics_jvp, **_FOREST_INPUTS, along={"q": np.ones(3)})
of_forest(dynamics.forest_dynamics_jacobian, **_FOREST_INPUTS, of=("qdd",), by=("tau",))
of_forest(dynamics.forest_inverse_dynamics, **_FOREST_STATE, qdd=np.zeros(3), wrenches=np.zeros((1, 6)))
of_forest(dynamics.forest_balance, **_FOREST_INPUTS, about=np.zeros(3))
of_forest(dynamics.forest_close, **_FOREST_STATE)
of_forest(dynamics.forest_impulse, **_FOREST_STATE)
of_forest(dynamics.forest_diagnose, q=np.zeros(3))
of_forest(dynamics.forest_linearise, **_FOREST_INPUTS)
of_forest(dynamics.forest_simulate, **_FOREST_STATE, duration=1e-2, step=1e-2)


# Paths and control.


@call(
    "PoseSpline",
    poses=[np.array(POSE), hf.Pose.translation(1.0, 0.0, 0.0), hf.Pose.from_rpy(0.0, 0.5, 1.0)],
    times=np.array([0.0, 1.0, 3.0]),
    t=0.7,
)
def _spline(poses: Any, times: Any, t: Any) -> Any:
    return control.PoseSpline(poses, times).at(t)


@call(
    "PoseSpline.at_speed", poses=[np.array(POSE), hf.Pose.from_rpy(0.0, 0.5, 1.0)], speed=0.2, turn_rate=0.5, begin=1.0
)
def _at_speed(poses: Any, speed: Any, turn_rate: Any, begin: Any) -> Any:
    return control.PoseSpline.at_speed(poses, speed, turn_rate, begin=begin).at(1.5)


@call("RestToRest", start=np.array(POSE), displacement=np.ones(3), turn=np.ones(3), begin=0.1, duration=2.0, t=0.7)
def _rest(t: Any, **given: Any) -> Any:
    return control.RestToRest(**given).at(t)


@cache
def slide() -> tuple[hf.ClosedChain, hf.State]:
    """Return an arm with a sliding joint that holds a box."""
    joint = hf.Joint("prismatic", (1, 0, 0), effort_limit=20.0, rate_limit=1.0)
    one = hf.Arm([joint], [hf.Link(2.0, inertia=0.01 * np.eye(3))])
    chain = hf.ClosedChain({"arm": one}, hf.HeldObject.box(3.0, 0.1, 0.1, 0.1), {"arm": hf.Grasp("rigid")})
    return chain, hf.State(np.zeros(1), np.zeros(1), hf.Pose.identity())


@call(
    "time_path",
    displacement=np.array([0.5, 0.0, 0.0]),
    span=(0.0, 2.0),
    nodes=5,
    effort=0.8,
    most_normal={"arm": 50.0},
    acceleration={"arm/joint1": (-3.0, 3.0)},
    t=0.2,
)
def _time_path(displacement: Any, effort: Any, most_normal: Any, acceleration: Any, t: Any, **given: Any) -> Any:
    chain, state = slide()
    path = control.RestToRest(state.object_frame, displacement, duration=2.0)
    limits = hf.forces.ForceLimits(effort, most_normal=most_normal, acceleration=acceleration)
    timed = hf.time_path(chain, state, path, limits, **given)
    return timed.t, timed.at(t).twist, timed.joints_at(t)[2], repr(timed)


@call(
    "follow",
    displacement=0.01 * np.ones(3),
    duration=1.0,
    step=0.25,
    begin=0.1,
    room=0.1,
    strength=0.1,
    smoothing=0.25,
    q={"arm1": 0.1},
    weights=Later(lambda: np.ones(rigid().chain.joint_count)),
    t=0.7,
)
def _follow(displacement: Any, duration: Any, step: Any, q: Any, weights: Any, t: Any, **given: Any) -> Any:
    p = rigid()
    state = p.state.at_rest()
    path = control.RestToRest(state.object_frame, displacement, begin=0.1, duration=1.0)
    found = hf.follow(p.chain, state, path, duration, step, posture=dynamics.Posture(q, weights), **given)
    return found.q, found.qd, found.qdd, found.strength, found.at(t), found.state_at(t), str(found)


@call("CarriedBase", start=np.array(POSE), displacement=np.ones(3), turn=np.ones(3), frame=np.array(POSE), t=0.7)
def _carried(start: Any, displacement: Any, turn: Any, frame: Any, t: Any) -> Any:
    return hf.simulation.CarriedBase(control.RestToRest(start, displacement, turn), frame)(t)


@call(
    "TorqueSchedule",
    knots=np.array([0.0, 1.0]),
    coefficients=[np.ones((10, 2)), np.ones((10, 3))],
    t=1.5,
    state=Later(lambda: numbers_of(fixed().state)),
)
def _schedule(knots: Any, coefficients: Any, t: Any, state: Any) -> Any:
    made = control.TorqueSchedule(knots, coefficients)
    return made(t, state_of(state), None), made.breakpoints


@call("TorqueSchedule.linear", times=np.array([0.0, 1.0]), torques=np.ones((2, 10)), t=0.5)
def _linear(times: Any, torques: Any, t: Any) -> Any:
    return control.TorqueSchedule.linear(times, torques)(t, fixed().state, None)


@call(
    "ObjectTracking",
    internal_force=1.0,
    stiffness=100.0,
    damping=20.0,
    joint_damping=1.0,
    t=0.5,
    state=Later(lambda: numbers_of(fixed().state)),
)
def _tracking(t: Any, state: Any, **given: Any) -> Any:
    p = fixed()
    law = control.ObjectTracking(p.chain, control.RestToRest(p.state.object_frame, [0.1, 0.0, 0.0]), **given)
    return law(t, state_of(state), None)


FORCES = {
    "InternalForce": {"force": np.array([1.0, 2.0])},
    "LoadShare": {"shares": {"arm1": 0.25, "arm2": 0.75}, "force": 2.0},
    "InternalImpedance": {"stiffness": 100.0, "damping": np.ones(6)},
    "RampedForces": {"before": control.InternalForce(1.0), "after": control.LoadShare(), "begin": 0.1, "duration": 0.5},
    "HybridForce": {"gain": 10.0, "sample_time": 1e-3, "limit": 5.0, "late": False},
}


def _under_forces(name: str) -> Any:
    def run(t: Any, measured: Any, **given: Any) -> Any:
        p = fixed()
        motion = control.ObjectImpedance(control.RestToRest(p.state.object_frame), 100.0, 20.0)
        law = control.cooperative_law(p.chain, motion, getattr(control, name)(**given))
        values = {"measured_wrenches": measured} if law.parameters else {}
        return law.given(values)(t, p.state, None)[0]

    return run


for _name, _given in FORCES.items():
    call(_name, t=0.2, measured=np.ones((2, 6)), **_given)(_under_forces(_name))


@call(
    "cooperative_law",
    stiffness=np.ones(6),
    damping=20.0,
    inertia=np.eye(6),
    rest=np.zeros(10),
    frequency=3.0,
    clearance=0.1,
    external_wrench=np.ones(6),
    t=0.5,
    state=Later(lambda: numbers_of(fixed().state)),
)
def _cooperative(
    stiffness: Any, damping: Any, inertia: Any, external_wrench: Any, t: Any, state: Any, **posture: Any
) -> Any:
    p = fixed()
    motion = control.ObjectImpedance(control.RestToRest(p.state.object_frame), stiffness, damping, inertia)
    law = control.cooperative_law(p.chain, motion, posture=control.PostureControl(**posture))
    given = {"external_wrench": external_wrench} if law.parameters else {}
    return law.given(given)(t, state_of(state), None)[0]


@call(
    "admittance_law",
    stiffness=100.0,
    damping=np.ones(6),
    inertia=np.eye(6),
    internal_damping=500.0,
    contact_stiffness=1e4,
    sample_time=1e-3,
    force=1.0,
    measured=np.ones((2, 6)),
    t=0.5,
    state=Later(lambda: numbers_of(fixed().state)),
)
def _admittance(measured: Any, t: Any, state: Any, **given: Any) -> Any:
    p = fixed()
    law = control.admittance_law(p.chain, control.RestToRest(p.state.object_frame), **given)
    return law.given({"measured_wrenches": measured})(t, state_of(state), None)[0]


@call(
    "observed",
    gain=10.0,
    sample_time=1e-3,
    measured=True,
    threshold=5.0,
    release=0.5,
    wrenches=np.ones((2, 6)),
    state=Later(lambda: numbers_of(fixed().state)),
)
def _observed(wrenches: Any, state: Any, **given: Any) -> Any:
    p = fixed()
    law = control.observed(control.GravityCompensation(p.chain), p.chain, **given)
    values = {"measured_wrenches": wrenches} if law.parameters else {}
    tau, memory = law.given(values)(0.0, state_of(state), None)
    return tau, control.observation(law, memory)


@call("unloaded", chain=Later(lambda: fixed().chain), grasp_wrench=np.ones((2, 6)))
def _unloaded(chain: Any, grasp_wrench: Any) -> Any:
    return control.unloaded(chain, grasp_wrench)


@call("GravityCompensation", internal_force=1.0, joint_damping=1.0, state=Later(lambda: numbers_of(fixed().state)))
def _compensation(state: Any, **given: Any) -> Any:
    return control.GravityCompensation(fixed().chain, **given)(0.0, state_of(state), None)


@call(
    "holding_law",
    chain=Later(lambda: fixed().chain),
    each_arm=False,
    acceleration=np.zeros(6),
    internal_force=3.0,
    state=Later(lambda: numbers_of(fixed().state)),
)
def _holding(chain: Any, each_arm: Any, state: Any, **given: Any) -> Any:
    return control.holding_law(chain, each_arm=each_arm).given(given)(0.0, state_of(state), None)


@call(
    "ControlLaw",
    memory=np.zeros(2),
    parameters={"gain": (), "target": (3,)},
    key="k",
    values={"gain": 2.0, "target": np.zeros(3)},
)
def _law(memory: Any, parameters: Any, key: Any, values: Any) -> Any:
    law = hf.ControlLaw(stay, memory, parameters, key)
    return law.given(values)(0.0, fixed().state, None)


@call("clipped", chain=Later(lambda: fixed().chain), torques=np.ones(10))
def _clipped(chain: Any, torques: Any) -> Any:
    return control.clipped(lambda t, state, memory: (torques, memory), chain)(0.0, fixed().state, None)


@call(
    "sampled",
    chain=Later(lambda: fixed().chain),
    sample_time=1e-3,
    delay=5e-4,
    noise={"q": 1e-3, "tau": np.ones(10)},
    seed=1,
    resolution={"qd": 1e-3},
    saturation=30.0,
    rate_limit=1e3,
    stream=3,
)
def _sampled(stream: Any, **given: Any) -> Any:
    law = control.sampled(control.GravityCompensation(fixed().chain), **given)
    return control.noise_stream(law, stream)(0.0, fixed().state, None)
