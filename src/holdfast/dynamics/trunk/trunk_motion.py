"""The motion of a trunk: the kinematics and bias of its bodies, from the base outward, and of the bases mounted on it.

zeta(k)    acceleration of body k minus [0; g], without accelerations of the trunk's joints
beta(k)    contribution of the joints' accelerations: beta(k) = phi^T beta(k+1) + H^T a(k)

The trunk's columns are the accelerations to which the arms on it respond: the six components of beta(k) of the body on
which an arm is mounted. If all arms are mounted on the last body, and the trunk has at most five joints, they are the
accelerations of these joints instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.bias import bias_accelerations
from holdfast.dynamics.arm.forward_kinematics import expand, forward_kinematics, link_twists
from holdfast.dynamics.tree.crossing import columns_of
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.trunk import TRUNK
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each
from holdfast.spatial.spatial_vector import (
    acceleration_gradient,
    centripetal,
    rotate,
    shift_twist,
    shift_wrench,
    twist_shift,
    unrotate,
)
from holdfast.state import Inputs, State

FEWER_THAN_SIX = 5  # up to this number, joints have fewer accelerations than a body


class TrunkBody(NamedTuple):
    """One body of a trunk, in world axes about its frame's origin.

    Attributes:
        joint: the joint between the body before and this one; None for a floating base.
        H: (6,) motion subspace of the joint; None for a floating base.
        frame: pose of the body in the world.
        reach: (3,) from the origin of the body before, or of the base, to its own [m].
        twist: (6,) twist.
        zeta: (6,) acceleration without joint accelerations.
        inertia: M(k) of the body alone.
        wrench: (6,) M zeta + b minus external wrenches.
        torque: torque of the drive minus those of dampers and springs [N m or N]; 0 for a floating base.
    """

    joint: Joint | None
    H: Array | None
    frame: Pose
    reach: Array
    twist: Array
    zeta: Array
    inertia: RigidInertia
    wrench: Array
    torque: Scalar


class Mount(NamedTuple):
    """The base of an arm that is mounted on a trunk, in world axes.

    Attributes:
        body: index of its body in `TrunkMotion.bodies`.
        offset: (3,) from the body's origin to the arm's base origin [m].
        frame: pose of the arm's base in the world.
        twist: (6,) twist of the base origin.
        acceleration: (6,) zeta of the base origin.
        columns: (6, c) additional acceleration per acceleration of the trunk's columns.
    """

    body: int
    offset: Array
    frame: Pose
    twist: Array
    acceleration: Array
    columns: Array


class TrunkMotion(NamedTuple):
    """The motion of a trunk. Arms in the world alone stand on one without bodies.

    Attributes:
        bodies: the bodies from the base outward, beginning with a floating base if there is one.
        mounts: the mounted bases, by arm name.
        base: pose of the base frame in the world.
        by_joints: whether the columns are the joints' accelerations.
    """

    bodies: list[TrunkBody]
    mounts: Mapping[str, Mount]
    base: Pose
    by_joints: bool

    @property
    def floats(self) -> bool:
        """Whether the trunk begins with a floating base."""
        return bool(self.bodies) and self.bodies[0].joint is None

    @property
    def joints(self) -> slice:
        """The slice of its joints in q, qd and tau, where they come first."""
        return slice(0, len(self.bodies) - self.floats)

    def at_rest(self) -> TrunkMotion:
        """Return the trunk at the same configuration without torques, velocities, gravity or external wrenches."""
        none = np.zeros(6)
        still = [b._replace(twist=none, zeta=none, wrench=none, torque=0.0) for b in self.bodies]
        mounts = {name: m._replace(twist=none, acceleration=none) for name, m in self.mounts.items()}
        return self._replace(bodies=still, mounts=mounts)

    def accelerations(self, found: TrunkAcceleration) -> list[Array]:
        """Return beta of every body, (6,) each."""
        beta = np.zeros(6) if found.base is None else found.base
        moving = self.bodies[1:] if self.floats else self.bodies
        betas = [beta] if self.floats else []
        for body, qdd in zip(moving, found.qdd, strict=True):
            assert body.H is not None
            beta = shift_twist(body.reach, beta) + qdd * body.H
            betas.append(beta)
        return betas

    def jacobian(self, name: str, reach: Array) -> tuple[Array, Array]:
        """Return the Jacobians of an arm's tip by the trunk's joints (6, n_t) and by its floating base (6, 6).

        Both are zero for an arm that is not mounted on the trunk; without a floating base the second is (6, 0).

        Args:
            name: the arm.
            reach: (3,) from its base origin to its tip point, world axes [m].
        """
        mount, floats = self.mounts.get(name), self.floats
        columns = [np.zeros(6)] * (len(self.bodies) - floats)
        if mount is None:
            return array(columns).reshape(-1, 6).T, np.zeros((6, 6 if floats else 0))
        reach = mount.offset + reach  # from the origin of the body, and later of the bodies before
        for k in reversed(range(mount.body + 1)):
            H = self.bodies[k].H
            if H is not None:
                columns[k - floats] = shift_twist(reach, H)
                reach = self.bodies[k].reach + reach
        return array(columns).reshape(-1, 6).T, twist_shift(reach) if floats else np.zeros((6, 0))

    def under(self, name: str, betas: Sequence[Array]) -> Array | None:
        """Return beta at the base of an arm, (6,); None if it is not mounted on the trunk."""
        mount = self.mounts.get(name)
        return None if mount is None else shift_twist(mount.offset, betas[mount.body])

    def carried(self, qdd: Array, base: Array | None) -> Mapping[str, Array]:
        """Return beta at the bases of the arms on the trunk, (6,) each, by name.

        Args:
            qdd: (n,) accelerations of the joints of trunk and arms.
            base: (6,) true acceleration of a floating base; None without one.
        """
        betas = self.accelerations(TrunkAcceleration(qdd[self.joints], base))
        return {name: shift_twist(mount.offset, betas[mount.body]) for name, mount in self.mounts.items()}

    def loads(self, betas: Sequence[Array], of_arms: Mapping[str, Array]) -> Iterator[tuple[int, list[Array], Array]]:
        """Yield, from the outermost body inward, its index, the loads on it, and the wrench that moves it, (6,) each.

        The wrench is that of the body before, or of the base, about the body's origin, world axes.

        Args:
            betas: per body, the acceleration that is added by the accelerations of the trunk's joints.
            of_arms: by name, the wrench of the trunk on each arm, about the arm's base origin.
        """
        total = np.zeros(6)
        for k in reversed(range(len(self.bodies))):
            body = self.bodies[k]
            loads = [body.wrench + body.inertia.apply(betas[k])]
            loads += [shift_wrench(m.offset, of_arms[name]) for name, m in self.mounts.items() if m.body == k]
            total = sum(loads, start=total)
            yield k, loads, total
            total = shift_wrench(body.reach, total)

    def of_columns(self, name: str, found: TrunkAcceleration, betas: Sequence[Array]) -> Array | None:
        """Return the accelerations of an arm's columns, (c,); None if it is not mounted on the trunk."""
        mount = self.mounts.get(name)
        return None if mount is None else found.qdd if self.by_joints else betas[mount.body]


NO_TRUNK = TrunkMotion([], {}, Pose.identity(), by_joints=False)


class TrunkAcceleration(NamedTuple):
    """The acceleration of a trunk.

    Attributes:
        qdd: (n_t,) accelerations of its joints.
        base: (6,) true acceleration of a floating base, world axes; None without one.
    """

    qdd: Array
    base: Array | None

    def plus(self, other: TrunkAcceleration) -> TrunkAcceleration:
        """Return the sum of both."""
        base = None if self.base is None or other.base is None else self.base + other.base
        return TrunkAcceleration(self.qdd + other.qdd, base)


NO_ACCELERATION = TrunkAcceleration(np.zeros(0), None)  # of a trunk without bodies


def trunk_motion(chain: ClosedChain, state: State, tau: Array, inputs: Inputs) -> TrunkMotion:
    """Return the motion of the chain's trunk. O(n_t).

    Args:
        chain: the chain.
        state: positions and velocities.
        tau: (n,) joint torques.
        inputs: shaped inputs.
    """
    if chain.trunk is None:
        return NO_TRUNK
    part, (twist, zeta) = chain.joints[TRUNK], base_motion(chain, state, inputs)
    damping, stiffness, rest = np.array([(j.damping, j.stiffness, j.rest) for j in chain.trunk.joints]).reshape(-1, 3).T
    torque = tau[part] - damping * state.qd[part] - stiffness * (state.q[part] - rest)
    return _outward(chain, state, state.qd[part], torque, twist, zeta, inputs.trunk_link_wrenches)


def base_motion(chain: ClosedChain, state: State, inputs: Inputs) -> tuple[Array, Array]:
    """Return the twist and the acceleration minus [0; g] of the base of a chain's trunk, (6,) each, world axes.

    For a floating base, whose acceleration is unknown, the acceleration is -[0; g].
    """
    gravity = concatenate([np.zeros(3), chain.gravity])
    if chain.floats:
        assert state.base_twist is not None
        return state.base_twist, -gravity
    assert inputs.trunk_base_twist is not None and inputs.trunk_base_acceleration is not None
    return inputs.trunk_base_twist, inputs.trunk_base_acceleration - gravity


class BaseKinematics(NamedTuple):
    """The kinematics of trunk and bases, for computations without dynamics.

    Attributes:
        trunk: the motion of the trunk.
        arms: by name every arm, with its base at its pose in the world.
        q: by name the joint positions of the arms, (N,) each.
        qd: by name the joint velocities of the arms, (N,) each.
        base_twists: by name twists of the bases, (6,) each, world axes.
    """

    trunk: TrunkMotion
    arms: Mapping[str, Arm]
    q: Mapping[str, Array]
    qd: Mapping[str, Array]
    base_twists: Mapping[str, Array]


def base_kinematics(chain: ClosedChain, state: State, inputs: Inputs) -> BaseKinematics:
    """Return the kinematics of the bodies of the trunk and of the bases of all arms. O(n_t).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs, of which only the base motion matters.
    """
    assert inputs.base_twists is not None
    trunk = trunk_motion(chain, state, np.zeros(chain.joint_count), inputs)
    arms, twists = dict(chain.arms), dict(zip(chain.arms, inputs.base_twists, strict=True))
    for name, mount in trunk.mounts.items():
        arms[name], twists[name] = arms[name].standing_at(mount.frame), mount.twist
    q, qd = ({name: x[chain.joints[name]] for name in arms} for x in (state.q, state.qd))
    return BaseKinematics(trunk, arms, q, qd, twists)


def trunk_at_rest(chain: ClosedChain, state: State) -> TrunkMotion:
    """Return the chain's trunk without torques, velocities, gravity or external wrenches. O(n_t)."""
    if chain.trunk is None:
        return NO_TRUNK
    none, still = np.zeros(6), np.zeros(chain.trunk.joint_count)
    return _outward(chain, state, still, still, none, none, None)


def _outward(
    chain: ClosedChain, state: State, qd: Array, torque: Array, twist: Array, zeta: Array, wrenches: Array | None
) -> TrunkMotion:
    """Return the motion of the trunk, computed from the base outward; see `trunk_motion`."""
    trunk = chain.trunk
    assert trunk is not None
    base = trunk.base if state.base_frame is None else state.base_frame
    bodies = []
    if trunk.floating is not None:
        w, own = twist[:3] @ base.R, unrotate(base.R, zeta)
        of_base = _body(trunk.floating, base.R, w, own, acceleration_gradient(own[:3], w))
        bodies.append(TrunkBody(None, None, base, np.zeros(3), twist, zeta, *of_base, 0.0))
    if trunk.serial is not None:
        bodies += _joints(trunk.serial.standing_at(base), state.q[chain.joints[TRUNK]], qd, torque, twist, zeta)
    if wrenches is not None:
        bodies = [b._replace(wrench=b.wrench - f) for b, f in zip(bodies, wrenches, strict=True)]
    on, by_joints = chain.mounted_on, _answers_by_joints(chain, len(bodies) - 1)
    columns = np.eye(6)
    if by_joints:
        columns = columns_of([body.H for body in bodies], [body.reach for body in bodies])
    stand = each(
        lambda place, body: _mounted_base(place, body, columns),
        [chain.arms[name].base for name in on],
        [(bodies[k].frame, bodies[k].twist, bodies[k].zeta) for k in on.values()],
    )
    mounts = {name: Mount(k, *where) for (name, k), where in zip(on.items(), stand, strict=True)}
    return TrunkMotion(bodies, mounts, base, by_joints)


def _answers_by_joints(chain: ClosedChain, last: int) -> bool:
    """Return whether the columns are the joints' accelerations; see the module's docstring and docs/theory/trunk.md."""
    return not chain.floats and last < FEWER_THAN_SIX and all(k == last for k in chain.mounted_on.values())


def _joints(serial: Arm, q: Array, qd: Array, torque: Array, base_twist: Array, base_zeta: Array) -> list[TrunkBody]:
    """Return the bodies after the joints of the trunk."""
    at = forward_kinematics(serial, q)
    twists = link_twists(serial, at, qd, base_twist)
    zetas = bias_accelerations(serial, at, twists, qd, base_twist, base_zeta)
    before, bodies = serial.base.R, []
    for k, (joint, link, R, V, (zeta, K)) in enumerate(
        zip(serial.joints, serial.links, at.R, twists, zetas, strict=True)
    ):
        frame, of_body = Pose.unchecked(R, at.tip.p - at.reach[k]), _body(link, R, V[:3], zeta, K)
        H, reach = rotate(R, expand(joint, 1.0)), before @ at.l[k]
        bodies.append(TrunkBody(joint, H, frame, reach, rotate(R, V), rotate(R, zeta), *of_body, torque[k]))
        before = R
    return bodies


def _body(link: Link, R: Array, w: Array, zeta: Array, K: Array) -> tuple[RigidInertia, Array]:
    """Return inertia and bias wrench of a body about its origin in world axes; w, zeta and K are in body axes."""
    inertia = link.spatial_inertia
    return inertia.moved(R, np.zeros(3)), rotate(R, inertia.wrench(zeta, w, K))


def _mounted_base(
    place: Pose, body: tuple[Pose, Array, Array], columns: Array
) -> tuple[Array, Pose, Array, Array, Array]:
    """Return the motion of an arm's base that is mounted on a body: offset, frame, twist, zeta and columns.

    Args:
        place: pose of the base relative to the body.
        body: frame, twist and zeta of the body.
        columns: (6, c) acceleration of the body per acceleration of the trunk's columns.
    """
    at, twist, zeta = body
    offset, w = at.R @ place.p, twist[:3]
    frame = Pose.unchecked(at.R @ place.R, at.p + offset)
    moving = concatenate([np.zeros(3), centripetal(w, offset)])
    at_base = array([shift_twist(offset, column) for column in columns.T]).T
    return offset, frame, shift_twist(offset, twist), shift_twist(offset, zeta) + moving, at_base
