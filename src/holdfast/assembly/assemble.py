"""The five-line start: arms, an object and grasps become a closed chain and a closed state of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.assembly.nearest_posture import distance, nearest_posture
from holdfast.assembly.object_guesses import object_guesses
from holdfast.assembly.preferred import preferred_postures, starting_postures
from holdfast.assembly.reach import asked_reach, longest_reach
from holdfast.assembly.report import AssemblyReport, assembly_report
from holdfast.dynamics.closing import close
from holdfast.errors import ClosureError, ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import STANDARD_GRAVITY, ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State

STARTS = 10  # postures an arm is closed from, if the preferred one does not lead to a closed one
BEST = 3  # closures whose posture is improved
ROOM = 0.02  # of a joint's range: more room to a limit does not count


class Assembly(NamedTuple):
    """A closed chain and a state of it.

    Attributes:
        chain: the chain.
        state: closed, at rest.
    """

    chain: ClosedChain
    state: State

    @property
    def report(self) -> AssemblyReport:
        """Reach, joint limits, closure and mobility; print it."""
        return assembly_report(self.chain, self.state)


def assemble(
    arms: Mapping[str, Arm],
    held_object: HeldObject,
    grasps: Mapping[str, Grasp],
    *,
    object_pose: Any = None,
    q: Mapping[str, Any] | None = None,
    gravity: Any = STANDARD_GRAVITY,
) -> Assembly:
    """Return the chain, and the closed state whose arms are nearest to their preferred postures.

        chain, state = assemble({"left": panda(at_left), "right": panda(at_right)}, box, grasps)

    Nearest: the smallest sum of squared joint differences, angles in rad and strokes in parts
    of the longest reach, over the self-motions of redundant arms, and over the object's pose
    if none is given; a local minimum, the best of those that a fixed list of starts leads to,
    so the same input gives the same state. Closures with room to the joint limits come first.
    Collisions are not checked. Tenths of a second; seconds where nothing closes.

    Args:
        arms: arm by name, mounted (`arm.at(pose)`).
        held_object: the object.
        grasps: grasp by arm name.
        object_pose: where the object is (a Pose or wxyz_xyz); None: found.
        q: preferred joint positions by arm name [rad or m]; where missing, a built-in robot's
            home posture, or the middle of the joint limits.
        gravity: (3,) world axes [m/s^2].

    Raises:
        ModelError: parts that cannot be put together, or neither grasps nor an object pose.
        StateError: preferred positions of the wrong length.
        ClosureError: an arm cannot reach its grasp: which, by how much, and what to try.
    """
    chain = ClosedChain(arms, held_object, grasps, gravity)
    preferred = preferred_postures(chain, q)
    wanted = np.concatenate(list(preferred.values()))
    if object_pose is not None:
        given = checks.pose(object_pose, "object_pose")
        _require_reach(chain, given)
        closures = iter([_closed_around(chain, given, preferred, wanted)])
    elif chain.grasps:
        closures = _closed_somewhere(chain, preferred, wanted)
    else:
        raise ModelError("assemble: expected at least one grasp to find the object's pose, got none; try object_pose=")
    return Assembly(chain, _best(chain, closures, wanted))


def _closed_around(chain: ClosedChain, pose: Pose, preferred: Mapping[str, Array], wanted: Array) -> State:
    """Return the closed state with the object held: each arm is alone."""
    q = np.clip(wanted, *np.concatenate([arm.position_limits for arm in chain.arms.values()]).T)
    for name, grasp in chain.grasps.items():
        alone = ClosedChain({name: chain.arms[name]}, chain.held_object, {name: grasp})
        starts = starting_postures(chain.arms[name], preferred[name], STARTS)
        found = _closures(alone, (State(start, 0 * start, pose.wxyz_xyz) for start in starts), preferred[name], True)
        q[chain.joints[name]] = _best(alone, found, preferred[name]).q
    return State(q, 0 * q, pose.wxyz_xyz)


def _closed_somewhere(chain: ClosedChain, preferred: Mapping[str, Array], wanted: Array) -> Iterator[State]:
    """Yield closed states nearest to the preferred postures, from every guess of the object's pose."""
    guesses = [State(wanted, 0 * wanted, pose.wxyz_xyz) for pose in object_guesses(chain, preferred)]
    return _closures(chain, guesses, wanted, False)


def _closures(chain: ClosedChain, starts: Iterable[State], wanted: Array, hold_object: bool) -> Iterator[State]:
    """Return the nearest closed states from so many starts; an arm alone needs no other if the first one serves.

    Raises:
        ClosureError: none of them closes.
    """
    closed, cause = [], None
    for start in starts:
        try:
            closed.append(close(chain, start, hold_object=hold_object))
        except ClosureError as missed:
            cause = cause or missed  # the preferred start's
            continue
        if hold_object and cause is None and _room(chain, closed[0]) >= ROOM:
            break
    if not closed:
        assert cause is not None
        raise ClosureError(f"assemble: no start of a search closes. From the first one: {cause}") from cause
    closed.sort(key=lambda state: distance(chain, state, wanted))
    return (nearest_posture(chain, state, wanted, hold_object=hold_object) for state in closed[:BEST])


def _best(chain: ClosedChain, states: Iterable[State], wanted: Array) -> State:
    """Return the state with room to the limits that is nearest to the preferred posture."""
    return min(states, key=lambda state: (-_room(chain, state), round(distance(chain, state, wanted), 9)))


def _room(chain: ClosedChain, state: State) -> float:
    """Return the smallest margin to a joint limit, as part of the joint's range, up to `ROOM`."""
    low, high = np.concatenate([arm.position_limits for arm in chain.arms.values()]).T
    span = np.where(np.isfinite(high - low), high - low, 2 * np.pi)
    margin = np.minimum(state.q - low, high - state.q) / np.maximum(span, 1e-300)
    return float(np.clip(margin.min(), 0.0, ROOM))


def _require_reach(chain: ClosedChain, pose: Pose) -> None:
    """Refuse an object that no posture at all could reach.

    Raises:
        ClosureError: naming each arm, and how much it is short.
    """
    short = []
    for name in chain.grasps:
        asked, longest = asked_reach(chain, name, pose), longest_reach(chain.arms[name])
        if asked > longest * (1 + 1e-9):
            short.append(
                f"arm '{name}' is {asked - longest:.3g} m short (its contact is {asked:.3g} m from its first joint, its"
                f" longest reach {longest:.3g} m)"
            )
    if short:
        raise ClosureError(
            f"assemble: {'; '.join(short)}. Try an object pose or base poses nearer by, another contact, or no"
            " object_pose to have one found"
        )
