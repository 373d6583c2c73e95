"""The regressor of a chain, whose equations are linear in the ten inertial parameters (m, h, I_O) of every body.

    tau = sum_k Y_k pi_k + armature qdd + damping qd + stiffness (q - rest) - external wrenches + J^T f
    Y_C pi = w + sum A^T f

The power of a body's wrench along virtual joint rates is linear in both, so Y_k = U_k^T W_k with the twists U_k of unit
rates and the wrenches W_k for unit parameters (docs/theory/derivatives.md). No differences are taken. Arms on a trunk
also load the joints of the trunk, and a floating base by a wrench, whose rows belong to unit twists of the base.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.bias import bias_accelerations
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, link_twists
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.inverse import acceleration_of_base
from holdfast.dynamics.trunk.trunk_power import TrunkCase
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.model.trunk import TRUNK, bodies_of
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, making
from holdfast.spatial.inertia import of_parameters
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import acceleration_gradient, rotate, unrotate
from holdfast.state import Inputs, State, require_fit, shaped_inputs

UNIT_BODIES = [of_parameters(unit) for unit in np.eye(10)]


@called
@dataclass(frozen=True, eq=False)
class Regressor(Frozen):
    """The matrices of a chain's equations at one instant, which are linear in the inertial parameters.

    The parameters of a body are m, hx, hy, hz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz: mass [kg], first moment m c [kg m] and
    inertia [kg m^2], both about the origin of the body's frame (C for the object) and in its axes.
    `inertial_parameters` returns them.

    Attributes:
        object: (6, 10) Y_C with rows [moment; force] about C, world axes. Y_C pi = w + sum A^T f.
        object_wrench: (6,) w, the external wrench and the wrenches of springs, about C, world axes [N m, N].
        links: by arm, (N, N, 10): entry [j, k] is the torque of joint j per parameters of link k, 0 for j > k. For
            "trunk", (n_t, bodies, 10), with the bodies in the order of `Trunk.bodies`: a floating base comes first.
        drives: (n,) torques that do not depend on the parameters of links: armature, damping and joint springs, minus
            external wrenches on the links [N m or N]. The remaining part of tau is J^T f.
        under: by arm on a trunk, (n_t, N, 10): torques of the trunk's joints per parameters of the arm's links.
        base: for "trunk" and by arm on it, (6, bodies, 10): the wrench on a floating base, [moment; force] about its
            origin, world axes, per parameters of the bodies. Empty without a floating base.
        base_wrench: (6,) the part of that wrench that does not depend on the parameters: minus the external wrenches
            and the wrenches of springs. Together with the wrenches of the grasps, the sum is zero.
    """

    object: Array
    object_wrench: Array
    links: Mapping[str, Array]
    drives: Array
    under: Mapping[str, Array] = field(default_factory=dict)
    base: Mapping[str, Array] = field(default_factory=dict)
    base_wrench: Array = field(default_factory=making(np.zeros, 6))

    def joint_torques(self, chain: ClosedChain) -> Array:
        """Return tau - J^T f, (n,), with the parameters of a chain's links."""
        found = self.drives.copy()
        for name, Y in self.links.items():
            found[chain.joints[name]] += _times(Y, links_of(chain, name))
        for name, Y in self.under.items():
            found[chain.joints[TRUNK]] += _times(Y, links_of(chain, name))
        return found

    def wrench_under(self, chain: ClosedChain) -> Array:
        """Return the wrench that a floating base would need without grasp wrenches, (6,), with a chain's parameters."""
        return sum((_times(Y, links_of(chain, name)) for name, Y in self.base.items()), start=self.base_wrench)


def links_of(chain: ClosedChain, name: str) -> Sequence[Link]:
    """Return the links of an arm, or the bodies of the "trunk"."""
    return bodies_of(chain.trunk) if name == TRUNK else chain.arms[name].links


def _times(Y: Array, bodies: Sequence[Link]) -> Array:
    """Return the sum of Y pi over some bodies, (rows,)."""
    return np.einsum("jkp,kp->j", Y, np.array([inertial_parameters(body) for body in bodies]).reshape(-1, 10))


def inertial_parameters(body: HeldObject | Link) -> Array:
    """Return m, h = m c and I about the body's origin (xx, xy, xz, yy, yz, zz), in its axes, (10,). O(1).

    Args:
        body: the object, or a link.

    Raises:
        ModelError: the argument is neither of them.
    """
    checks.instance(body, (HeldObject, Link), "inertial_parameters: body")
    return body.spatial_inertia.parameters


@np.errstate(all="ignore")  # what overflows is refused below
def regressor(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    object_acceleration: ArrayLike,
    *,
    inputs: Inputs | None = None,
    base_acceleration: ArrayLike | None = None,
) -> Regressor:
    """Return the matrices that multiply the inertial parameters of links and object. O(n N) for N joints per arm.

    Args:
        chain: arms and object, whose inertias are not used.
        state: positions and velocities, which are not checked for consistency.
        qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
        object_acceleration: (6,) [omega_dot; v_dot of C], world axes [rad/s^2, m/s^2].
        inputs: external wrenches and base motion; zero by default.
        base_acceleration: (6,) true acceleration of a trunk's floating base, world axes; required if there is one.

    Returns:
        A `Regressor`.

    Raises:
        ModelError: `chain` is not a ClosedChain.
        StateError: a shape is wrong, or numbers overflow.

    Reference:
        Atkeson, An and Hollerbach 1986; `docs/theory/derivatives.md`.
    """
    require_fit(chain, state)
    qdd = checks.numbers(qdd, (chain.joint_count,), "qdd", StateError)
    alpha = checks.numbers(object_acceleration, (6,), "object_acceleration", StateError)
    base = acceleration_of_base(chain, base_acceleration)
    given = shaped_inputs(chain, inputs)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), given)
    found = regressor_of(motion, state, qdd, alpha, base, given)
    for x in (found.object, found.object_wrench, found.drives, found.base_wrench):
        checks.finite(x, "regressor")
    for x in (*found.links.values(), *found.under.values(), *found.base.values()):
        checks.finite(x, "regressor")
    return found


def regressor_of(
    motion: ChainMotion, state: State, qdd: Array, alpha: Array, base: Array | None, given: Inputs
) -> Regressor:
    """Return the regressor of a chain's motion, without checks; see `regressor`.

    Args:
        motion: the chain's motion, for any torques.
        state: its state.
        qdd: (n,) joint accelerations.
        alpha: (6,) acceleration of the object.
        base: (6,) true acceleration of a floating base; None without one.
        given: shaped inputs.
    """
    chain = motion.chain
    pushed = with_force_elements(chain, state, given).object_wrench
    assert pushed is not None
    Y = object_columns(state.object_frame, state.object_twist, alpha - pseudo_gravity(chain))
    parts = moving_parts(motion, qdd, base)
    rows = {name: np.split(part.columns(), part.ends) for name, part in parts.items()}
    loads = {name: np.split(part.loads(), part.ends) for name, part in parts.items()}
    drives = {name: part.drives + loads[name][2] for name, part in parts.items()}
    for name in chain.mounted_on:
        drives[TRUNK] = drives[TRUNK] + loads[name][0]
    return Regressor(
        object=Y,
        object_wrench=pushed,
        links={name: own for name, (_, _, own) in rows.items()},
        drives=np.concatenate([drives[name] for name in chain.joints if name in drives]),
        under={name: rows[name][0] for name in chain.mounted_on},
        base={name: six for name, (_, six, _) in rows.items() if len(six)},
        base_wrench=sum((six for _, six, _ in loads.values() if len(six)), start=np.zeros(6)),
    )


class MovingPart(NamedTuple):
    """The motion of the bodies of an arm or of a trunk, in the axes of each body.

    Attributes:
        R: attitudes.
        V: twists.
        accelerations: accelerations and their gradients, as `bias_accelerations` yields them.
        U: (rows, bodies, 6) twists for unit rates of the trunk's joints below, for unit twists of a floating base, and
            for unit rates of the part's own joints.
        ends: numbers of rows after the first and after the second of these groups.
        wrenches: (bodies, 6) external wrenches about the bodies' origins, world axes; None for none.
        drives: (N,) torques of its own joints that do not depend on the bodies: armature, damping, springs.
    """

    R: Sequence[Array]
    V: Sequence[Array]
    accelerations: Sequence[tuple[Array, Array]]
    U: Array
    ends: tuple[int, int]
    wrenches: Array | None
    drives: Array

    def columns(self) -> Array:
        """Return the generalised forces for unit parameters, (rows, bodies, 10)."""
        W = [
            np.array([body.wrench(a, v[:3], K) for body in UNIT_BODIES]).T
            for v, (a, K) in zip(self.V, self.accelerations, strict=True)
        ]
        return np.einsum("jki,kip->jkp", self.U, np.array(W).reshape(-1, 6, 10))

    def loads(self) -> Array:
        """Return minus the generalised forces of the external wrenches, (rows,)."""
        if self.wrenches is None:
            return np.zeros(len(self.U))
        own = [unrotate(R, w) for R, w in zip(self.R, self.wrenches, strict=True)]
        return -np.einsum("jki,ki->j", self.U, np.array(own).reshape(-1, 6))


def moving_parts(motion: ChainMotion, qdd: Array, base: Array | None) -> dict[str, MovingPart]:
    """Return the moving parts of all arms, and of the trunk if there is one, by name.

    Args:
        motion: the chain's motion.
        qdd: (n,) joint accelerations.
        base: (6,) true acceleration of a floating base; None without one.
    """
    chain, trunk, carried, case = motion.chain, motion.trunk, motion.trunk.carried(qdd, base), motion.trunk_case
    assert case is not None
    found = {TRUNK: moving_trunk(case, qdd[trunk.joints], base)} if trunk.bodies else {}
    for name, arm in motion.arms.items():
        own, below, ends = qdd[chain.joints[name]], np.zeros((0, 6)), (0, 0)
        given = motion.cases[name].moved(carried.get(name)).given
        if name in trunk.mounts:
            by_joints, by_base = trunk.jacobian(name, np.zeros(3))
            below, ends = np.hstack([by_joints, by_base]).T, (by_joints.shape[1], by_joints.shape[1] + by_base.shape[1])
        n = len(own)
        by = [(np.zeros(n), unit) for unit in below] + [(unit, np.zeros(6)) for unit in np.eye(n)]
        moving = of_joints(given.arm, (given.q, given.qd, own), given.base_twist, given.base_acceleration, by)
        found[name] = MovingPart(*moving, ends, given.link_wrenches, arm.passive_torque + arm.arm.armature * own)
    return found


def moving_trunk(case: TrunkCase, qdd: Array, base: Array | None) -> MovingPart:
    """Return the moving part of a trunk for given accelerations of its joints and of a floating base, (6,)."""
    given, R = case.serial.given, case.base.R
    acceleration = given.base_acceleration + (np.zeros(6) if base is None else base)
    six, n = np.eye(6)[: 0 if base is None else 6], len(qdd)
    by = [(np.zeros(n), unit) for unit in six] + [(unit, np.zeros(6)) for unit in np.eye(n)]
    part = MovingPart([], [], [], np.zeros((len(by), 0, 6)), (0, len(six)), case.wrenches, np.zeros(0))
    if base is not None:
        a, v = unrotate(R, acceleration), unrotate(R, given.base_twist)
        U = np.array([[unrotate(R, twist)] for _, twist in by])
        part = part._replace(R=[R], V=[v], accelerations=[(a, acceleration_gradient(a[:3], v[:3]))], U=U)
    moving = of_joints(given.arm, (given.q, given.qd, qdd), given.base_twist, acceleration, by)
    return part._replace(
        R=[*part.R, *moving[0]],
        V=[*part.V, *moving[1]],
        accelerations=[*part.accelerations, *moving[2]],
        U=np.concatenate([part.U, moving[3]], axis=1),
        drives=given.arm.armature * qdd + case.serial.passive_torque(given.q, given.qd, {}),
    )


def of_joints(
    arm: Arm,
    joints: tuple[Array, Array, Array],
    base_twist: Array,
    base_acceleration: Array,
    by: Sequence[tuple[Array, Array]],
) -> tuple[Sequence[Array], Sequence[Array], list[tuple[Array, Array]], Array]:
    """Return the attitudes, twists, accelerations and unit twists of the links of an arm; see `MovingPart`.

    Args:
        arm: the joints and links, on their base.
        joints: positions, rates and accelerations, (N,) each.
        base_twist: (6,) twist of the base, world axes.
        base_acceleration: (6,) acceleration of the base minus [0; g], world axes.
        by: for each row, joint rates and the twist of the base.
    """
    q, qd, qdd = joints
    at = forward_kinematics(arm, q)
    V = link_twists(arm, at, qd, base_twist)
    accelerations = list(bias_accelerations(arm, at, V, qd, base_twist, base_acceleration, qdd))
    U = np.array([link_twists(arm, at, *row) for row in by]).reshape(len(by), len(q), 6)
    return at.R, V, accelerations, U


def object_columns(frame: Pose, twist: Array, acceleration: Array) -> Array:
    """Return Y_C, (6, 10), with rows along world axes.

    Args:
        frame: pose of the object.
        twist: (6,) twist of C, world axes.
        acceleration: (6,) alpha(C) minus [0; g], world axes.
    """
    a, w = unrotate(frame.R, acceleration), twist[:3] @ frame.R
    K = acceleration_gradient(a[:3], w)
    return np.array([rotate(frame.R, body.wrench(a, w, K)) for body in UNIT_BODIES]).T
