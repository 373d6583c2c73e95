"""The systems of the benchmark: l arms with N revolute joints that hold a box rigidly, in many closed states."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import Arm, ClosedChain, Friction, Grasp, HeldObject, Joint, Link, Pose, State
from holdfast.dynamics import tip_jacobian, tip_pose
from holdfast.errors import ClosureError
from holdfast.robots import HOME, panda
from holdfast.robots.panda import FR3_ARMATURE
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_twist

STATES = 32  # states per system, so that data do not stay in the fastest cache
STATES_OF_MANY_ARMS = 8
MANY_ARMS = 64
PANDA_JOINTS = 7
LIGHTEST = 0.2  # ratio of the masses of an arm's last and first link, in addition to the Panda's own
RADIUS = 0.25  # radius of the box at the grasps [m]
CLOSED = 1e-13  # rad and m
LONGEST_STEP = 0.2  # largest change of a joint in one iteration [rad]


@dataclass(frozen=True, eq=False)
class System:
    """A chain and the states at which it is timed; the first axis of every array is the state.

    Attributes:
        name: "l x N".
        chain: arms, box, rigid grasps.
        q: (states, n) joint positions [rad].
        qd: (states, n) joint rates [rad/s].
        tau: (states, n) torques [N m].
        object_pose: (states, 7) wxyz_xyz.
        object_twist: (states, 6) [omega; v], world axes.
        base_pose: (states, 7) poses of a floating base; None without one.
        base_twist: (states, 6) twists of that base.
    """

    name: str
    chain: ClosedChain
    q: Array
    qd: Array
    tau: Array
    object_pose: Array
    object_twist: Array
    base_pose: Array | None = None
    base_twist: Array | None = None

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """The arguments of forward dynamics; the first axis is the state."""
        return self.q, self.qd, self.tau, self.object_pose, self.object_twist

    @property
    def base_arrays(self) -> dict[str, Array]:
        """Pose and twist of a floating base by the names of the arguments, as `arrays`; empty without one."""
        given = {"floating_pose": self.base_pose, "floating_twist": self.base_twist}
        return {name: x for name, x in given.items() if x is not None}

    @property
    def states(self) -> int:
        """Number of states."""
        return len(self.q)

    def repeated(self, count: int) -> System:
        """Return the system with its states repeated in turn until there are `count`."""
        given = {name: x for name, x in vars(self).items() if isinstance(x, np.ndarray)}
        return replace(self, **{name: np.resize(x, (count, x.shape[1])) for name, x in given.items()})


def facing_pandas(kind: Any = "rigid", contact: Friction | None = None, **options: Any) -> tuple[ClosedChain, State]:
    """Return two Pandas that face each other and hold a box of 3 kg, at rest; options are those of `panda`."""
    arms = {"left": panda([1, 0, 0, 0, -0.55, 0, 0], **options), "right": panda([0, 0, 0, 1, 0.55, 0, 0], **options)}
    frames = {name: hf.contact_frame([0.15 * x, 0, 0], into=[-x, 0, 0]) for name, x in {"left": -1, "right": 1}.items()}
    grasps = {name: Grasp(kind, frame, contact=contact) for name, frame in frames.items()}
    chain, state = hf.assemble(arms, HeldObject.box(3.0, 0.3, 0.2, 0.2), grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.72])
    return chain, state


def make_system(arm_count: int, joint_count: int, states: int | None = None, seed: int = 0) -> System:
    """Return a system in random closed states with consistent velocities.

    The first state is closed by the choice of the base poses. In the others, the box is displaced slightly, and every
    arm follows by inverse kinematics.

    Args:
        arm_count: l >= 1.
        joint_count: N >= 6 per arm.
        states: number of states; by default 32, or 8 for 64 or more arms.
        seed: seed of the random numbers.

    Raises:
        ClosureError: an arm cannot follow the box, which does not happen at the sizes used here.
    """
    random = np.random.default_rng([seed, arm_count, joint_count])
    if states is None:
        states = STATES if arm_count < MANY_ARMS else STATES_OF_MANY_ARMS
    box = HeldObject.box(3.0, 0.4, 0.3, 0.2)
    arm, centre = serial_arm(joint_count), Pose.translation(0.0, 0.0, 0.5)
    home = np.resize(HOME["panda"], joint_count)
    arms, grasps, first = {}, {}, []
    for i in range(arm_count):
        grasp = Grasp("rigid", _place_on_circle(2 * np.pi * i / arm_count))
        q = home + random.uniform(-0.3, 0.3, joint_count)
        tip = tip_pose(arm, q)
        arms[f"arm{i}"], grasps[f"arm{i}"] = arm.at(centre @ grasp.frame @ tip.inverse()), grasp
        first.append(q)
    chain = ClosedChain(arms, box, grasps)
    rows = [_state(chain, np.array(first), centre, random, moved=k > 0) for k in range(states)]
    q, qd, pose, twist = (np.array(column) for column in zip(*rows, strict=True))
    tau = random.uniform(-10.0, 10.0, q.shape)
    return System(f"{arm_count} x {joint_count}", chain, q, qd, tau, pose, twist)


def serial_arm(joint_count: int) -> Arm:
    """Return the Panda, or an arm of the same length that repeats its joints and has lighter links outward."""
    whole = panda(armature=FR3_ARMATURE)
    if joint_count == PANDA_JOINTS:
        return whole
    scale = PANDA_JOINTS / joint_count if joint_count > PANDA_JOINTS else 1.0
    joints, links = [], []
    for k in range(joint_count):
        joint, link = whole.joints[k % PANDA_JOINTS], whole.links[k % PANDA_JOINTS]
        lighter = LIGHTEST ** (k / joint_count)
        mass, inertia = scale * lighter, scale**3 * lighter
        joints.append(
            Joint(
                "revolute",
                joint.axis,
                Pose(joint.placement.R, scale * joint.placement.p),
                name=f"joint{k + 1}",
                armature=scale * lighter * joint.armature,
            )
        )
        links.append(Link(mass * link.mass, scale * link.com, inertia * link.inertia, name=f"link{k + 1}"))
    return Arm(joints, links, Pose(whole.tip.R, scale * whole.tip.p), name="serial")


def _place_on_circle(angle: float) -> Pose:
    """Return a contact frame on the rim of the box, with z into the box."""
    outward = rotation.exp(np.array([0.0, 0.0, angle]))
    inward_z = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    return Pose(outward @ inward_z, outward @ np.array([RADIUS, 0.0, 0.0]))


def _state(
    chain: ClosedChain, near: Array, centre: Pose, random: np.random.Generator, *, moved: bool
) -> tuple[Array, Array, Array, Array]:
    """Return q, qd, object pose and twist of a closed state with consistent velocities."""
    turn, shift = random.uniform(-0.15, 0.15, 3), random.uniform(-0.05, 0.05, 3)
    frame = Pose(rotation.exp(turn) @ centre.R, centre.p + shift) if moved else centre
    twist = random.uniform(-0.5, 0.5, 6)
    positions, rates = [], []
    for (name, grasp), guess in zip(chain.grasps.items(), near, strict=True):
        arm, contact = chain.arms[name], frame @ grasp.frame
        q = follow(arm, guess, contact) if moved else guess
        J = tip_jacobian(arm, q)
        own = random.uniform(-0.5, 0.5, len(q))
        # the rates nearest to random ones with which the tip follows the box, including null-space motion
        rates.append(own + np.linalg.lstsq(J, shift_twist(contact.p - frame.p, twist) - J @ own)[0])
        positions.append(q)
    return np.concatenate(positions), np.concatenate(rates), frame.wxyz_xyz, twist


def follow(arm: Arm, q: Array, target: Pose) -> Array:
    """Return joint positions near q that bring the tip frame to the target.

    Raises:
        ClosureError: Newton's method does not converge.
    """
    left = np.inf
    for _ in range(50):
        tip = tip_pose(arm, q)
        gap = np.concatenate([tip.R @ rotation.log(tip.R.T @ target.R), target.p - tip.p])
        left = float(np.abs(gap).max())
        if left <= CLOSED:
            return q
        step = np.linalg.lstsq(tip_jacobian(arm, q), gap)[0]
        q = q + step * min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
    if left <= 1e3 * CLOSED:  # closed up to rounding
        return q
    raise ClosureError(f"arm '{arm.name}' cannot follow the box: {left:.3g} (rad or m) are left")
