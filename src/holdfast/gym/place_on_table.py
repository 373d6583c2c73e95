"""The task of placing an object on a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiled.traced_chain import Given, traced_state
from holdfast.compiler.program import Shape
from holdfast.control.controller import ControlLaw
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.errors import ModelError
from holdfast.gym import terms
from holdfast.gym.task import BatchFunction, Phase, Task, over_a_table, spread
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.simulation.rollout.compile_rollout import compile_rollout
from holdfast.spatial.frozen import NOT_GIVEN, ArrayField, Frozen, OptionalArrayField, making
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, where
from holdfast.state import State


@called
@dataclass(frozen=True, eq=False)
class PlaceOnTableTask(Frozen, Task):
    """Place the object on a table: gently, level, at its goal, and so that the table carries it.

    The chain has `touching`; contacts with the world are those of `compile_rollout`. The action is (7,), constant
    during a control step, and its entries are clipped to [-1, 1]:

    | 0 to 2 | angular acceleration of the object, world axes, as a fraction of `acceleration[:3]` [rad/s^2]
    | 3 to 5 | acceleration of C, world axes, as a fraction of `acceleration[3:]` [m/s^2]
    | 6      | push of every arm along its contact normal: `internal_force + internal_force_span * a` [N]

    They are commanded as if the object were free: on the table, an acceleration downward is a force.

    The observation is in SI units, and each of its parts is clipped to the bounds of `observation_space`:

    | goal   | 6    | from the object to its goal on the table: [rotation vector; shift], world axes [rad, m]
    | twist  | 6    | twist of the object, [omega; v of C], world axes [rad/s, m/s]
    | gap    | k    | distances between the object's points and the shapes that they may touch [m]
    | table  | 3    | force of the world on the object in the last step, world axes [N]
    | time   | 1    | fraction of the episode that has passed
    | wrench | 6 a  | of each of a arms on the object about its contact, [moment; force], object axes [N m, N]
    | q, qd  | n, n | joint positions and rates [rad or m, rad/s or m/s]

    The reward of a control step of length dt is

        dt place_reward / (1 + (turn / tolerance_angle)^2 + (distance / tolerance)^2)
        - dt press_cost max(0, F / largest_press - 1) - dt effort_cost mean(a^2)

    with the turn and the distance to the goal, and the size F of the force of the world in the last integration step,
    which is the impulse of an impact over `step`; then once `success_reward` or, if the episode terminates otherwise,
    -`failure_cost`.

    An episode terminates with success when the object is within the tolerances of its goal, slower than `still`, and
    the world carries at least `least_share` of its weight with F not above `largest_press`. It terminates without
    success when a grasp slips, a joint exceeds a limit, the configuration is singular or a step fails, when F exceeds
    `crushing_press`, or when the object is farther from its goal than `lost`. It is truncated after `duration`.

    `info` has `press` (F) [N], `distance` [m] and `angle` [rad] from the goal, `speed` [m/s], `success` (1.0 or 0.0),
    and `status`, the name of a `RolloutStatus`.

    Attributes:
        chain: arms, object and grasps with `touching`; two Pandas that hold a 1 kg box 5 cm above a table by default.
        state: closed state in which episodes begin; must be given with `chain`.
        place: (3,) shift of C from `state` to its mean goal, world axes [m]; by default down, along gravity, by the
            smallest gap, so that a level object lies on a table below it.
        displacement: (3,) largest random displacement of the goal, world axes [m].
        duration: duration of an episode [s].
        step: h of the integration steps within a control step [s].
        steps_per_action: number of integration steps in a control step.
        mass_spread: the payload's mass lies within 1 +- this times the model's mass, which the controller assumes.
        push: (6,) largest constant wrench [moment; force] on the object about C, world axes [N m, N].
        stop_at_limits: whether a joint beyond a limit of position, rate or effort terminates the episode.
        acceleration: (6,) acceleration of a free object at an action of 1 [rad/s^2, m/s^2].
        internal_force: push of every arm along its contact normal [N].
        internal_force_span: force that an action of 1 adds to it [N].
        joint_damping: damping of the joint motion that does not move any contact [1/s].
        largest_press: force of the world above which the reward decreases [N].
        crushing_press: force at which the object breaks [N].
        least_share: share of the weight that the world carries at least when the object is placed.
        lost: distance from the goal at which the object counts as lost [m].
        tolerance: distance within which the object counts as at its goal [m].
        tolerance_angle: angle within which it does [rad].
        still: speed below which the object counts as at rest [m/s].
        place_reward: reward for a second at the goal.
        press_cost: cost of a second at twice the largest press.
        effort_cost: cost of a second with all actions at 1.
        success_reward: reward for placing the object.
        failure_cost: cost of a termination without success.
        sampling: as for `CarryTask`.
    """

    chain: ClosedChain = NOT_GIVEN
    state: State = NOT_GIVEN
    place: OptionalArrayField = NOT_GIVEN
    displacement: ArrayField = field(default_factory=making(np.array, [0.03, 0.03, 0.0]))
    duration: float = 3.0
    step: float = 0.001
    steps_per_action: int = 20
    mass_spread: float = 0.1
    push: ArrayField = field(default_factory=making(np.zeros, 6))
    stop_at_limits: bool = True
    acceleration: ArrayField = field(default_factory=making(np.repeat, [5.0, 2.0], 3))
    internal_force: float = 20.0
    internal_force_span: float = 10.0
    joint_damping: float = 10.0
    largest_press: float = 50.0
    crushing_press: float = 2000.0
    least_share: float = 0.5
    lost: float = 0.3
    tolerance: float = 0.01
    tolerance_angle: float = 0.05
    still: float = 0.02
    place_reward: float = 1.0
    press_cost: float = 0.1
    effort_cost: float = 0.01
    success_reward: float = 5.0
    failure_cost: float = 5.0
    sampling: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        put, what = object.__setattr__, "place on table"
        self._check_common(what, over_a_table)
        touching, state = self.chain.touching, self.state
        if touching is None:
            raise ModelError(
                f"{what}: chain: expected one whose object may touch a table, got one without touching; try"
                " dataclasses.replace(chain, touching=holdfast.world.Touching(points, world))"
            )
        if self.place is None:
            gap = contact_rows(touching, state.object_frame, state.object_twist).gap.min()
            size = float(np.linalg.norm(self.chain.gravity))
            put(self, "place", gap * (self.chain.gravity / size if size else np.zeros(3)))
        put(self, "place", checks.numbers(self.place, (3,), f"{what}: place"))
        for name, count in {"displacement": 3, "acceleration": 6}.items():
            put(self, name, spread(getattr(self, name), count, f"{what}: {name}"))
        self._check_numbers(what, ("duration", "largest_press", "crushing_press", "lost", "still"), above=0.0)
        rewards = "place_reward", "success_reward", "press_cost"
        self._check_numbers(what, (*rewards, "internal_force_span", "joint_damping", "least_share"), at_least=0.0)
        self._check_numbers(what, ("internal_force",))

    @property
    def action_size(self) -> int:
        """Number of entries of an action."""
        return 7

    @property
    def observed(self) -> Mapping[str, Array]:
        """Bounds of the parts of an observation, in the order of the observation."""
        assert self.chain.touching is not None
        force = terms.OBSERVED_FORCE * self.largest_press
        return {
            "goal": terms.pose_bounds(),
            "twist": np.full(6, terms.OBSERVED_TWIST),
            "gap": np.full(len(self.chain.touching.names), terms.OBSERVED_SHIFT),
            "table": np.full(3, force),
            "time": np.ones(1),
            "wrench": np.full(6 * len(self.chain.arms), force),
            **terms.joint_bounds(self.chain),
        }

    @property
    def info_names(self) -> tuple[str, ...]:
        """Names of the numbers in `info`."""
        return "press", "distance", "angle", "speed", "success"

    @property
    def drawn(self) -> Mapping[str, Shape]:
        """Shapes of the random quantities of an episode: payload, push, and the goal's displacement."""
        return {**super().drawn, "displacement": (3,)}

    def draw(self, generator: np.random.Generator) -> dict[str, Array]:
        """Return random values for an episode, by the names of `drawn`."""
        return {**super().draw(generator), "displacement": self.displacement * generator.uniform(-1.0, 1.0, 3)}

    @property
    def episode_steps(self) -> int:
        """Number of control steps after which an episode is truncated."""
        return self._control_steps(self.duration)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The only phase, in which all grasps are closed."""
        evaluation = BatchFunction(self.evaluate, self.argument_shapes(self.chain), self.result_shapes())
        return (Phase(compile_rollout(self.chain, self.sampled(self.law, self.chain)), evaluation),)

    @property
    def law(self) -> ControlLaw:
        """The control law, with the action as a parameter."""
        given = self.acceleration, self.internal_force, self.internal_force_span, self.joint_damping
        return terms.object_law(self.chain, *given)

    def evaluate(self, given: Given) -> dict[str, Any]:
        """Return observation, reward and termination of one system.

        Args:
            given: its state, grasp wrenches, contacts, time, action, and the random values of its episode.
        """
        chain, home = self.chain, self.state.object_frame
        state = traced_state(chain, given)
        goal = Pose.unchecked(home.R, home.p + self.place + given["displacement"])
        e, v = terms.away(goal, state.object_frame), state.object_twist
        angle, distance, speed = terms.size(e[:3]), terms.size(e[3:]), terms.size(v[3:])
        force = sum((one for one in given["touch_force"]), start=np.zeros(3))
        press = terms.size(force)
        dt, lasts = self.step * self.steps_per_action, self.episode_steps * self.step * self.steps_per_action
        parts = {
            "goal": e,
            "twist": v,
            "gap": given["touch_gap"],
            "table": force,
            "time": array([given["t"][()] / lasts]),
            "wrench": terms.in_object_axes(state, given["grasp_wrench"]),
            "q": state.q,
            "qd": state.qd,
        }
        failed = where(given["code"][()] > 0.5, 1.0, 0.0)
        for over in (press > self.crushing_press, distance > self.lost):
            failed = where(over, 1.0, failed)
        g, weight = (
            chain.gravity,
            given["mass_factor"][()] * chain.held_object.mass * float(chain.gravity @ chain.gravity),
        )
        placed = where(-(force @ g) >= self.least_share * weight, 1.0 - failed, 0.0)
        there = angle <= self.tolerance_angle, distance <= self.tolerance
        for fits in (*there, speed <= self.still, press <= self.largest_press):
            placed = where(fits, placed, 0.0)
        rate = self.place_reward * terms.nearness(e, self.tolerance_angle, self.tolerance)
        rate = rate - self.press_cost * terms.excess(press, self.largest_press)
        rate = rate - self.effort_cost * terms.effort(given["action"])
        return {
            "observation": terms.bounded(parts, self.observed),
            "reward": dt * rate + self.success_reward * placed - self.failure_cost * failed,
            "terminated": failed + placed,
            "press": press,
            "distance": distance,
            "angle": angle,
            "speed": speed,
            "success": placed,
        }
