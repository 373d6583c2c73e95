"""What can be adjusted in a chain: its frames, the bodies between them, and the closures that show where they are.

A chain is a forest of bodies; every body stands on its parent by one or two constant poses and a joint, and every
closure compares a frame on one body with a frame on another. Each of these constant poses T may be adjusted,

    T' = (exp(w) R, p + t)        along the parent's axes: bases, grasps, tips, markers, sensors
    T' = (R exp(w), p + R t)      along its own axes: joints

An offset of a joint turns or shifts its pose along the joint's axis. The four other corrections of a turning joint, two
turns and two shifts across its axis, are those of a line in space; a sliding joint has two turns. With the six of a
tip, these are the minimal set of the product of exponentials (Okamura and Park 1996), 4 R + 2 P + 6.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.calibration.postures import FrameMeasurement
from holdfast.errors import MethodNotApplicable, ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.closure import Closure
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_rows import row_name
from holdfast.model.joint import Joint
from holdfast.model.joint_types import first_across, second_across
from holdfast.model.trunk import TRUNK
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

GROUPS = ("bases", "grasps", "loops", "tips", "offsets", "geometry", "markers", "sensors")
AXIS_NAMES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Unknown(Frozen):
    """One number that is sought.

    Attributes:
        name: such as `base right shift z` or `offset left/joint2`.
        words: what it is, in words.
        group: one of `GROUPS`.
        owner: the arm, joint, grasp, loop or measurement to which it belongs.
        turns: whether it is an angle [rad]; otherwise it is a length [m].
    """

    name: str
    words: str
    group: str
    owner: str
    turns: bool


@dataclass(frozen=True, eq=False)
class AdjustableFrame(Frozen):
    """A constant pose, and the directions along which it is sought.

    Attributes:
        pose: its value in the model.
        own_axes: whether corrections are along its own axes; otherwise along its parent's.
        unknowns: the indices of its unknowns.
        directions: (6, d) their directions [turn; shift].
    """

    pose: Pose
    own_axes: bool
    unknowns: tuple[int, ...]
    directions: Array


@dataclass(frozen=True, eq=False)
class PlacedBody(Frozen):
    """A body of the forest.

    Attributes:
        parent: its parent; None for the world.
        frames: the poses by which its joint stands on the parent, one after the other.
        joint: its joint; None for a free body.
        position: where the joint begins in q.
    """

    parent: int | None
    frames: tuple[int, ...]
    joint: Joint | None
    position: int


@dataclass(frozen=True, eq=False)
class Meeting(Frozen):
    """A grasp, a loop or a measurement: frame a, seen from frame b, is where some directions are closed.

    Attributes:
        name: name of the grasp, loop or measurement.
        measured: whether it is a measurement.
        a: body and frames of frame a; None for the world.
        b: likewise.
        turns: (t, 9) the closed angles as linear functions of the attitude of a in b, by rows.
        shifts: the closed lengths, of the axes of b.
        target: measured attitudes and positions of a in b's last frame, or None.
    """

    name: Any
    measured: bool
    a: tuple[int | None, tuple[int, ...]]
    b: tuple[int | None, tuple[int, ...]]
    turns: Array
    shifts: tuple[int, ...]
    target: tuple[Array, Array] | None = None


@dataclass(frozen=True, eq=False)
class FrameLayout(Frozen):
    """The frames, bodies and meetings of a chain; see the module."""

    unknowns: tuple[Unknown, ...]
    frames: tuple[AdjustableFrame, ...]
    bodies: tuple[PlacedBody, ...]
    meetings: tuple[Meeting, ...]
    names: Mapping[str, int]  # of frames


class _Frames:
    """Frames and unknowns while they are collected."""

    def __init__(self, seek: Sequence[str]) -> None:
        self.seek, self.met = seek, set[str]()
        self.frames: list[AdjustableFrame] = []
        self.unknowns: list[Unknown] = []
        self.names: dict[str, int] = {}

    def wanted(self, group: str, owner: str, by_default: bool = True) -> bool:
        """Return whether a group, or this part of it, is sought."""
        own = [f"{group}:{owner}", f"{group}:{owner.partition('/')[0]}"]
        self.met.update(own)
        return (group in self.seek and by_default) or any(one in self.seek for one in own)

    def add(self, name: str, pose: Pose, columns: Sequence[tuple[Unknown, Array]] = (), own_axes: bool = False) -> int:
        """Return the index of a frame, which is added if there is none of this name."""
        if name not in self.names:
            first = len(self.unknowns)
            self.unknowns += [unknown for unknown, _ in columns]
            directions = np.array([direction for _, direction in columns]).reshape(-1, 6).T
            self.names[name] = len(self.frames)
            mine = tuple(range(first, len(self.unknowns)))
            self.frames.append(AdjustableFrame(pose, own_axes, mine, directions))
        return self.names[name]

    def six(self, group: str, kind: str, owner: str, pose: Pose, by_default: bool = True) -> int:
        """Return the index of a frame that is sought along all six directions of its parent, or along none."""
        columns = []
        if self.wanted(group, owner, by_default):
            for k in range(6):
                turns, axis = k < 3, AXIS_NAMES[k % 3]
                what = f"the turn of the {kind} of '{owner}' about {axis}"
                if not turns:
                    what = f"the position of the {kind} of '{owner}' along {axis}"
                name = f"{kind} {owner} {'turn' if turns else 'shift'} {axis}"
                columns.append((Unknown(name, what, group, owner, turns), np.eye(6)[k]))
        return self.add(f"{kind} {owner}", pose, columns)

    def of_joint(self, name: str, joint: Joint) -> int:
        """Return the index of the frame of a joint."""
        columns: list[tuple[Unknown, Array]] = []
        if joint.type.quaternion:
            return self.add(f"joint {name}", joint.placement)
        a = joint.axis
        if self.wanted("offsets", name):
            along = np.concatenate([a if joint.turns else 0.0 * a, joint.travel * a])
            one = Unknown(f"offset {name}", f"the offset of joint '{name}'", "offsets", name, joint.turns)
            columns.append((one, along))
        if self.wanted("geometry", name):
            for e, spare in ((first_across(a), "u"), (second_across(a), "v")):
                axis = AXIS_NAMES[int(np.argmax(np.abs(e)))] if np.abs(e).max() > 1.0 - 1e-9 else spare
                for turns in (True, False) if joint.turns else (True,):
                    said = "the turn of the axis of joint" if turns else "the position of the axis of joint"
                    words = f"{said} '{name}' {'about' if turns else 'along'} its {axis}"
                    title = f"axis {name} {'turn' if turns else 'shift'} {axis}"
                    direction = np.concatenate([e, 0.0 * e] if turns else [0.0 * e, e])
                    columns.append((Unknown(title, words, "geometry", name, turns), direction))
        return self.add(f"joint {name}", joint.placement, columns, own_axes=True)


def layout_of(chain: ClosedChain, measured: Mapping[str, FrameMeasurement], seek: Any) -> FrameLayout:
    """Return the layout of a chain. O(n) + O(l).

    Args:
        chain: the chain; bushings count as rigid.
        measured: measurements by name.
        seek: the groups that are sought, or parts of them as `group:owner`.

    Raises:
        ModelError: nothing is sought, or what the chain does not have.
        MethodNotApplicable: a grasp or loop is a screw or a subspace.
    """
    chain = with_rigid_bushings(chain)
    found = _Frames(_checked(seek))
    bodies = _bodies(chain, found)
    meetings = [*_closures(chain, found), *_measurements(chain, measured, found)]
    for one in found.seek:
        if one not in GROUPS and one not in found.met:
            raise ModelError(f"calibrate: seek: got {one!r}.{checks.did_you_mean(one, [*GROUPS, *sorted(found.met)])}")
    if not meetings:
        raise ModelError("calibrate: chain: expected a grasp, a loop or a measurement, got none")
    if not found.unknowns:
        raise ModelError(f"calibrate: seek: the chain has nothing in {', '.join(map(repr, found.seek))}")
    return FrameLayout(tuple(found.unknowns), tuple(found.frames), tuple(bodies), tuple(meetings), found.names)


def with_rigid_bushings(chain: ClosedChain) -> ClosedChain:
    """Return the chain with bushings, whose yield is noise to a calibration, replaced by rigid grasps."""
    if not chain.bushings:
        return chain
    rigid = {name: Grasp("rigid", chain.grasps[name].frame, of=chain.grasps[name].of) for name in chain.bushings}
    return replace(chain, grasps={**chain.grasps, **rigid})


def _checked(seek: Any) -> tuple[str, ...]:
    listed = (seek,) if isinstance(seek, str) else seek
    if not isinstance(listed, (list, tuple)) or not all(isinstance(one, str) for one in listed) or not listed:
        raise ModelError(f"calibrate: seek: expected a list of {', '.join(GROUPS)}, got {checks.short(seek)}")
    return tuple(listed)


def _bodies(chain: ClosedChain, found: _Frames) -> Iterator[PlacedBody] | list[PlacedBody]:
    """Return the bodies of the forest, in its order."""
    bodies: list[PlacedBody] = []
    position = 0
    names = iter(chain.joint_names())
    forest = chain.as_forest.forest

    def on_joints(joints: Sequence[Joint], base: int | None) -> None:
        nonlocal position
        for joint in joints:
            frame = found.of_joint(next(names), joint)
            body = forest.bodies[len(bodies)]
            first = body.parent is None or (base is not None and body.parent in stands)
            frames = (base, frame) if first and base is not None else (frame,)
            bodies.append(PlacedBody(body.parent, frames, joint, position))
            position += joint.type.position_count

    stands: set[int] = set()
    trunk = chain.trunk
    if trunk is not None:
        if chain.floats:
            bodies.append(PlacedBody(None, (), None, 0))
        base = None if chain.floats else found.six("bases", "base", TRUNK, trunk.base, by_default=False)
        on_joints(trunk.joints, base)
    for k, (name, arm) in enumerate(chain.arms.items()):
        stands = set(range(len(bodies)))
        base = found.six("bases", "base", name, arm.base, by_default=k > 0 or trunk is not None)
        on_joints(arm.joints, base)
    bodies += [PlacedBody(None, (), None, 0) for _ in chain.free_objects]
    return bodies


def _closures(chain: ClosedChain, found: _Frames) -> Iterator[Meeting]:
    """Yield the grasps and loops."""
    whole, first_of = chain.as_forest, set[str]()
    for key, index in whole.closures.items():
        closure = whole.forest.closures[index]
        kind = closure.grasp.of_kind
        owner = row_name(key)
        if kind.given is not None or kind.threaded:
            raise MethodNotApplicable(
                f"calibrate: {owner}: expected a grasp whose closed directions are axes, got a {closure.grasp.kind}"
            )
        if key in chain.grasps:
            arm = chain.arms[owner.partition("/")[0]]
            held = chain.held_by(chain.grasps[key], key)
            ends: tuple[int, ...] = (
                found.six("grasps", "grasp", owner, closure.grasp.frame, by_default=held in first_of),
            )
            first_of.add(held)
            if not arm.joints:
                tips: tuple[int, ...] = (found.names[f"base {owner}"], found.six("tips", "tip", owner, arm.tip))
            elif isinstance(key, str) or key[1] in arm.frames:
                tips = (found.six("tips", "tip", owner, closure.tip),)
            else:
                tips = (found.add(f"link {owner}", closure.tip),)
        else:
            given = _loop(chain, owner)
            fixed_a = found.add(f"end a {owner}", closure.tip @ given.tip.inverse())
            fixed_b = found.add(f"end b {owner}", closure.grasp.frame @ given.grasp.frame.inverse())
            tips = (fixed_a, found.six("tips", "tip", owner, given.tip))
            ends = (fixed_b, found.six("loops", "loop", owner, given.grasp.frame))
        opening = np.array([kind.opening(E.reshape(3, 3)) for E in np.eye(9)]).T[list(kind.closed_angles)]
        shifts = tuple(i - 3 for i in (3, 4, 5) if i not in kind.free)
        yield Meeting(key, False, (closure.a, tips), (closure.b, ends), opening, shifts)


def _loop(chain: ClosedChain, owner: str) -> Closure:
    """Return a loop of the chain or, as `arm/loop`, of an arm."""
    arm, _, name = owner.partition("/")
    return chain.arms[arm].loops[name] if name and owner not in chain.loops else chain.loops[owner]


def _measurements(chain: ClosedChain, measured: Mapping[str, FrameMeasurement], found: _Frames) -> Iterator[Meeting]:
    """Yield the measurements."""
    full = 0.5 * np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]])
    for name, one in measured.items():
        checks.name(name, f"measurement: name {name!r}")
        what = f"measurement '{name}': frame"
        marker = found.six("markers", "marker", name, one.marker)
        sensor = found.six("sensors", "sensor", name, one.sensor)
        if one.frame in chain.arms and chain.arms[one.frame].is_serial:
            arm = chain.arms[one.frame]
            body: int | None = chain.as_forest.arms[one.frame][-1] if arm.joints else None
            frames = (found.six("tips", "tip", one.frame, arm.tip), marker)
            if body is None:
                body, frames = chain.mounted_on.get(one.frame), (found.names[f"base {one.frame}"], *frames)
        else:
            body, at = chain.as_forest.frame(chain, one.frame, what)
            frames = (found.add(f"frame {name}", at), marker)
        turns = full if one.posed else full[:0]
        yield Meeting(name, True, (body, frames), (None, (sensor,)), turns, (0, 1, 2), one.targets)
