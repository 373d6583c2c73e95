"""The motion of a chain that is answered as a forest, from its state, torques and inputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.tree.forest_dynamics import forest_positions
from holdfast.dynamics.tree.forest_motion import Carrier, ForestMotion, forest_motion, moving_world
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_state, shaped_inputs


class MechanismMotion(NamedTuple):
    """A chain in motion as a forest.

    Attributes:
        motion: the forest's motion, in which torques are those of drives less those of dampers and joint springs.
        q: (n_q,) positions in the order of the forest's bodies.
        qd: (n_v,) rates likewise.
    """

    motion: ForestMotion
    q: Array
    qd: Array


def mechanism_motion(chain: ClosedChain, state: State, tau: ArrayLike, inputs: Inputs | None = None) -> MechanismMotion:
    """Return a chain's motion as a forest. O(bodies + closures).

    Args:
        chain: the chain.
        state: its state.
        tau: (n,) torques of its joints; those of passive joints must be zero.
        inputs: external wrenches and base motion; zero by default.

    Raises:
        StateError: a shape is wrong, a quaternion is not of unit length, or a passive joint has a torque.
    """
    require_state(chain, state)
    torque = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    given, found = shaped_inputs(chain, inputs), chain.as_forest
    _require_passive(chain, torque)
    torque = torque - _resistance(chain, state)
    of_forest = found.forest
    q, qd = flat_state(chain, state)
    first, last = (6 if chain.floats else 0), of_forest.velocity_count - 6 * len(found.objects)
    drives = np.zeros(of_forest.velocity_count)
    drives[first:last] = torque
    motion = forest_motion(of_forest, q, qd, drives, _wrenches(chain, given), *_moving_bases(chain, given))
    return MechanismMotion(motion, q, qd)


def flat_state(chain: ClosedChain, state: State) -> tuple[Array, Array]:
    """Return positions (n_q,) and rates (n_v,) in the order of the bodies of a chain's forest.

    Raises:
        StateError: a quaternion of a spherical joint is not of unit length.
    """
    base_pose, base_twist = (np.zeros(0) if x is None else x for x in (state.base_pose, state.base_twist))
    q = np.concatenate([base_pose, state.q, np.ravel(state.object_pose)])
    qd = np.concatenate([base_twist, state.qd, np.ravel(state.object_twist)])
    return forest_positions(chain.as_forest.forest, q), qd


def chain_state(chain: ClosedChain, q: Array, qd: Array) -> State:
    """Return the state of a chain from positions and rates of its forest; see `flat_state`."""
    count, floats = len(chain.free_objects), chain.floats
    at_q, at_v = len(q) - 7 * count, len(qd) - 6 * count
    poses, twists = q[at_q:].reshape(-1, 7), qd[at_v:].reshape(-1, 6)
    of_base = {"base_pose": q[:7], "base_twist": qd[:6]} if floats else {}
    return State(
        q[7 * floats : at_q],
        qd[6 * floats : at_v],
        poses[0] if count == 1 else poses,
        twists[0] if count == 1 else twists,
        **of_base,
    )


def _require_passive(chain: ClosedChain, tau: Array) -> None:
    """Refuse torques of passive joints."""
    at = 0
    for name, joint in zip(chain.joint_names(), chain.all_joints, strict=True):
        own = tau[at : at + joint.type.freedoms]
        if not joint.actuated and own.any():
            raise StateError(f"tau: joint '{name}' is passive; expected 0, got {checks.short(own.tolist())}")
        at += joint.type.freedoms


def _resistance(chain: ClosedChain, state: State) -> Array:
    """Return the torques of dampers and of springs in the joints, (n,), which act against qd and q - rest."""
    found, x = [], 0
    for joint in chain.all_joints:
        spring = joint.stiffness * (state.q[x] - joint.rest) if joint.stiffness else 0.0
        found += [spring] * joint.type.freedoms
        x += joint.type.position_count
    damping = [joint.damping for joint in chain.all_joints for _ in range(joint.type.freedoms)]
    return np.array(found) + np.array(damping) * state.qd


def _wrenches(chain: ClosedChain, given: Inputs) -> Array:
    """Return the external wrenches on all bodies, (bodies, 6)."""
    found = chain.as_forest
    wrenches = np.zeros((len(found.forest.bodies), 6))
    if given.trunk_link_wrenches is not None:
        wrenches[: len(found.trunk)] = given.trunk_link_wrenches
    if given.link_wrenches is not None:
        wrenches[len(found.trunk) : len(wrenches) - len(found.objects)] = given.link_wrenches
    assert given.object_wrench is not None
    wrenches[len(wrenches) - len(found.objects) :] = np.reshape(given.object_wrench, (-1, 6))
    return wrenches


def _moving_bases(chain: ClosedChain, given: Inputs) -> tuple[dict[int, Carrier], dict[int, Carrier]]:
    """Return, by body and by closure, what stands in the world as it moves with a prescribed base."""
    found, under, behind = chain.as_forest, {}, {}
    gravity = np.concatenate([np.zeros(3), chain.gravity])
    parents = found.forest.topology.parents
    if found.trunk and chain.trunk is not None and given.trunk_base_twist is not None and not chain.floats:
        assert given.trunk_base_acceleration is not None
        zeta = given.trunk_base_acceleration - gravity
        under[0] = moving_world(chain.trunk.base.p, given.trunk_base_twist, zeta)
    assert given.base_twists is not None and given.base_accelerations is not None
    rows = zip(chain.arms.items(), given.base_twists, given.base_accelerations, strict=True)
    for (name, arm), twist, acceleration in rows:
        if name in chain.mounts:
            continue
        world, own = moving_world(arm.base.p, twist, acceleration - gravity), found.arms[name]
        under |= {body: world for body in own if parents[body] < 0}
        behind |= {i: world for key, i in found.closures.items() if key == name and not own}
    return under, behind
