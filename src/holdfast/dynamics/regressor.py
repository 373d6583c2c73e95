"""The regressor: a chain's equations are linear in the ten parameters (m, h, I_O) of every body.

    tau = sum_k Y_k pi_k + armature qdd + damping qd + stiffness (q - rest) - external wrenches + J^T f
    Y_C pi = w + sum A^T f

The power of a link's wrench along virtual joint rates is linear in both, so that Y_k = U_k^T W_k: twists U_k of unit
rates, and wrenches W_k that unit parameters need (docs/theory/derivatives.md). Nothing is differenced.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.bias import bias_accelerations
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.arm.velocity import link_twists
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.dynamics.closed.spring_wrenches import with_springs
from holdfast.dynamics.closed.virtual_power import ArmCase
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.inertia import of_parameters
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import acceleration_gradient, rotate, unrotate
from holdfast.state import Inputs, State

UNIT_BODIES = [of_parameters(unit) for unit in np.eye(10)]


@dataclass(frozen=True, eq=False)
class Regressor(Frozen):
    """A chain's equations at one instant, linear in inertial parameters.

    Parameters are m, hx, hy, hz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz of a body: mass [kg], first moment m c [kg m] and
    inertia [kg m^2], both about the origin of the body's own frame and in its axes, of the object about C;
    `inertial_parameters` returns them.

    Attributes:
        object: (6, 10) Y_C: rows [moment; force] about C, world axes. Y_C pi = w + sum A^T f.
        object_wrench: (6,) w: external wrench and springs, about C, world axes [N m, N].
        links: by arm, (N, N, 10): torque of joint j by parameters of link k, [j, k]; 0 where j > k.
        drives: (n,) torques whatever the links' parameters are: armature, damping, joint springs, less external
            wrenches on the links [N m or N]. What is left of tau is J^T f.
    """

    object: Array
    object_wrench: Array
    links: Mapping[str, Array]
    drives: Array

    def joint_torques(self, chain: ClosedChain) -> Array:
        """Return tau - J^T f, (n,), with the parameters of a chain's links."""
        found = [np.zeros(0)]
        for name, Y in self.links.items():
            parameters = np.array([inertial_parameters(link) for link in chain.arms[name].links]).reshape(-1, 10)
            found.append(np.einsum("jkp,kp->j", Y, parameters))
        return np.concatenate(found) + self.drives


def inertial_parameters(body: HeldObject | Link) -> Array:
    """Return (10,) m, h = m c and I about the body's origin (xx, xy, xz, yy, yz, zz), in its axes. O(1).

    Args:
        body: the object, or a link.

    Raises:
        ModelError: neither of them.
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
) -> Regressor:
    """Return the matrices that multiply the inertial parameters of links and object. O(n N), N joints an arm.

    Args:
        chain: arms and object; of their inertias nothing enters.
        state: positions and velocities, taken as they are (no consistency check).
        qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
        object_acceleration: (6,) [omega_dot; v_dot of C], world axes [rad/s^2, m/s^2].
        inputs: external wrenches and base motion; zero by default.

    Returns:
        A `Regressor`.

    Raises:
        ModelError: no chain.
        StateError: wrong shapes.
        MethodNotApplicable: the chain has a trunk, whose motion would add columns for what it carries.

    Reference:
        Atkeson, An and Hollerbach 1986; `docs/theory/derivatives.md`.
    """
    checks.instance(chain, ClosedChain, "regressor: chain")
    checks.instance(state, State, "regressor: state", StateError)
    refuse_trunk(chain, "regressor")
    state.fits(chain)
    qdd = checks.numbers(qdd, (chain.joint_count,), "qdd", StateError)
    alpha = checks.numbers(object_acceleration, (6,), "object_acceleration", StateError)
    checks.instance(inputs, (Inputs, type(None)), "regressor: inputs", StateError)
    given = (inputs or Inputs()).shaped(chain)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), given)
    pushed = with_springs(chain, state, given).object_wrench
    assert pushed is not None
    links = {name: link_columns(case, qdd[chain.joints[name]]) for name, case in motion.cases.items()}
    drives = np.concatenate([drive_rows(motion, name, qdd[part]) for name, part in chain.joints.items()])
    Y = object_columns(state.object_frame, state.object_twist, alpha - pseudo_gravity(chain))
    return Regressor(Y, pushed, links, drives)


def refuse_trunk(chain: ClosedChain, what: str) -> None:
    """Refuse a chain with a trunk.

    Raises:
        MethodNotApplicable: it has one.
    """
    if chain.trunk is not None:
        raise MethodNotApplicable(f"{what}: expected arms on bases of their own, got a trunk; it has no regressor yet")


def object_columns(frame: Pose, twist: Array, acceleration: Array) -> Array:
    """Return Y_C, (6, 10), rows along world axes.

    Args:
        frame: pose of the object.
        twist: (6,) of C, world axes.
        acceleration: (6,) alpha(C) less [0; g], world axes.
    """
    a, w = unrotate(frame.R, acceleration), twist[:3] @ frame.R
    K = acceleration_gradient(a[:3], w)
    return np.array([rotate(frame.R, body.wrench(a, w, K)) for body in UNIT_BODIES]).T


def link_columns(case: ArmCase, qdd: Array) -> Array:
    """Return (N, N, 10) of one arm: torque of joint j by the parameters of link k.

    Args:
        case: what the arm is given.
        qdd: (N,) joint accelerations.
    """
    given, arm = case.given, case.given.arm
    at, n = posture(arm, given.q), arm.joint_count
    V = link_twists(arm, at, given.qd, given.base_twist)
    found = bias_accelerations(arm, at, V, given.qd, given.base_twist, given.base_acceleration, qdd)
    wrenches = [
        np.array([body.wrench(a, v[:3], K) for body in UNIT_BODIES]).T for v, (a, K) in zip(V, found, strict=True)
    ]
    U = np.array([link_twists(arm, at, unit, np.zeros(6)) for unit in np.eye(n)]).reshape(n, n, 6)
    return np.einsum("jki,kip->jkp", U, np.array(wrenches).reshape(n, 6, 10))


def drive_rows(motion: ChainMotion, name: str, qdd: Array) -> Array:
    """Return (N,) torques of an arm that do not depend on its links' parameters; see `Regressor.drives`."""
    given, moving = motion.cases[name].given, motion.arms[name]
    torques = moving.passive + moving.arm.armature * qdd
    if given.link_wrenches is None:
        return torques
    at = moving.at
    external = [unrotate(R, f) for R, f in zip(at.R, given.link_wrenches, strict=True)]
    U = [link_twists(moving.arm, at, unit, np.zeros(6)) for unit in np.eye(len(qdd))]
    return torques - np.array([sum(u @ f for u, f in zip(twists, external, strict=True)) for twists in U])
