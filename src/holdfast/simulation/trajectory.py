"""A simulated run: what every sample holds, what happened between samples, and the state at any time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple, get_type_hints

import numpy as np

from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import imbalance, momentum_imbalance
from holdfast.simulation.run_outputs import RunOutputs
from holdfast.simulation.setting import Setting
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.rotation import quaternion_product
from holdfast.spatial.scalar import Array
from holdfast.state import State

Kind = Literal["attach", "release", "violation", "recovery", "singular", "stiff"]


@dataclass(frozen=True)
class Occurrence:
    """One line of a run's log; plain data.

    Attributes:
        t: when [s].
        kind: "attach" and "release" of a grasp; "violation", a margin that becomes negative, and
            "recovery", where it no longer is; "singular", a configuration where the grasp constraint loses rank;
            "stiff", where steps become linearly implicit, because no explicit one could follow damping or springs.
        name: the arm, or 'arm/joint'; of a singular configuration "grasps", of stiff joints "joints".
        text: what happened.
        quantity: of a violation or recovery, what was passed: "grasp", "position", "rate", "effort".
        lowest: of a recovery, the lowest margin since the violation [N; rad or m; rad/s or m/s; N m or N].
        lowest_time: when that was [s].
        impulses: of an attach, (arms, 6) [moment; force] impulse of each arm on the object about its contact
            point, world axes [N m s, N s].
        base_impulses: of an attach, (arms, 6) of the base on each arm about the base origin.
        trunk_base_impulse: of an attach, (6,) of the base on a trunk about the base origin; empty without one.
        energy_change: of an attach, of the kinetic energy [J].
        rank: of a singular configuration, of the grasp constraint there.
        generic_rank: of a singular configuration, of the constraint before and after.
        lost: of a singular configuration, in words, the loads that it cannot resist and the directions that arms lose.
    """

    t: float
    kind: Kind
    name: str
    text: str
    quantity: str | None = None
    lowest: float | None = None
    lowest_time: float | None = None
    impulses: tuple[tuple[float, ...], ...] = ()
    base_impulses: tuple[tuple[float, ...], ...] = ()
    trunk_base_impulse: tuple[float, ...] = ()
    energy_change: float = 0.0
    rank: int | None = None
    generic_rank: int | None = None
    lost: tuple[str, ...] = ()


class Knot(NamedTuple):
    """What a quintic goes through.

    Attributes:
        t: time [s].
        state: positions and velocities.
        accelerations: (n + 6,) of the joints [rad/s^2 or m/s^2], and of the object [omega_dot; v_dot of C], world
            axes; six more of a floating base.
    """

    t: float
    state: State
    accelerations: Array


def interpolant(now: Knot, later: Knot) -> Callable[[float], State]:
    """Return the state as a function of time between two knots.

    Joint positions, the object's position and the four numbers of its quaternion follow
    quintics, those of a floating base too; velocities are their slopes. Over a step h positions are good to O(h^6),
    velocities to O(h^5), and both are exact at the ends. A state between is not projected:
    its grasps are open by the same O(h^6) and O(h^5). Where torques jump at `later` (a
    controller that holds them for a step) the accelerations do not belong to the step and
    the orders are 2 and 1.

    Args:
        now: the earlier knot.
        later: the one after it.

    Raises:
        StateError: from the returned function, at a time not between the two.
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

    Of the two quaternions of an attitude the one nearest to that in `near` is taken.
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
    """Return pose wxyz_xyz and twist of a free body whose quaternion has any length."""
    quaternion, length = x[:4], np.sqrt(x[:4] @ x[:4])
    inverse = np.array([1.0, -1.0, -1.0, -1.0]) * quaternion / length**2
    omega = 2.0 * quaternion_product(rate[:4], inverse)[1:]  # the scalar part only changes the length
    return np.concatenate([quaternion / length, x[4:]]), np.concatenate([omega, rate[4:]])


def _quintic(
    x0: Array, v0: Array, a0: Array, x1: Array, v1: Array, a1: Array, step: float, s: float
) -> tuple[Array, Array]:
    """Return value and rate at the part s of the step, 0 at its start and 1 at its end."""
    gap = x1 - x0 - step * v0 - 0.5 * step**2 * a0  # what is left to the powers 3, 4 and 5 of s
    gap_rate = step * (v1 - v0 - step * a0)
    gap_acceleration = step**2 * (a1 - a0)
    c3 = 10.0 * gap - 4.0 * gap_rate + 0.5 * gap_acceleration
    c4 = -15.0 * gap + 7.0 * gap_rate - gap_acceleration
    c5 = 6.0 * gap - 3.0 * gap_rate + 0.5 * gap_acceleration
    t = s * step
    x = x0 + t * v0 + 0.5 * t**2 * a0 + s**3 * (c3 + s * (c4 + s * c5))
    return x, v0 + t * a0 + s**2 * (3.0 * c3 + s * (4.0 * c4 + 5.0 * s * c5)) / step


NONE = np.zeros(0)


def _none() -> Array:
    """Return what stands for an array of a trunk where there is none."""
    return NONE


OF_TRUNK = ("base_pose", "base_twist", "base_acceleration", "trunk_base_wrench")  # results of 0.1 have no such arrays


@dataclass(frozen=True, eq=False)
class Trajectory(Frozen, RunOutputs):
    """A run sampled at every step; the first axis of every array is the sample.

    One sample alone has the same fields without that axis. `UNITS` gives units and axes. Times
    increase; where torques, inputs or grasps jump there are two samples, 1e-15 s or a unit in the last
    place apart.

    Attributes:
        t: (samples,) [s].
        q, qd, qdd, tau: (samples, n).
        object_pose: (samples, 7) wxyz_xyz.
        object_twist, object_acceleration: (samples, 6).
        grasp_wrench, internal_wrench, wrist_wrench, base_wrench: (samples, arms, 6).
        load_share, holding, spin: (samples, arms).
        margin, best_margin, worst_margin, lowest_margin, lowest_margin_time: (samples, arms).
        lowest_joint_margin, lowest_joint_margin_time, lowest_joint: (samples, 3), see
            `margins.JOINT_QUANTITIES`.
        position_gap, velocity_gap: (samples, 2) before and after projection.
        kinetic, potential, impact: (samples,) [J].
        work: (samples, 4) since the start, see `balance.WORK_TERMS` [J].
        momentum, momentum_rate, base_impulse: (samples, 6).
        condition: (samples,) of the grasp constraint.
        base_pose, base_twist, base_acceleration: (samples, 7), (samples, 6) twice, of a trunk's floating base;
            (samples, 0) without one.
        trunk_base_wrench: (samples, 6); (samples, 0) without a trunk.
        stopped: None for a run that reached its end, else what ended it.
        occurrences: grasps that closed and opened, limits that were passed, in order of time.
        setting: what it is a run of; None for one put together from arrays.
    """

    t: Annotated[Array, "s"]
    q: Annotated[Array, "rad or m"]
    qd: Annotated[Array, "rad/s or m/s"]
    qdd: Annotated[Array, "rad/s^2 or m/s^2"]
    tau: Annotated[Array, "N m or N"]
    object_pose: Annotated[Array, "unit quaternion wxyz, then m; world axes"]
    object_twist: Annotated[Array, "[omega; v of C], rad/s and m/s, world axes"]
    object_acceleration: Annotated[Array, "[omega_dot; v_dot of C], rad/s^2 and m/s^2, world axes"]
    grasp_wrench: Annotated[
        Array, "[moment; force] of each arm on the object about the contact point, N m and N, world axes"
    ]
    internal_wrench: Annotated[Array, "the part of grasp_wrench that does not move the object"]
    load_share: Annotated[Array, "part of the net force that each arm carries, 1; all 0 where there is no net force"]
    wrist_wrench: Annotated[
        Array, "[moment; force] of each arm across its tip frame, about the tip's origin, N m and N, tip axes"
    ]
    base_wrench: Annotated[
        Array, "[moment; force] of the base on each arm about the base origin, N m and N, world axes"
    ]
    holding: Annotated[Array, "whether each arm has a grasp"]
    spin: Annotated[Array, "turn of each soft finger's contact about its normal, rad; 0 for other grasps"]
    margin: Annotated[Array, "how far each grasp is from giving way, N; infinite where nothing limits"]
    best_margin: Annotated[Array, "the largest margin that internal forces of no effect on the motion allow, N"]
    worst_margin: Annotated[Array, "the smallest, N; minus infinity where they have no bound"]
    lowest_margin: Annotated[Array, "the lowest margin of each grasp since the sample before, N"]
    lowest_margin_time: Annotated[Array, "when that was, s"]
    lowest_joint_margin: Annotated[
        Array,
        "the lowest margin of any joint since the sample before: position in rad or m, rate in rad/s or m/s, effort in"
        " N m or N; infinite where nothing limits",
    ]
    lowest_joint_margin_time: Annotated[Array, "when that was, s"]
    lowest_joint: Annotated[Array, "which joint that was, by place in q"]
    position_gap: Annotated[Array, "worst grasp before and after projection, m or rad"]
    velocity_gap: Annotated[Array, "worst grasp before and after projection, m/s or rad/s"]
    kinetic: Annotated[Array, "J"]
    potential: Annotated[Array, "J"]
    work: Annotated[Array, "work since the start of drives, damping and friction, bases, external wrenches, J"]
    impact: Annotated[Array, "energy that impulses have added since the start, J"]
    momentum: Annotated[
        Array, "[angular; linear] of links and object about the world's origin, N m s and N s, world axes"
    ]
    momentum_rate: Annotated[
        Array, "[moment; force] of bases, weights and external wrenches about the world's origin, N m and N"
    ]
    base_impulse: Annotated[
        Array,
        "[angular; linear] impulses of the bases in impacts since the start, about the world's origin, N m s and N s",
    ]
    condition: Annotated[Array, "1"]
    base_pose: Annotated[Array, "unit quaternion wxyz, then m, of a floating base; world axes"] = field(
        default_factory=_none
    )
    base_twist: Annotated[Array, "[omega; v of the floating base's origin], rad/s and m/s, world axes"] = field(
        default_factory=_none
    )
    base_acceleration: Annotated[Array, "[omega_dot; v_dot of that origin], rad/s^2 and m/s^2, world axes"] = field(
        default_factory=_none
    )
    trunk_base_wrench: Annotated[
        Array, "[moment; force] of the base on the trunk about the base origin, N m and N, world axes"
    ] = field(default_factory=_none)
    stopped: str | None = None
    occurrences: tuple[Occurrence, ...] = ()
    setting: Setting | None = None

    def __post_init__(self) -> None:
        for name in OF_TRUNK:
            if getattr(self, name) is NONE:
                object.__setattr__(self, name, np.zeros((*np.shape(self.t), 0)))
        super().__post_init__()

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        """Return name, length and how it ended, on one line."""
        return f"<Trajectory {text_of(self)}>"

    def whole_run(self) -> Trajectory:
        """Return the run itself."""
        return self

    def require_setting(self) -> Setting:
        """Return what it is a run of.

        Raises:
            StateError: it does not know.
        """
        if self.setting is None:
            raise StateError(
                "run: expected one that knows its chain, as simulate and load_result return it, got one put together"
                " from arrays; try dataclasses.replace(run, setting=hf.simulation.Setting(chain))"
            )
        return self.setting

    def state(self, k: int) -> State:
        """Return the state of sample k."""
        base = (self.base_pose[k], self.base_twist[k]) if self.base_pose.shape[1] else ()
        return State(self.q[k], self.qd[k], self.object_pose[k], self.object_twist[k], *base)

    def state_at(self, t: float) -> State:
        """Return the state at any time of the run; between samples by quintics, see `interpolant`.

        Where the grasps or velocities jump, the state after the jump.

        Args:
            t: time [s].

        Raises:
            StateError: a time before the first sample or after the last.
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
        """(samples,) energy that no work accounts for [J]."""
        return imbalance(self.kinetic, self.potential, self.work, self.impact)

    @property
    def momentum_imbalance(self) -> Array:
        """(samples, 6) [angular; linear] momentum that no wrench accounts for [N m s, N s]."""
        return momentum_imbalance(self.t, self.momentum, self.momentum_rate, self.base_impulse)


def text_of(run: Trajectory) -> str:
    """Return in a few words how long a run is, of what, and how it ended."""
    if np.ndim(run.t) == 0:
        return f"one sample at t = {float(run.t):g} s"
    if not len(run):
        return "without samples"
    of = "" if run.setting is None else f" '{run.setting.name}' of {', '.join(run.setting.chain.names)}"
    end = "complete" if run.stopped is None else run.stopped
    return f"run{of}: {len(run)} sample{'' if len(run) == 1 else 's'}, {run.t[0]:g} to {run.t[-1]:g} s, {end}"


def stacked(samples: Sequence[Trajectory], stopped: str | None = None) -> Trajectory:
    """Return single samples as one run."""
    arrays: dict[str, Any] = {key: np.stack([getattr(s, key) for s in samples]) for key in array_names()}
    return Trajectory(**arrays, stopped=stopped, occurrences=tuple(one for s in samples for one in s.occurrences))


def require_run_of(chain: Any, run: Any) -> None:
    """Refuse what is no run of a chain, before its arrays are taken apart.

    Raises:
        ModelError: what is no chain.
        StateError: what is no run, one without samples, or one of other arms.
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


# of every array of a trajectory, in order: its unit and axes
UNITS: dict[str, str] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(Trajectory, include_extras=True).items()
    if hasattr(hint, "__metadata__")
}


def array_names() -> list[str]:
    """Return the names of a trajectory's arrays."""
    return list(UNITS)
