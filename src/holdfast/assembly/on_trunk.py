"""Closing chains with a trunk, in its preferred configuration or in another one for which the arms reach."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.assembly import starts
from holdfast.dynamics.closing import close
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.errors import ClosureError, ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

TRUNK_STARTS = 12  # starting configurations of a trunk if the arms do not reach from the preferred one
ENOUGH = 3  # number of such configurations found, of which the nearest is tried first

# function of a chain without a trunk and of preferred configurations that returns a closed state
CloseArms = Callable[[ClosedChain, Mapping[str, Any]], State]


def on_own_bases(chain: ClosedChain, state: State) -> tuple[ClosedChain, State]:
    """Return the chain without its trunk, with the arms' bases at their poses, and the state without the trunk."""
    if chain.trunk is None:
        return chain, state
    arms = base_kinematics(chain, state, Inputs().shaped(chain)).arms
    alone = ClosedChain(arms, chain.held_object, chain.grasps, chain.gravity)
    first = chain.joint_count - alone.joint_count
    return alone, State(state.q[first:], state.qd[first:], state.object_pose, state.object_twist)


def assembled_on_trunk(
    chain: ClosedChain, q: Mapping[str, Any] | None, object_pose: Pose | None, base_pose: Any, close_arms: CloseArms
) -> State:
    """Return a closed state of a chain with a trunk, at rest.

    Args:
        chain: the chain.
        q: preferred joint positions by arm name, and of "trunk".
        object_pose: pose of the object; None to determine it.
        base_pose: pose of a floating base, which is not changed; None for the world's origin.
        close_arms: closes a chain without a trunk.

    Raises:
        ModelError: a pose is given for a base that does not float.
        StateError: preferred positions have a wrong length.
        ClosureError: no configuration of the trunk is found for which every arm reaches its grasp.
    """
    given = dict(q) if isinstance(q, Mapping) else q
    own = given.pop(TRUNK, None) if isinstance(given, dict) else None
    wanted, preferred = _trunk_configuration(chain, own), starts.preferred_configurations(chain, given)
    if base_pose is not None and not chain.floats:
        raise ModelError("assemble: base_pose: expected none, as the trunk's base does not float; try trunk.base")
    base = (Pose.identity() if base_pose is None else checks.pose(base_pose, "base_pose")) if chain.floats else None
    place = Pose.identity() if object_pose is None else object_pose
    guess = State(np.concatenate([wanted, *preferred.values()]), np.zeros(chain.joint_count), place, base_pose=base)
    try:
        return _with_trunk_at(chain, guess, preferred, close_arms)
    except ClosureError as cause:
        for moved in _trunk_moved(chain, guess, object_pose is not None):
            try:
                return _with_trunk_at(chain, moved, preferred, close_arms)
            except ClosureError:
                continue
        raise ClosureError(
            f"{cause} (with the trunk in its preferred configuration; no other was found to help)"
        ) from cause


def _trunk_configuration(chain: ClosedChain, given: Any) -> Array:
    """Return the trunk's preferred joint positions: the given ones, the middle of the limits, or 0 without limits."""
    assert chain.trunk is not None
    if given is not None:
        return starts.preferred_positions(given, chain.trunk.joint_count, TRUNK)
    serial = chain.trunk.serial
    return np.zeros(0) if serial is None else starts.preferred_configuration(serial)


def _with_trunk_at(chain: ClosedChain, at: State, preferred: Mapping[str, Any], close_arms: CloseArms) -> State:
    """Return the closed state with the trunk in its given configuration."""
    found = close_arms(on_own_bases(chain, at)[0], preferred)
    first = chain.joint_count - len(found.q)
    q = np.concatenate([at.q[:first], found.q])
    return State(q, 0.0 * q, found.object_pose, base_pose=at.base_pose)


def _trunk_moved(chain: ClosedChain, guess: State, hold_object: bool) -> Iterator[State]:
    """Yield closed states with other trunk configurations, in order of distance from the preferred one."""
    assert chain.trunk is not None
    serial, own = chain.trunk.serial, chain.joints[TRUNK]
    if serial is None:
        return
    found = []
    for start in starts.starting_configurations(serial, guess.q[own], TRUNK_STARTS):
        q = np.array(guess.q)
        q[own] = start
        try:
            closed = close(chain, replace(guess, q=q), hold_object=hold_object, hold_trunk=False, hold_base=True)
        except ClosureError:
            continue
        found.append(closed)
        if len(found) == ENOUGH:
            break
    found.sort(key=lambda at: float(np.linalg.norm(at.q[own] - guess.q[own])))
    yield from found
