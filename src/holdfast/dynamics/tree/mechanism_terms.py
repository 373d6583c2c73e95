"""A chain that is answered as a forest in the terms of its forest, and what its forest answers in the chain's terms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.tree.forest_dynamics import forest_positions
from holdfast.dynamics.tree.varied_forest import ForestArguments, MovingBase
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_state, shaped_inputs


class ForestPlace(NamedTuple):
    """Where an array of a chain is among those of its forest.

    Attributes:
        name: the array of the forest.
        rows: its rows.
        shape: the shape in the chain's terms.
    """

    name: str
    rows: slice
    shape: tuple[int, ...]

    def of(self, arrays: Mapping[str, Array], *more: int) -> Array:
        """Return it from arrays of the forest, (*shape, *more), which may have more axes behind their own."""
        return arrays[self.name][self.rows].reshape((*self.shape, *more))

    def add(self, x: Array, arrays: Mapping[str, Array], *more: int) -> None:
        """Add an array of the chain, (*shape, *more), to that of the forest."""
        there = arrays[self.name][self.rows]
        there += x.reshape(there.shape if not more else (*there.shape[: -len(more)], *more))


def mechanism_arguments(
    chain: ClosedChain, state: State, tau: ArrayLike | None = None, inputs: Inputs | None = None
) -> ForestArguments:
    """Return the arguments of a chain's forest. O(bodies + closures).

    Args:
        chain: the chain.
        state: its state.
        tau: (n,) torques of its joints; those of passive joints must be zero. None for zeros.
        inputs: external wrenches and base motion; zero by default.

    Raises:
        StateError: a shape is wrong, a quaternion is not of unit length, or a passive joint has a torque.
    """
    require_state(chain, state)
    torque = np.zeros(chain.joint_count) if tau is None else tau
    torque = checks.numbers(torque, (chain.joint_count,), "tau", StateError)
    given, forest = shaped_inputs(chain, inputs), chain.as_forest.forest
    require_passive(chain, torque)
    drives = np.zeros(forest.velocity_count)
    drives[joint_rows(chain)] = torque
    return ForestArguments(
        forest, *flat_state(chain, state), drives, body_wrenches(chain, given), *_moving_bases(chain, given)
    )


def joint_rows(chain: ClosedChain) -> slice:
    """Return the rows of the joints of trunk and arms among those of the forest's qd, qdd and tau."""
    first = 6 * chain.floats
    return slice(first, first + chain.joint_count)


def driven_joints(chain: ClosedChain) -> Array:
    """Return for every component of the joints' qd whether it has a drive, (n,)."""
    return np.array([joint.actuated for joint in chain.freedoms], dtype=bool)


def chain_arguments(chain: ClosedChain) -> dict[str, ForestPlace]:
    """Return by what forward dynamics of a chain can be differentiated, as parts of `FOREST_ARGUMENTS`.

    Names and meanings are those of `forward_dynamics_vjp`. q is varied in the coordinates of qd; armature and damping
    are those of each joint, and grasp_pose has a row for each grasp and then for each loop, along the axes of body b.
    """
    found = chain.as_forest
    joints, start = joint_rows(chain), len(found.trunk)
    of_objects, several = _of_objects(chain)
    free = slice(joints.stop, joints.stop + 6 * len(found.objects))
    of_links, of_trunk = slice(start, of_objects.start), slice(0, start)
    parts = {name: ForestPlace(name, joints, (chain.joint_count,)) for name in ("q", "qd", "tau")}
    parts |= {"gravity": ForestPlace("gravity", slice(None), (3,))}
    parts |= {"grasp_pose": ForestPlace("grasp_pose", slice(None), (len(found.closures), 6))}
    drives = slice(int(chain.floats), of_objects.start)
    parts |= {name: ForestPlace(name, drives, (drives.stop - drives.start,)) for name in ("armature", "damping")}
    owners = {"link": (of_links, (of_links.stop - start,)), "object": (of_objects, several)}
    owners |= {"trunk_link": (of_trunk, (start,))} if start else {}
    for owner, (rows, lead) in owners.items():
        for what, axes in (("mass", ()), ("com", (3,)), ("inertia", (3, 3)), ("wrench", (6,))):
            parts[f"{owner}_{what}"] = ForestPlace(f"link_{what}", rows, (*lead, *axes))
    poses = {"object": (free, (*several, 6))} | ({"floating": (slice(0, 6), (6,))} if chain.floats else {})
    for owner, (rows, shape) in poses.items():
        parts |= {f"{owner}_pose": ForestPlace("q", rows, shape), f"{owner}_twist": ForestPlace("qd", rows, shape)}
    return parts


def chain_results(chain: ClosedChain) -> dict[str, ForestPlace]:
    """Return the results of forward dynamics of a chain as parts of those of its forest."""
    found, (of_objects, several) = chain.as_forest, _of_objects(chain)
    parts = {
        "qdd": ForestPlace("qdd", joint_rows(chain), (chain.joint_count,)),
        "object_acceleration": ForestPlace("acceleration", of_objects, (*several, 6)),
        "grasp_wrench": ForestPlace("closure_wrench", slice(None), (len(found.closures), 6)),
        "coupling_force": ForestPlace("coupling_force", slice(None), (len(found.forest.couplings),)),
    }
    return parts | ({"floating_acceleration": ForestPlace("acceleration", slice(0, 1), (6,))} if chain.floats else {})


def flat_state(chain: ClosedChain, state: State) -> tuple[Array, Array]:
    """Return positions (n_q,) and rates (n_v,) in the order of the bodies of a chain's forest.

    Raises:
        StateError: a quaternion of a spherical joint is not of unit length.
    """
    base_pose, base_twist = (np.zeros(0) if x is None else x for x in (state.base_pose, state.base_twist))
    q = np.concatenate([base_pose, state.q, np.ravel(state.object_pose)])
    return forest_positions(chain.as_forest.forest, q), flat_rates(state.qd, state.object_twist, base_twist)


def flat_rates(of_joints: Array, of_objects: Array, of_base: Array | None) -> Array:
    """Return rates or accelerations in the order of the bodies of a chain's forest, (n_v,)."""
    return np.concatenate([np.zeros(0) if of_base is None else of_base, of_joints, np.ravel(of_objects)])


def chain_state(chain: ClosedChain, q: Array, qd: Array) -> State:
    """Return the state of a chain from positions and rates of its forest; see `flat_state`."""
    return State(**chain_arrays_of(chain, q, qd))


def chain_arrays_of(chain: ClosedChain, q: Array, qd: Array) -> dict[str, Array]:
    """Return views of positions and rates of a chain's forest as the arrays of a `State`."""
    count, floats = len(chain.free_objects), chain.floats
    at_q, at_v = len(q) - 7 * count, len(qd) - 6 * count
    poses, twists = q[at_q:].reshape(-1, 7), qd[at_v:].reshape(-1, 6)
    found = {"q": q[7 * floats : at_q], "qd": qd[6 * floats : at_v]}
    found |= {"base_pose": q[:7], "base_twist": qd[:6]} if floats else {}
    one = count == 1
    return found | {"object_pose": poses[0] if one else poses, "object_twist": twists[0] if one else twists}


def require_passive(chain: ClosedChain, tau: Array) -> None:
    """Refuse torques of passive joints.

    Raises:
        StateError: naming one.
    """
    if not tau[~driven_joints(chain)].any():
        return
    at = 0
    for name, joint in zip(chain.joint_names(), chain.all_joints, strict=True):
        own = tau[at : at + joint.type.freedoms]
        if not joint.actuated and own.any():
            raise StateError(f"tau: joint '{name}' is passive; expected 0, got {checks.short(own.tolist())}")
        at += joint.type.freedoms


def _of_objects(chain: ClosedChain) -> tuple[slice, tuple[int, ...]]:
    """Return the rows of the objects among the bodies, and how many there are if there is not one."""
    count, last = len(chain.free_objects), len(chain.as_forest.forest.bodies)
    return slice(last - count, last), () if count == 1 else (count,)


def body_wrenches(chain: ClosedChain, given: Inputs) -> Array:
    """Return the external wrenches on all bodies, (bodies, 6); `given` are shaped inputs."""
    found = chain.as_forest
    trunk, objects = len(found.trunk), len(found.objects)
    links = len(found.forest.bodies) - trunk - objects
    rows = zip((given.trunk_link_wrenches, given.link_wrenches), (trunk, links), strict=True)
    on_links = [np.zeros((count, 6)) if x is None else x for x, count in rows]
    assert given.object_wrench is not None
    return np.concatenate([*on_links, np.reshape(given.object_wrench, (-1, 6))])


def _moving_bases(chain: ClosedChain, given: Inputs) -> tuple[dict[int, MovingBase], dict[int, MovingBase]]:
    """Return, by body and by closure, the bases in the world that move as prescribed."""
    found, under, behind = chain.as_forest, {}, {}
    forest = found.forest
    if found.trunk and chain.trunk is not None and given.trunk_base_twist is not None and not chain.floats:
        assert given.trunk_base_acceleration is not None
        if given.trunk_base_twist.any() or given.trunk_base_acceleration.any():
            under[0] = MovingBase(chain.trunk.base.p, given.trunk_base_twist, given.trunk_base_acceleration)
    assert given.base_twists is not None and given.base_accelerations is not None
    rows = zip(chain.arms.items(), given.base_twists, given.base_accelerations, strict=True)
    for (name, arm), twist, acceleration in rows:
        if name in chain.mounts or not (twist.any() or acceleration.any()):
            continue
        base, own = MovingBase(arm.base.p, twist, acceleration), found.arms[name]
        under |= {body: base for body in own if forest.bodies[body].parent is None}
        on_base = [f"{name}/{loop}" for loop in arm.loops] if own else [name]
        of_base = (found.closures[key] for key in on_base if key in found.closures)
        behind |= {i: base for i in of_base if forest.closures[i].a is None}
    return under, behind
