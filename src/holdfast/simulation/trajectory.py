"""Simulated runs: their samples, and the interpolated state at any time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import ModelError, StateError
from holdfast.forces.wrist import WRISTS
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.questions.arrays import ARRAYS, RAD, RATE, TORQUE, Row
from holdfast.simulation.balance import WORK_TERMS, imbalance, momentum_imbalance
from holdfast.simulation.events import Occurrence, ending
from holdfast.simulation.margins import JOINT_QUANTITIES
from holdfast.simulation.run_outputs import RunOutputs
from holdfast.simulation.setting import Setting
from holdfast.spatial.frozen import NOT_GIVEN, Frozen
from holdfast.spatial.rotation import quaternion_product
from holdfast.spatial.scalar import Array
from holdfast.state import State


class Knot(NamedTuple):
    """An end point of an interpolating quintic.

    Attributes:
        t: time [s].
        state: positions and velocities.
        accelerations: (n + 6,) accelerations of the joints [rad/s^2 or m/s^2] and of the object [omega_dot; v_dot of
            C], world axes; a floating base adds six entries.
    """

    t: float
    state: State
    accelerations: Array


def interpolant(now: Knot, later: Knot) -> Callable[[float], State]:
    """Return the state as a function of time between two knots.

    Joint positions and the position and quaternion of the object, and of a floating base, follow quintics; velocities
    are their derivatives. Over a step h the error is O(h^6) for positions and O(h^5) for velocities, and both are exact
    at the ends. The interpolated state is not projected, so its grasps are open by O(h^6) and O(h^5), too. If torques
    jump at `later` (for example with a controller that holds them during a step), the accelerations there do not belong
    to the step, and the orders are 2 and 1.

    Args:
        now: the earlier knot.
        later: the later knot.

    Raises:
        StateError: raised by the returned function if the time is not between the two knots.
    """
    step = later.t - now.t
    ends = [_motion(at, now.state) for at in (now, later)]
    n, floats = len(now.state.q), now.state.base_pose is not None

    def state(t: float) -> State:
        if not now.t <= t <= later.t:
            raise StateError(f"interpolation: t: expected {now.t:.9g} to {later.t:.9g} s, got {t:.9g} s")
        x, rate = _quintic(*ends[0], *ends[1], step, (t - now.t) / step)
        held, *base = [_pose_and_twist(x[k : k + 7], rate[k : k + 7]) for k in range(n, len(x), 7)]
        return State(x[:n], rate[:n], *held, *(base[0] if floats else ()))

    return state


def _motion(at: Knot, near: State) -> tuple[Array, Array, Array]:
    """Return q and (quaternion, p) of the free bodies at a knot, their rates and accelerations, (n + 7 bodies,) each.

    Of the two quaternions that represent an attitude, the one nearer to that in `near` is used.
    """
    state, n = at.state, len(at.state.q)
    bodies = [_free_body(state.object_pose, state.object_twist, at.accelerations[n : n + 6], near.object_pose)]
    if state.base_pose is not None and state.base_twist is not None and near.base_pose is not None:
        bodies.append(_free_body(state.base_pose, state.base_twist, at.accelerations[n + 6 :], near.base_pose))
    joints = (state.q, state.qd, at.accelerations[:n])
    x, v, a = (np.concatenate(parts) for parts in zip(joints, *bodies, strict=True))
    return x, v, a


def _free_body(pose: Array, twist: Array, acceleration: Array, near: Array) -> tuple[Array, Array, Array]:
    """Return (quaternion, p) of a free body, its rate and acceleration, (7,) each.

    With W = [0; omega] the quaternion's rate is W o quaternion / 2.
    """
    quaternion = pose[:4] if pose[:4] @ near[:4] >= 0.0 else -pose[:4]
    spin, spinning_up = (np.concatenate([[0.0], x[:3]]) for x in (twist, acceleration))
    turning = 0.5 * quaternion_product(spin, quaternion)
    turning_up = 0.5 * (quaternion_product(spinning_up, quaternion) + quaternion_product(spin, turning))
    return (
        np.concatenate([quaternion, pose[4:]]),
        np.concatenate([turning, twist[3:]]),
        np.concatenate([turning_up, acceleration[3:]]),
    )


def _pose_and_twist(x: Array, rate: Array) -> tuple[Array, Array]:
    """Return the pose wxyz_xyz and the twist of a free body from a quaternion that need not be normalised."""
    quaternion, length = x[:4], np.sqrt(x[:4] @ x[:4])
    inverse = np.array([1.0, -1.0, -1.0, -1.0]) * quaternion / length**2
    omega = 2.0 * quaternion_product(rate[:4], inverse)[1:]  # the scalar part only changes the length
    return np.concatenate([quaternion / length, x[4:]]), np.concatenate([omega, rate[4:]])


def _quintic(
    x0: Array, v0: Array, a0: Array, x1: Array, v1: Array, a1: Array, step: float, s: float
) -> tuple[Array, Array]:
    """Return value and rate at the fraction s of the step, 0 at its start and 1 at its end."""
    gap = x1 - x0 - step * v0 - 0.5 * step**2 * a0  # remainder for the powers 3, 4 and 5 of s
    gap_rate = step * (v1 - v0 - step * a0)
    gap_acceleration = step**2 * (a1 - a0)
    c3 = 10.0 * gap - 4.0 * gap_rate + 0.5 * gap_acceleration
    c4 = -15.0 * gap + 7.0 * gap_rate - gap_acceleration
    c5 = 6.0 * gap - 3.0 * gap_rate + 0.5 * gap_acceleration
    t = s * step
    x = x0 + t * v0 + 0.5 * t**2 * a0 + s**3 * (c3 + s * (c4 + s * c5))
    return x, v0 + t * a0 + s**2 * (3.0 * c3 + s * (4.0 * c4 + 5.0 * s * c5)) / step


# results of 0.1 have no such arrays
TRUNK_FIELDS = ("base_pose", "base_twist", "base_acceleration", "trunk_base_wrench")


@called
@dataclass(frozen=True, eq=False)
class Trajectory(Frozen, RunOutputs):
    """A run sampled at every step; the first axis of every array is the sample.

    Shapes are those of one sample: a single sample has the same fields without the first axis. Arrays of a trunk or of
    a floating base have the shape (0,) without one. Times increase. If torques, inputs or grasps jump, there are two
    samples whose times differ by 1e-15 s or by one unit in the last place. `RUN_ARRAYS` lists the arrays as data.

    Attributes:
        stopped: None for a run that reached its end, otherwise the reason why it ended.
        occurrences: the log in order of time: grasps that closed or opened, limits that were passed, and so on.
        setting: chain, base motions and arguments of the run; None for a run that was assembled from arrays.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    object_pose: Array
    object_twist: Array
    object_acceleration: Array
    grasp_wrench: Array
    internal_wrench: Array
    load_share: Array
    wrist_wrench: Array
    base_wrench: Array
    holding: Array
    spin: Array
    margin: Array
    best_margin: Array
    worst_margin: Array
    lowest_margin: Array
    lowest_margin_time: Array
    lowest_joint_margin: Array
    lowest_joint_margin_time: Array
    lowest_joint: Array
    position_gap: Array
    velocity_gap: Array
    kinetic: Array
    potential: Array
    work: Array
    impact: Array
    momentum: Array
    momentum_rate: Array
    base_impulse: Array
    condition: Array
    base_pose: Array = NOT_GIVEN
    base_twist: Array = NOT_GIVEN
    base_acceleration: Array = NOT_GIVEN
    trunk_base_wrench: Array = NOT_GIVEN
    stopped: str | None = None
    occurrences: tuple[Occurrence, ...] = ()
    setting: Setting | None = None

    def __post_init__(self) -> None:
        for name in TRUNK_FIELDS:
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros((*np.shape(self.t), 0)))
        super().__post_init__()

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        """Return the name, the length and the end of the run, on one line."""
        return f"<Trajectory {text_of(self)}>"

    def whole_run(self) -> Trajectory:
        """Return the run itself."""
        return self

    def require_setting(self) -> Setting:
        """Return the setting of the run.

        Raises:
            StateError: the run has no setting.
        """
        if self.setting is None:
            raise StateError(
                "run: expected one that knows its chain, as simulate and load_result return it, got one put together"
                " from arrays; try dataclasses.replace(run, setting=hf.simulation.setting.Setting(chain))"
            )
        return self.setting

    def state(self, k: int) -> State:
        """Return the state of sample k."""
        base = (self.base_pose[k], self.base_twist[k]) if self.base_pose.shape[1] else ()
        return State(self.q[k], self.qd[k], self.object_pose[k], self.object_twist[k], *base)

    def state_at(self, t: float) -> State:
        """Return the state at any time of the run, interpolated by quintics between samples; see `interpolant`.

        At a jump of the grasps or velocities, the state after the jump is returned.

        Args:
            t: time [s].

        Raises:
            StateError: the time is before the first sample or after the last.
        """
        t = float(checks.numbers(t, (), "run: t", StateError))
        if not self.t[0] <= t <= self.t[-1]:
            raise StateError(f"run: t: expected {self.t[0]:.9g} to {self.t[-1]:.9g} s, got {t:.9g} s")
        k = int(np.searchsorted(self.t, t, side="right")) - 1
        return self.state(k) if self.t[k] == t else interpolant(self._knot(k), self._knot(k + 1))(t)

    def _knot(self, k: int) -> Knot:
        accelerations = np.concatenate([self.qdd[k], self.object_acceleration[k], self.base_acceleration[k]])
        return Knot(float(self.t[k]), self.state(k), accelerations)

    @property
    def imbalance(self) -> Array:
        """(samples,) change of energy that no work explains [J]."""
        return imbalance(self.kinetic, self.potential, self.work, self.impact)

    @property
    def momentum_imbalance(self) -> Array:
        """(samples, 6) change of [angular; linear] momentum that no wrench explains [N m s, N s]."""
        return momentum_imbalance(self.t, self.momentum, self.momentum_rate, self.base_impulse)


def text_of(run: Trajectory) -> str:
    """Return a short description of a run: its name and arms, its length, and how it ended."""
    if np.ndim(run.t) == 0:
        return f"one sample at t = {float(run.t):g} s"
    if not len(run):
        return "without samples"
    of = "" if run.setting is None else f" '{run.setting.name}' of {', '.join(run.setting.chain.names)}"
    end = ending(run.stopped, run.occurrences)
    return f"run{of}: {len(run)} sample{'' if len(run) == 1 else 's'}, {run.t[0]:g} to {run.t[-1]:g} s, {end}"


def joined(runs: Sequence[Trajectory], stopped: str | None = None) -> Trajectory:
    """Return successive parts of a run, one or more, as one."""
    arrays: dict[str, Any] = {key: np.concatenate([getattr(run, key) for run in runs]) for key in array_names()}
    return Trajectory(**arrays, stopped=stopped, occurrences=tuple(one for run in runs for one in run.occurrences))


def single(run: Trajectory, k: int, occurrences: tuple[Occurrence, ...] = ()) -> Trajectory:
    """Return sample k of a run, without the sample axis."""
    return Trajectory(**{name: getattr(run, name)[k] for name in array_names()}, occurrences=occurrences)


def stacked(samples: Sequence[Trajectory], stopped: str | None = None) -> Trajectory:
    """Return a run made of single samples."""
    arrays: dict[str, Any] = {key: np.stack([getattr(s, key) for s in samples]) for key in array_names()}
    return Trajectory(**arrays, stopped=stopped, occurrences=tuple(one for s in samples for one in s.occurrences))


def require_run_of(chain: Any, run: Any) -> None:
    """Check that `run` is a run of `chain`.

    Raises:
        ModelError: `chain` is not a ClosedChain.
        StateError: `run` is not a run, has no samples, or has other arms.
    """
    if not isinstance(chain, ClosedChain):
        raise ModelError(f"chain: expected a ClosedChain, got a {type(chain).__name__}")
    if not isinstance(run, Trajectory):
        inside = "; try its .trajectory" if hasattr(type(run), "trajectory") else ""
        raise StateError(f"run: expected a Trajectory, as simulate returns it, got a {type(run).__name__}{inside}")
    if not len(run):
        raise StateError("run: expected samples, got none")
    here, there = (chain.joint_count, len(chain.arms)), (run.q.shape[1], run.grasp_wrench.shape[1])
    if here != there:
        raise StateError(
            f"run: expected one of this chain, {here[0]} joints in {here[1]} arms, got {there[0]} in {there[1]}"
        )


GAPS = ("before", "after")
_RUN_ROWS = (
    Row("internal_wrench", ("arms", 6), "N m, N", "the part of grasp_wrench that does not move the object"),
    Row("load_share", ("arms",), "", "part of the net force that each arm carries; all 0 where there is no net force"),
    Row("holding", ("arms",), "", "whether each arm has a grasp"),
    Row("spin", ("arms",), "rad", "turn of each soft finger's contact about its normal; 0 for other grasps"),
    Row("margin", ("arms",), "N", "how far each grasp is from giving way; infinite where nothing limits it"),
    Row("best_margin", ("arms",), "N", "the largest margin that internal forces of no effect on the motion allow"),
    Row("worst_margin", ("arms",), "N", "the smallest such margin; minus infinity where they have no bound"),
    Row("lowest_margin", ("arms",), "N", "the lowest margin of each grasp since the sample before"),
    Row("lowest_margin_time", ("arms",), "s", "when that was"),
    Row("lowest_joint_margin", (3,), f"{RAD}, {RATE}, {TORQUE}", "the lowest margins of position, rate and effort of"
        " any joint since the sample before; infinite where nothing limits them", labels=JOINT_QUANTITIES),
    Row("lowest_joint_margin_time", (3,), "s", "when that was", labels=JOINT_QUANTITIES),
    Row("lowest_joint", (3,), "", "which joint that was, by place in q", labels=JOINT_QUANTITIES),
    Row("position_gap", (2,), "m or rad", "position gap of the worst grasp, before and after projection", labels=GAPS),
    Row("velocity_gap", (2,), "m/s or rad/s", "velocity gap of the worst grasp, before and after projection",
        labels=GAPS),
    Row("kinetic", (), "J", "kinetic energy"),
    Row("potential", (), "J", "potential energy of gravity and of all springs"),
    Row("work", (4,), "J", "work since the start of drives, damping and friction, bases, external wrenches",
        labels=WORK_TERMS),
    Row("impact", (), "J", "energy that impulses have added since the start"),
    Row("momentum", (6,), "N m s, N s", "[angular; linear] momentum of links and object about the world's origin, world"
        " axes"),
    Row("momentum_rate", (6,), "N m, N", "[moment; force] of bases, weights and external wrenches about the world's"
        " origin, world axes"),
    Row("base_impulse", (6,), "N m s, N s", "[angular; linear] impulses of the bases in impacts since the start, about"
        " the world's origin, world axes"),
)  # fmt: skip
_KNOWN_ROWS = {
    **ARRAYS,
    **{row.field: row for row in ARRAYS.values() if row.field},
    "wrist_wrench": WRISTS.rows["wrist_wrenches"],
    **{row.name: row for row in _RUN_ROWS},
}
# the arrays of a trajectory, in order
RUN_ARRAYS: Mapping[str, Row] = {one.name: _KNOWN_ROWS[one.name] for one in fields(Trajectory) if one.type == "Array"}
_SECTION = "    Attributes:\n"
Trajectory.__doc__ = (Trajectory.__doc__ or "").replace(
    _SECTION, _SECTION + "".join(f"        {name}: {row.text}.\n" for name, row in RUN_ARRAYS.items())
)


def array_names() -> list[str]:
    """Return the names of a trajectory's arrays."""
    return list(RUN_ARRAYS)
