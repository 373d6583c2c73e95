"""The task of carrying an object along a path while the internal force stays below a bound."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from holdfast.compiled.traced_chain import Given, traced_state
from holdfast.compiler.program import Shape
from holdfast.control.controller import ControlLaw
from holdfast.control.paths import ObjectPath, Target, path_function, quintic
from holdfast.errors import ModelError
from holdfast.gym import terms
from holdfast.gym.task import BatchFunction, Phase, Task, spread, torques, two_fingers
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.simulation.rollout.compile_rollout import compile_rollout
from holdfast.spatial import rotation
from holdfast.spatial.frozen import NOT_GIVEN, ArrayField, Frozen, OptionalArrayField, making
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, where
from holdfast.state import State

OBSERVED_MARGIN = 100.0  # N: bound of observed margins
LARGEST_START_GAP = 1e-6  # rad, m: largest distance of a path's beginning from the object
OBSERVED_ACCELERATION = 20.0  # rad/s^2, m/s^2: bound of observed accelerations


@called
@dataclass(frozen=True, eq=False)
class CarryTask(Frozen, Task):
    """Carry the object along a path with no more internal force than is needed to hold it.

    The action is constant during a control step, and its entries are clipped to [-1, 1].
    With `commands="object"` it is (7,):

    | 0 to 2 | angular acceleration of the object, world axes, as a fraction of `acceleration[:3]` [rad/s^2]
    | 3 to 5 | acceleration of C, world axes, as a fraction of `acceleration[3:]` [m/s^2]
    | 6      | push of every arm along its contact normal: `internal_force + internal_force_span * a` [N]

    With `commands="joint"` it is (n,): torques that are added to gravity compensation (with `internal_force`) and joint
    damping, arms in order, base to tip, as a fraction of `joint_torque` [N m or N].

    The observation is in SI units, and each of its parts is clipped to the bounds of `observation_space`:

    | path              | 6   | from the object to the path's pose: [rotation vector; shift], world axes [rad, m]
    | path_twist        | 6   | the path's twist minus the object's, [angular; of C], world axes [rad/s, m/s]
    | path_acceleration | 6   | current acceleration of the path, world axes [rad/s^2, m/s^2]
    | goal              | 6   | as `path`, but to the path's end
    | twist             | 6   | twist of the object, [omega; v of C], world axes [rad/s, m/s]
    | time              | 1   | fraction of the episode that has passed
    | wrench            | 6 a | of each of a arms on the object about its contact, [moment; force], object axes [N m, N]
    | margin            | g   | of each of g grasps, before it slips or its wrench exceeds a limit [N]
    | q, qd             | n, n| joint positions and rates [rad or m, rad/s or m/s]

    The reward of a control step of length dt is

        dt path_reward / (1 + (turn / tolerance_angle)^2 + (distance / tolerance)^2)
        - dt internal_cost max(0, F / largest_internal - 1) - dt effort_cost mean(a^2)

    with the angle and the distance between object and path; when the episode terminates, `failure_cost` is subtracted
    once. The internal force F is the largest sqrt(|moment / L|^2 + |force|^2) of any grasp's internal wrench, see
    `forces.split`.

    An episode terminates when a grasp slips, a joint exceeds a limit, the configuration is singular or a step fails,
    when the internal force exceeds `crushing_internal`, or when the object is farther from the path than `lost` or
    `lost_angle`. It is truncated after `duration + settle`.

    `info` has `internal_force` [N], `distance` [m] and `angle` [rad] from the path, `success` (1.0 where both are
    within the tolerances, else 0.0), and `status`, the name of a `RolloutStatus`.

    Attributes:
        chain: arms, object and grasps; two Pandas with rubber fingers on a 3 kg box by default.
        state: closed state in which episodes begin; must be given with `chain`.
        commands: what actions command, "object" or "joint".
        path: a function t [s] -> `control.paths.Target`, or an object with such a method `at`, written like a control
            law. It must begin at the object's pose in `state`. By default it is a rest-to-rest motion from there with
            a random displacement and rotation.
        displacement: (3,) largest random displacement of C, world axes [m].
        turn: (3,) largest random rotation vector, world axes [rad].
        duration: duration of the path [s].
        settle: time from the end of the path to the end of the episode [s].
        step: h of the integration steps within a control step [s].
        steps_per_action: number of integration steps in a control step.
        mass_spread: the payload's mass lies within 1 +- this times the model's mass, which the controller assumes.
        push: (6,) largest constant wrench [moment; force] on the object about C, world axes [N m, N].
        stop_at_limits: whether a joint beyond a limit of position, rate or effort terminates the episode.
        acceleration: (6,) acceleration of the object at an action of 1 [rad/s^2, m/s^2].
        internal_force: push of every arm along its contact normal [N].
        internal_force_span: force that an action of 1 adds to it [N].
        joint_torque: (n,) torques at an action of 1; by default a tenth of the effort limits, or 10 without a limit.
        joint_damping: damping of the joint motion that does not move any contact [1/s]; with `commands="joint"`, of
            all joint motion [N m s/rad or N s/m].
        largest_internal: internal force above which the reward decreases [N].
        crushing_internal: internal force at which the object breaks [N].
        lost: distance from the path at which the object counts as lost [m].
        lost_angle: angle at which it does, below pi [rad].
        tolerance: distance from the path within which the object counts as on it [m].
        tolerance_angle: angle within which it does [rad].
        path_reward: reward for a second on the path.
        internal_cost: cost of a second at twice the largest internal force.
        effort_cost: cost of a second with all actions at 1.
        failure_cost: cost of a termination.
        sampling: arguments of `control.sampled` for the control law, such as {"sample_time": 2e-3, "delay": 2e-3}; None
            for a law that acts all the time. An action acts from the next sample on. Observations have no noise.
    """

    chain: ClosedChain = NOT_GIVEN
    state: State = NOT_GIVEN
    commands: Literal["object", "joint"] = "object"
    path: Callable[[Any], Target] | ObjectPath | None = None
    displacement: ArrayField = field(default_factory=making(np.full, 3, 0.1))
    turn: ArrayField = field(default_factory=making(np.full, 3, 0.2))
    duration: float = 1.5
    settle: float = 0.5
    step: float = 0.002
    steps_per_action: int = 10
    mass_spread: float = 0.2
    push: ArrayField = field(default_factory=making(np.repeat, [0.0, 3.0], 3))
    stop_at_limits: bool = True
    acceleration: ArrayField = field(default_factory=making(np.repeat, [5.0, 2.0], 3))
    internal_force: float = 50.0
    internal_force_span: float = 25.0
    joint_torque: OptionalArrayField = NOT_GIVEN
    joint_damping: float = 10.0
    largest_internal: float = 60.0
    crushing_internal: float = 150.0
    lost: float = 0.3
    lost_angle: float = 1.0
    tolerance: float = 0.02
    tolerance_angle: float = 0.05
    path_reward: float = 1.0
    internal_cost: float = 1.0
    effort_cost: float = 0.01
    failure_cost: float = 5.0
    sampling: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        put, what = object.__setattr__, "carry"
        self._check_common(what, two_fingers)
        put(self, "joint_torque", torques(self.joint_torque, self.chain, what))
        if self.commands not in ("object", "joint"):
            raise ModelError(f"{what}: commands: expected 'object' or 'joint', got {checks.short(self.commands)}")
        for name, count in {"displacement": 3, "turn": 3, "acceleration": 6}.items():
            put(self, name, spread(getattr(self, name), count, f"{what}: {name}"))
        if self.path is not None:
            put(self, "path", path_function(self.path, f"{what}: path"))
            self._require_beginning(what)
        self._check_numbers(
            what, ("duration", "largest_internal", "crushing_internal", "lost", "lost_angle"), above=0.0
        )
        costs = "path_reward", "internal_cost"
        self._check_numbers(what, ("settle", "internal_force_span", "joint_damping", *costs), at_least=0.0)
        self._check_numbers(what, ("internal_force",))
        if self.lost_angle >= np.pi:
            raise ModelError(f"{what}: lost_angle: expected less than pi, got {self.lost_angle:g}")

    def _require_beginning(self, what: str) -> None:
        """Refuse an object that is not a path, and a path that does not begin at the object's pose."""
        first = self.path(0.0)  # type: ignore[operator, misc]
        if not isinstance(first, Target):
            got = type(first).__name__
            raise ModelError(f"{what}: path: expected t -> control.paths.Target (pose, twist, acceleration), got {got}")
        gap = float(np.abs(terms.away(first.pose, self.state.object_frame)).max())
        if not gap <= LARGEST_START_GAP:
            raise ModelError(
                f"{what}: path: expected one that begins where the object is, got one that begins {gap:.3g} (m or rad)"
                " beside it; try RestToRest(state.object_frame, ...)"
            )

    @property
    def action_size(self) -> int:
        """Number of entries of an action."""
        return 7 if self.commands == "object" else self.chain.joint_count

    @property
    def observed(self) -> Mapping[str, Array]:
        """Bounds of the parts of an observation, in the order of the observation."""
        twist, force = np.full(6, terms.OBSERVED_TWIST), terms.OBSERVED_FORCE * self.largest_internal
        return {
            "path": terms.pose_bounds(),
            "path_twist": 2.0 * twist,
            "path_acceleration": np.full(6, OBSERVED_ACCELERATION),
            "goal": terms.pose_bounds(),
            "twist": twist,
            "time": np.ones(1),
            "wrench": np.full(6 * len(self.chain.arms), force),
            "margin": np.full(len(self.chain.grasps), OBSERVED_MARGIN),
            **terms.joint_bounds(self.chain),
        }

    @property
    def info_names(self) -> tuple[str, ...]:
        """Names of the numbers in `info`."""
        return "internal_force", "distance", "angle", "success"

    @property
    def drawn(self) -> Mapping[str, Shape]:
        """Shapes of the random quantities of an episode: payload, push and, without a given path, its end."""
        ways: dict[str, Shape] = {} if self.path is not None else {"displacement": (3,), "turn": (3,)}
        return {**super().drawn, **ways}

    def draw(self, generator: np.random.Generator) -> dict[str, Array]:
        """Return random values for an episode, by the names of `drawn`."""
        found = super().draw(generator)
        if self.path is None:
            found["displacement"] = self.displacement * generator.uniform(-1.0, 1.0, 3)
            found["turn"] = self.turn * generator.uniform(-1.0, 1.0, 3)
        return found

    @property
    def episode_steps(self) -> int:
        """Number of control steps after which an episode is truncated."""
        return self._control_steps(self.duration + self.settle)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The only phase, in which all grasps are closed."""
        evaluation = BatchFunction(self.evaluate, self.argument_shapes(self.chain), self.result_shapes())
        return (Phase(compile_rollout(self.chain, self.sampled(self.law, self.chain)), evaluation),)

    @property
    def law(self) -> ControlLaw:
        """The control law, with the action as a parameter."""
        if self.commands == "object":
            given = self.acceleration, self.internal_force, self.internal_force_span, self.joint_damping
            return terms.object_law(self.chain, *given)
        assert self.joint_torque is not None
        return terms.joint_law(self.chain, self.joint_torque, self.internal_force, self.joint_damping)

    def target(self, t: Scalar, given: Given) -> Target:
        """Return pose, twist and acceleration of the path at a time [s]."""
        if self.path is not None:
            return self.path(t)  # type: ignore[operator]
        s, rate, bend = quintic(t / self.duration)
        home, way = self.state.object_frame, concatenate([given["turn"], given["displacement"]])
        pose = Pose.unchecked(rotation.exp(s * given["turn"]) @ home.R, home.p + s * given["displacement"])
        return Target(pose, rate / self.duration * way, bend / self.duration**2 * way)

    def evaluate(self, given: Given) -> dict[str, Any]:
        """Return observation, reward and termination of one system.

        Args:
            given: its state, grasp wrenches and margins, time, action, and the random values of its episode.
        """
        chain, t = self.chain, given["t"][()]
        state, target = traced_state(chain, given), self.target(t, given)
        e = terms.away(target.pose, state.object_frame)
        angle, distance = terms.size(e[:3]), terms.size(e[3:])
        force = terms.internal_force(chain, state, given["grasp_wrench"], terms.moment_length(chain))
        dt, lasts = self.step * self.steps_per_action, self.episode_steps * self.step * self.steps_per_action
        parts = {
            "path": e,
            "path_twist": target.twist - state.object_twist,
            "path_acceleration": target.acceleration,
            "goal": terms.away(self.target(self.duration, given).pose, state.object_frame),
            "twist": state.object_twist,
            "time": array([t / lasts]),
            "wrench": terms.in_object_axes(state, given["grasp_wrench"]),
            "margin": given["margin"],
            "q": state.q,
            "qd": state.qd,
        }
        failed = where(given["code"][()] > 0.5, 1.0, 0.0)
        for over in (force > self.crushing_internal, distance > self.lost, angle > self.lost_angle):
            failed = where(over, 1.0, failed)
        rate = self.path_reward * terms.nearness(e, self.tolerance_angle, self.tolerance)
        rate = rate - self.internal_cost * terms.excess(force, self.largest_internal)
        rate = rate - self.effort_cost * terms.effort(given["action"])
        there = where(angle <= self.tolerance_angle, where(distance <= self.tolerance, 1.0, 0.0), 0.0)
        return {
            "observation": terms.bounded(parts, self.observed),
            "reward": dt * rate - self.failure_cost * failed,
            "terminated": failed,
            "internal_force": force,
            "distance": distance,
            "angle": angle,
            "success": there,
        }
