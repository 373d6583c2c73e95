"""The function `assemble`, which makes a closed chain and a closed state from arms, an object and grasps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.assembly.limits import longest_reach, required_reach, room_left, with_room
from holdfast.assembly.on_trunk import assembled_on_trunk
from holdfast.assembly.reaching_configurations import reaching_configurations
from holdfast.assembly.report import AssemblyReport, assembly_report
from holdfast.assembly.starts import object_guesses, preferred_configurations, starting_configurations
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.closing import close
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.nearest_posture import nearest_posture
from holdfast.dynamics.posture import Posture, PostureCost
from holdfast.errors import ClosureError, ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import STANDARD_GRAVITY, ClosedChain
from holdfast.model.force_element import ForceElement
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.serial_chain import serial_chain
from holdfast.model.trunk import Trunk
from holdfast.model.world.touching import Touching
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State

ARM_STARTS = 96  # starting configurations for an arm whose preferred configuration does not lead to its grasp
MOST_CLOSED = 6  # number of reaching configurations from which the chain is closed
LIKELIEST = 4  # number of guesses of the object's pose for which each arm is solved separately
BEST = 3  # number of closed states whose configuration is optimised

Starts = Callable[[ClosedChain, Mapping[str, Array]], Iterator[Iterable[State]]]


class Assembly(NamedTuple):
    """A closed chain and a state that satisfies its grasps.

    Attributes:
        chain: the chain.
        state: a closed state at rest.
    """

    chain: ClosedChain
    state: State

    def __repr__(self) -> str:
        """Return the chain and the state."""
        return f"<Assembly of {self.chain!r}\n{self.state!r}>"

    def _repr_html_(self) -> str:
        """Return the chain as it shows itself in notebooks."""
        return self.chain._repr_html_()

    @property
    def report(self) -> AssemblyReport:
        """The report on reach, joint limits, closure and mobility, which can be printed."""
        return assembly_report(self.chain, self.state)


def assemble(
    arms: Mapping[str, Arm],
    held_object: HeldObject,
    grasps: Mapping[str, Grasp],
    *,
    object_pose: Any = None,
    q: Mapping[str, Any] | None = None,
    gravity: Any = STANDARD_GRAVITY,
    trunk: Trunk | None = None,
    mounts: Mapping[str, Any] | None = None,
    base_pose: Any = None,
    posture: Posture | None = None,
    springs: Sequence[ForceElement] = (),
    touching: Touching | None = None,
) -> Assembly:
    """Return the chain, and the closed state whose arms are nearest to their preferred configurations.

        chain, state = assemble({"left": panda(at_left), "right": panda(at_right)}, box, grasps)

    The state minimises the sum of squared differences of the joints, with angles in rad and strokes relative to the
    longest reach, over the self-motions of redundant arms and, if no object pose is given, over the pose of the object.
    It is the best local minimum that is found from a fixed list of starts, so the same input always gives the same
    state. Joints stay away from their limits by 2 % of their range if their preferred positions do; they approach the
    limits only if no other closed state is found. Bushings are unstretched. A trunk has its preferred configuration if
    the arms can reach the object from there, otherwise the nearest one found for which they can. Collisions are not
    checked. The function takes tenths of a second, or seconds if no state is found.

    Args:
        arms: arms by name, with their bases in place (`arm.at(pose)`).
        held_object: the object.
        grasps: grasps by arm name.
        object_pose: pose of the object (a Pose or wxyz_xyz); None to determine it.
        q: preferred joint positions by arm name, or "trunk" [rad or m]; by default the home configuration of a built-in
            robot, or the middle of the joint limits.
        gravity: (3,) gravitational acceleration, world axes [m/s^2].
        trunk: trunk on which arms are mounted, as for `ClosedChain`.
        mounts: links of the trunk on which arms are mounted, by arm name.
        base_pose: pose of a trunk's floating base, which is not changed; None for the world's origin.
        posture: wished joint positions with weights. The arms, the trunk and, if no pose is given, the object then move
            on from the preferred configurations to where the posture costs least, as in `close`.
        springs: force elements of the chain, which do not affect the state.
        touching: what of the object may touch the world, which does not affect the state either.

    Raises:
        ModelError: the parts do not fit, or neither grasps nor an object pose are given.
        StateError: preferred positions have a wrong length.
        ClosureError: an arm cannot reach its grasp; the message gives its name, the missing distance and advice.
    """
    whole = ClosedChain(arms, held_object, grasps, gravity, trunk, mounts or {}, springs, touching=touching)
    serial_chain(whole, "assemble")
    chain = replace(with_slack_bushings(whole), springs=(), touching=None)
    given = None if object_pose is None else checks.pose(object_pose, "object_pose")
    if given is None and not chain.grasps:
        raise ModelError("assemble: expected at least one grasp to find the object's pose, got none; try object_pose=")
    checks.instance(posture, (Posture, type(None)), "assemble: posture")
    if chain.trunk is not None:
        state = assembled_on_trunk(chain, q, given, base_pose, partial(_assembled, given))
    elif base_pose is not None:
        raise ModelError("assemble: base_pose: expected none without a floating trunk; try arm.at(pose)")
    else:
        state = _assembled(given, chain, q)
    if posture is not None:
        state = close(chain, state, hold_object=given is not None, hold_trunk=False, hold_base=True, posture=posture)
    return Assembly(whole, state)


def _assembled(given: Pose | None, chain: ClosedChain, q: Mapping[str, Any] | None) -> State:
    """Return the closed state of arms without a trunk, with the object at its pose if one is given."""
    preferred = preferred_configurations(chain, q)
    if given is None:
        return _nearest(chain, preferred, _starts_somewhere, hold_object=False)
    _require_reach(chain, given)
    at = np.concatenate([np.clip(preferred[name], *arm.position_limits.T) for name, arm in chain.arms.items()])
    for name, grasp in chain.grasps.items():  # the object is fixed, so each arm is solved separately
        alone = ClosedChain({name: chain.arms[name]}, chain.held_object, {name: grasp}, chain.gravity)
        at[chain.joints[name]] = _nearest(alone, preferred, partial(_starts_around, given), hold_object=True).q
    return State(at, 0 * at, given.wxyz_xyz)


def _starts_around(object_pose: Pose, chain: ClosedChain, preferred: Mapping[str, Array]) -> Iterator[Iterable[State]]:
    """Yield states for closing one arm: the preferred one, then those found from many starts, the nearest first."""
    (name,) = chain.arms
    yield [State(preferred[name], 0 * preferred[name], object_pose.wxyz_xyz)]
    yield [State(q, 0 * q, object_pose.wxyz_xyz) for q in _reaching(chain, name, object_pose, preferred)[:MOST_CLOSED]]


def _starts_somewhere(chain: ClosedChain, preferred: Mapping[str, Array]) -> Iterator[Iterable[State]]:
    """Yield states for closing the chain, for each guess of the object's pose: first preferred, then reaching ones."""
    guesses = object_guesses(chain, preferred)
    wanted = np.concatenate([preferred[name] for name in chain.arms])
    yield [State(wanted, 0 * wanted, pose.wxyz_xyz) for pose in guesses]
    states = []
    for pose in guesses[:LIKELIEST]:
        q = wanted.copy()
        for name in chain.grasps:
            q[chain.joints[name]] = next(iter(_reaching(chain, name, pose, preferred)), preferred[name])
        states.append(State(q, 0 * q, pose.wxyz_xyz))
    yield states


def _reaching(chain: ClosedChain, name: str, object_pose: Pose, preferred: Mapping[str, Array]) -> Array:
    """Return configurations in which an arm reaches its grasp, (found, N), by distance from its preferred one."""
    arm = chain.arms[name]
    starts = starting_configurations(arm, preferred[name], ARM_STARTS)
    return reaching_configurations(arm, chain.grasps[name], object_pose, starts, preferred[name])


def _nearest(chain: ClosedChain, preferred: Mapping[str, Array], starts: Starts, *, hold_object: bool) -> State:
    """Return the nearest closed state found from the starts, away from the joint limits if possible.

    Args:
        chain: the chain.
        preferred: joint positions by arm name.
        starts: returns groups of starting states; a later group is used only if no state of the groups before closes.
        hold_object: keep the pose of the object.

    Raises:
        ClosureError: no closed state is found.
    """
    wanted, missed = np.concatenate([preferred[name] for name in chain.arms]), None
    for within in (with_room(chain, preferred), chain):
        missed = None  # the error refers to the arms' own limits and the preferred configurations
        for group in starts(within, preferred):
            closed = []
            for start in group:
                try:
                    closed.append(close(within, start, hold_object=hold_object))
                except ClosureError as cause:
                    missed = missed or cause
            if closed:
                closed.sort(key=lambda state: distance(chain, state, wanted))
                nearest = [_moved_near(within, one, wanted, hold_object=hold_object) for one in closed[:BEST]]
                return min(nearest, key=lambda at: (-room_left(chain, at), round(distance(chain, at, wanted), 9)))
    raise ClosureError(
        f"assemble: no starting point led to a configuration that satisfies the grasps. From the first one: {missed}"
    ) from missed


def _moved_near(chain: ClosedChain, state: State, wanted: Array, *, hold_object: bool) -> State:
    """Return the closed state nearest to joint positions that self-motions from a state lead to."""
    held = np.arange(chain.velocity_count) >= (chain.joint_count if hold_object else chain.velocity_count)
    cost = PostureCost(wanted, 1 / _joint_sizes(chain, state) ** 2)
    return nearest_posture(chain, state, cost, held, *chain.position_limits.T)


def distance(chain: ClosedChain, state: State, wanted: Array) -> float:
    """Return the distance from joint positions, with angles in rad and strokes relative to the longest reach."""
    return float(np.linalg.norm((state.q - wanted) / _joint_sizes(chain, state)))


def _joint_sizes(chain: ClosedChain, state: State) -> Array:
    """Return the units of the joint coordinates, (n,)."""
    return coordinate_sizes(chain_at_rest(chain, state))[: chain.joint_count]


def _require_reach(chain: ClosedChain, pose: Pose) -> None:
    """Refuse an object that is out of reach in every configuration.

    Raises:
        ClosureError: an arm is too short; the message names each such arm and the missing length.
    """
    short = []
    for name in (name for name in chain.grasps if chain.arms[name].joints):  # anchors have no reach
        needed, longest = required_reach(chain, name, pose), longest_reach(chain.arms[name])
        if needed > longest * (1 + 1e-9):
            short.append(
                f"arm '{name}' is {needed - longest:.3g} m short (its contact is {needed:.3g} m from its first joint,"
                f" its longest reach {longest:.3g} m)"
            )
    if short:
        raise ClosureError(
            f"assemble: {'; '.join(short)}. Try an object pose or base poses closer to each other, another"
            " contact, or no object_pose to have one found"
        )


def with_slack_bushings(chain: ClosedChain, names: Iterable[str] | None = None) -> ClosedChain:
    """Return the chain with bushings replaced by rigid grasps; in its closed states, the bushings are unstretched.

    Args:
        chain: the chain.
        names: names of the arms; None for all arms with bushings.
    """
    which = set(chain.bushings if names is None else names) & set(chain.bushings)
    if not which:
        return chain
    grasps = {name: Grasp("rigid", grasp.frame) if name in which else grasp for name, grasp in chain.grasps.items()}
    return replace(chain, grasps=grasps)
