"""The frames of a run that are shown, a few per second, with everything needed to draw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from holdfast.control.commanded_forces import commanded_internal_wrenches, commands_forces, limits_kept
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.closed.force_elements import end_motions
from holdfast.dynamics.near_singular import arm_strength
from holdfast.dynamics.tree.mechanism_terms import flat_state
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.errors import ModelError
from holdfast.forces.force_split import split
from holdfast.forces.limits import ForceLimits
from holdfast.forces.margins import grasp_margins
from holdfast.forces.row_wrenches import attitudes
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import GraspRow, grasp_rows
from holdfast.model.trunk import TRUNK
from holdfast.model.world.touching import Touching
from holdfast.robots.mesh_files.mesh import MeshFault
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.instant import Instant
from holdfast.simulation.run_outputs import FRAME_RATE
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State
from holdfast.view.figure_style import part_colour
from holdfast.view.link_meshes import LinkMesh, meshes_in_files, notes_on, surface_of_object

DrawnSurfaces = Mapping[str, Sequence[Sequence[LinkMesh]]]
SMALLEST_HOLD = 1e-9  # N
MOST_FRAMES = 20_000  # more take minutes to draw, and as long to load


@dataclass(frozen=True, eq=False)
class Playback:
    """The frames that are shown; the first axis of every array is the frame.

    Attributes:
        chain: the chain.
        title: title of the playback.
        t: (frames,) times [s].
        q: (frames, n) joint positions [rad or m].
        base_pose: (frames, arms, 7) wxyz_xyz of the arms' bases in the world, those on a trunk too.
        trunk_pose: (frames, 7) wxyz_xyz of a trunk's base frame in the world; (frames, 0) without one.
        object_pose: (frames, 7) wxyz_xyz, or (frames, objects, 7).
        tip: (frames, rows, 3) tip points, world axes; for an arm with a grasp, the contact points [m].
        wrench: (frames, rows, 6) wrench of each arm on the object about its tip, world axes [N m, N].
        internal: (frames, rows, 6) internal part of these wrenches, which causes no motion; (frames, 0, 6) if it is not
            known.
        margin: (frames, rows) margin of each grasp [N]; infinite without a limit.
        condition: (frames,) condition of the grasp constraint.
        strength: (frames, arms) strength of each arm's weakest tip direction; 0 at a singular configuration, 1 without
            a grasp.
        tau: (frames, n) joint torques [N m or N].
        visuals: by name, the surfaces of each arm, and of "trunk", that is not drawn with simple solids; see
            `link_meshes`.
        notes: sentences about meshes that cannot be read, which the page shows.
        commanded: (frames, rows, 6) internal wrenches that the controller commands, before integrals and limits; None
            if it is not known.
        limits: the limits that the controller keeps; None if it keeps none, or is not known.
        attached: names of grasps of a chain with branches that close later.
        touch_force: (frames, pairs, 3) forces of the world on the object at its points; None if it touches nothing.
        touching: what may touch in each frame, with moving shapes of the world where they are; () if nothing may.
    """

    chain: ClosedChain
    title: str
    t: Array
    q: Array
    base_pose: Array
    trunk_pose: Array
    object_pose: Array
    tip: Array
    wrench: Array
    internal: Array
    margin: Array
    condition: Array
    strength: Array
    tau: Array
    visuals: DrawnSurfaces = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    commanded: Array | None = None
    limits: ForceLimits | None = None
    attached: Sequence[str] = ()
    touch_force: Array | None = None
    touching: Sequence[Touching] = ()

    @cached_property
    def rows(self) -> Sequence[GraspRow]:
        """What the rows belong to: the arms, or the grasps and loops of a chain that is answered as a forest."""
        return grasp_rows(self.chain, self.attached)

    def __repr__(self) -> str:
        """Return the title, the number of moments and the time of the last one."""
        return f"<Playback '{self.title}': {len(self)} moments, to {self.t[-1]:g} s>"

    def __len__(self) -> int:
        return len(self.t)

    @property
    def holding(self) -> list[str]:
        """The names of the rows with a grasp or a loop in some frame."""
        return [row.name for i, row in enumerate(self.rows) if row.grasp is not None or self.wrench[:, i].any()]

    def row(self, name: str) -> tuple[int, GraspRow]:
        """Return the place of a row, and the row."""
        return next((i, row) for i, row in enumerate(self.rows) if row.name == name)

    def colour(self, name: str) -> str:
        """Return the colour '#rrggbb' of a row: that of its arm, or of what belongs to no arm."""
        arm = self.row(name)[1].arm
        return part_colour(self.chain, TRUNK if arm is None else arm)

    def reserve(self, name: str) -> Array:
        """Return the margin of an arm's friction cone as a share of mu f_n, 0 to 1, (frames,)."""
        i, row = self.row(name)
        if row.grasp is None or row.grasp.contact is None:
            return np.ones(len(self))
        reserve = np.clip(self.margin[:, i] / np.maximum(self._hold(name), SMALLEST_HOLD), 0.0, 1.0)
        return np.where(self.wrench[:, i].any(axis=1), reserve, 1.0)  # an arm that has let go cannot slip

    def grip_use(self, name: str) -> Array:
        """Return the used share of an arm's friction, (frames,): (mu f_n - margin) / (mu f_n - demanded margin).

        It is 1 at the margin that the controller keeps, and without one at the onset of slip; at most 2.
        """
        i, hold = self.row(name)[0], self._hold(name)
        demands = {} if self.limits is None else self.limits.of_grasps("least_margin", self.chain)
        free = np.maximum(hold - demands.get(name, 0.0), SMALLEST_HOLD)
        return np.where(self.wrench[:, i].any(axis=1), np.clip((hold - self.margin[:, i]) / free, 0.0, 2.0), 0.0)

    def _hold(self, name: str) -> Array:
        """Return mu f_n of an arm's contact, (frames,) [N]."""
        i, row = self.row(name)
        assert row.grasp is not None and row.grasp.contact is not None
        R = np.array([attitudes(self.chain, self.state(k), [row.body])[0] for k in range(len(self))])
        return row.grasp.contact.mu * np.sum(R @ row.grasp.frame.R[:, 2] * self.wrench[:, i, 3:], axis=1)

    def state(self, k: int) -> State:
        """Return the state of frame k at rest."""
        below = {"base_pose": self.trunk_pose[k]} if self.chain.floats else {}
        return State(self.q[k], np.zeros(self.chain.joint_count), self.object_pose[k], **below)

    def torque_use(self, name: str) -> Array | None:
        """Return the largest |tau| over its limit of the joints of an arm, or of "trunk", (frames,); None without."""
        return torque_use(self.chain, name, self.tau)


def torque_shares(chain: ClosedChain, name: str, tau: Array) -> Array:
    """Return |tau| over its limit of an arm's joints, or of those of "trunk", (samples, joints); 0 without one."""
    limits = np.array([joint.effort_limit for joint in chain.joints_of[name] for _ in range(joint.type.freedoms)])
    return np.abs(tau[:, chain.joints[name]] / limits)


def torque_use(chain: ClosedChain, name: str, tau: Array) -> Array | None:
    """Return the largest |tau| over its limit of an arm's joints, or of those of "trunk", (samples,); None without."""
    limited = any(np.isfinite(joint.effort_limit) for joint in chain.joints_of[name])
    return torque_shares(chain, name, tau).max(axis=1) if limited else None


def playback_of_run(
    chain: ClosedChain,
    run: Trajectory,
    title: str = "run",
    rate: float = FRAME_RATE,
    base_motion: Mapping[str, BaseMotion] | None = None,
    visuals: DrawnSurfaces | None = None,
    *,
    controller: Any = None,
) -> Playback:
    """Return the playback of a run: the samples nearest to `rate` frames per second, without interpolation.

    Args:
        chain: the chain that was simulated.
        run: the run.
        title: title of the playback.
        rate: frames per second of the run's time.
        base_motion: as for `simulate`.
        visuals: as for `Playback`; None for the visuals in the files of arms and trunk whose meshes can be read.
            `Playback.notes` names the others.
        controller: the run's controller, for the forces that it commands and the limits that it keeps; None if it is
            not known.

    Raises:
        StateError: `run` is not a run, or belongs to another chain.
        ModelError: the rate is not positive or gives more than 20,000 frames, or a moving base belongs to no arm.
    """
    require_run_of(chain, run)
    k = samples_at(run.t, checks.number(rate, "rate", above=0.0))
    if len(k) > MOST_FRAMES:
        raise ModelError(f"rate: expected at most {MOST_FRAMES} frames, got {len(k)}; try a lower rate")
    world = Environment(chain, base_motion or {})
    rows = tuple(grasp_rows(chain)) if run.setting is None else run.setting.rows
    places, touching = [], []
    for t, j in zip(run.t[k].tolist(), k.tolist(), strict=True):
        state = run.state(j)
        now, inputs = world.at(t, state)
        places.append(_placed(now, inputs, state, rows))
        touching += [] if now.touching is None else [now.touching]
    strength = np.array([at.strength for at in places])
    commanded = _commanded(chain, controller, run, k) if commands_forces(controller) else None
    surfaces, notes = _surfaces(chain, visuals)
    internal = run.internal_wrench[k] if "internal_wrench" in run.recorded else np.zeros((len(k), 0, 6))
    if not chain.beyond_serial:
        strength[~run.holding[k]] = 1.0
    bases, below, tips = (np.array([getattr(at, part) for at in places]) for part in ("bases", "below", "tips"))
    touches = run.touch_force[k] if chain.touching is not None and "touch_force" in run.recorded else None
    return Playback(
        chain, title, run.t[k], run.q[k], bases, below, run.object_pose[k], tips, run.grasp_wrench[k],
        internal, run.margin[k], run.condition[k], strength, run.tau[k], surfaces, notes, commanded,
        limits_kept(controller), [row.name for row in rows if row.grasp is None and row.name not in chain.arms],
        touches, touching,
    )  # fmt: skip


def _commanded(chain: ClosedChain, controller: Any, run: Trajectory, frames: Array) -> Array:
    """Return the commanded internal wrenches in frames of a run; zero where a hand holds that did not at the start."""
    found = np.zeros((len(frames), len(chain.arms), 6))
    laws: dict[frozenset[str], Any] = {}
    for one, k in zip(found, frames.tolist(), strict=True):
        holding = frozenset(name for name, holds in zip(chain.names, run.holding[k], strict=True) if holds)
        if not holding or not holding <= set(chain.grasps):
            continue
        if holding not in laws:
            grasps = {name: grasp for name, grasp in chain.grasps.items() if name in holding}
            laws[holding] = controller.for_chain(replace(chain, grasps=grasps))
        one[:] = commanded_internal_wrenches(laws[holding], float(run.t[k]), run.state(k))
    return found


def playback_of_instant(at: Instant, title: str, controller: Any = None) -> Playback:
    """Return a playback of one frame: a state, its torques, and the result of forward dynamics.

    Args:
        at: the state.
        title: title of the playback.
        controller: as for `playback_of_run`.
    """
    chain, state, found = at.chain, at.state, at.result
    rows = grasp_rows(chain)
    margin = np.full(len(rows), np.inf)
    held = [i for i, row in enumerate(rows) if row.grasp is not None]
    margin[held] = grasp_margins(chain, state, found.grasp_wrench)
    place = _placed(chain, at.inputs, state, rows)
    internal = np.zeros((0, 6)) if chain.beyond_serial else split(chain, state, found.grasp_wrench).internal
    parts = (
        at.t, state.q, place.bases, place.below, state.object_pose, place.tips, found.grasp_wrench, internal, margin,
        found.condition, place.strength, at.tau,
    )  # fmt: skip
    surfaces, notes = _surfaces(chain, None)
    commanded = None
    if commands_forces(controller):
        commanded = commanded_internal_wrenches(controller, at.t, state)[None]
    drawn = Playback(chain, title, *(np.array([part]) for part in parts), visuals=surfaces, notes=notes)
    force = getattr(found, "touch_force", None)  # a chain with branches has none
    touches = None if force is None else force[None]
    touching = () if chain.touching is None else (chain.touching,)
    return replace(drawn, commanded=commanded, limits=limits_kept(controller), touch_force=touches, touching=touching)


def _surfaces(chain: ClosedChain, visuals: DrawnSurfaces | None) -> tuple[DrawnSurfaces, tuple[str, ...]]:
    """Return the surfaces of arms and trunk, and sentences about meshes that cannot be read."""
    found, missing = meshes_in_files(chain) if visuals is None else (visuals, {})
    surfaces = {name: surface_of_object(one) for name, one in chain.free_objects.items()}
    of_objects = {name: (str(surface),) for name, surface in surfaces.items() if isinstance(surface, MeshFault)}
    return found, notes_on({**missing, **of_objects}, chain.names)


class _Place(NamedTuple):
    """The poses of a chain in a frame.

    Attributes:
        bases: (arms, 7) poses of the arms' bases in the world.
        below: (7,) pose of a trunk's base frame; (0,) without one.
        tips: (rows, 3) tip points [m].
        strength: (arms,) strength of each arm's weakest tip direction.
    """

    bases: Array
    below: Array
    tips: Array
    strength: list[float]


def _placed(chain: ClosedChain, inputs: Inputs, state: State, rows: Sequence[GraspRow]) -> _Place:
    """Return the poses of a chain in a state, with its bases at their poses at that time."""
    if chain.beyond_serial:
        return _placed_as_forest(chain, state, rows)
    arms = base_kinematics(chain, state, inputs.shaped(chain)).arms.values()
    configurations = [
        forward_kinematics(arm, state.q[chain.joints[name]]) for name, arm in zip(chain.names, arms, strict=True)
    ]
    R = rotation.from_quaternion(state.object_pose[:4])
    strength = [
        arm_strength(arm, at, chain.grasps[name], R) if name in chain.grasps else 1.0
        for name, arm, at in zip(chain.names, arms, configurations, strict=True)
    ]
    below = np.zeros(0) if chain.trunk is None else chain.trunk.base.wxyz_xyz
    if state.base_pose is not None:
        below = state.base_pose
    bases, tips = [arm.base.wxyz_xyz for arm in arms], [at.tip.p for at in configurations]
    return _Place(np.reshape(bases, (-1, 7)), below, np.reshape(tips, (-1, 3)), strength)


def _placed_as_forest(chain: ClosedChain, state: State, rows: Sequence[GraspRow]) -> _Place:
    """Return the poses of a chain that is answered as a forest, whose bases in the world stand still."""
    found = chain.as_forest
    poses = found.forest.poses(flat_state(chain, state)[0])
    mounts = {name: poses[body] for name, body in chain.mounted_on.items()}
    bases = [(mounts[name] @ arm.base if name in mounts else arm.base).wxyz_xyz for name, arm in chain.arms.items()]
    below = np.zeros(0) if chain.trunk is None else chain.trunk.base.wxyz_xyz
    tips = np.reshape([_tip(chain, row, poses) for row in rows], (-1, 3))
    below = below if state.base_pose is None else state.base_pose
    return _Place(np.reshape(bases, (-1, 7)), below, tips, [1.0] * len(chain.arms))


def _tip(chain: ClosedChain, row: GraspRow, poses: Sequence[Pose]) -> Array:
    """Return the point at which a grasp or loop is held: the tip, or the contact of a loop, (3,) [m]."""
    if row.grasp is not None:
        return (poses[row.body] @ row.grasp.frame).p
    if isinstance(row.key, str):
        return poses[chain.as_forest.arms[row.key][-1]].p
    arm, frame = row.key
    link, at = chain.arms[arm].frame(frame, row.name)
    return (poses[chain.as_forest.arms[arm][link]] @ at).p


def samples_at(t: Array, rate: float) -> Array:
    """Return the indices of the samples nearest to `rate` a second; the first and the last are among them."""
    if (t[-1] - t[0]) * rate > len(t):
        return np.arange(len(t))
    wanted = np.append(np.arange(t[0], t[-1], 1 / rate), t[-1])
    after = np.clip(np.searchsorted(t, wanted), 1, max(len(t) - 1, 1))
    nearest = np.where(wanted - t[after - 1] <= t[np.minimum(after, len(t) - 1)] - wanted, after - 1, after)
    return np.unique(np.minimum(nearest, len(t) - 1))


def spring_ends(playback: Playback, k: int) -> list[tuple[Array, Array]]:
    """Return both ends (3,) of every spring of the chain at moment k, world axes [m]."""
    chain = playback.chain
    if not chain.springs:
        return []
    bases = dict(zip(chain.names, playback.base_pose[k], strict=True))
    moved = chain.with_bases({name: pose for name, pose in bases.items() if name not in chain.mounts})
    below = playback.trunk_pose[k]
    if moved.trunk is not None and not chain.floats:
        moved = replace(moved, trunk=replace(moved.trunk, base=below))
    state = State(
        playback.q[k], 0.0 * playback.q[k], playback.object_pose[k], base_pose=below if chain.floats else None
    )
    return [(a.position, b.position) for a, b in end_motions(moved, state, Inputs().shaped(moved))]


class BaseTravel(NamedTuple):
    """The displacement of a base from its initial pose.

    Attributes:
        shift: (frames, 3) displacement of its origin, world axes [m].
        turn: (frames, 3) rotation vector from its initial attitude, world axes [rad].
    """

    shift: Array
    turn: Array


def base_travel(poses: Array) -> BaseTravel:
    """Return the displacements of poses (frames, 7), wxyz_xyz, from the first one."""
    attitudes = [rotation.from_quaternion(pose[:4]) for pose in poses]
    return BaseTravel(poses[:, 4:] - poses[0, 4:], np.array([rotation.log(R @ attitudes[0].T) for R in attitudes]))
