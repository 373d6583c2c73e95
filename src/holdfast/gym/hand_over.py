"""The task of handing an object from one arm to another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np

from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, traced_chain, traced_inputs, traced_state
from holdfast.compiler.program import Shape
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.contact_places import tip_frames
from holdfast.dynamics.impulse import grasp_here
from holdfast.errors import ModelError
from holdfast.gym import terms
from holdfast.gym.episodes import Episodes
from holdfast.gym.task import BatchFunction, Phase, Task, spread, torques, two_hands
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.simulation.rollout.compile_rollout import compile_rollout
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.spatial import rotation
from holdfast.spatial.frozen import NOT_GIVEN, ArrayField, Frozen, OptionalArrayField, frozen_property, making
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, where
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import State

GIVING, BOTH, TAKEN = range(3)  # phases


@called
@dataclass(frozen=True, eq=False)
class HandOverTask(Frozen, Task):
    """Hand the object from one arm to another: reach for it, grasp it, release it, and bring it to a goal.

    In `state` both arms hold the object. Episodes begin with only the giver holding it, and with the receiver's joints
    moved by random offsets.

    The action is (n + 2,) and constant during a control step, and its entries are clipped to [-1, 1]:

    | 0 to n-1 | torques added to gravity compensation and joint damping, arms in order, base to tip, as a
    |          | fraction of `joint_torque` [N m or N]
    | n        | above 0, the receiver grasps at the present pose of its tip, if this is within `capture`,
    |          | `capture_angle`, `capture_speed` and `capture_rate` of its place; an impulse stops the relative motion
    | n + 1    | above 0, the giver releases the object, if the receiver holds it

    The observation is in SI units, and each of its parts is clipped to the bounds of `observation_space`:

    | gap      | 6   | from the receiver's tip to its place on the object, which is that in `state`: [rotation vector;
    |          |     | shift], world axes [rad, m]; zero once it holds the object
    | gap_twist| 6   | twist of that place minus the tip's, world axes [rad/s, m/s]
    | goal     | 6   | from the object to its goal, as `gap` [rad, m]
    | twist    | 6   | twist of the object, [omega; v of C], world axes [rad/s, m/s]
    | holds    | 2   | for giver and receiver: 1 if it holds the object, else 0
    | time     | 1   | fraction of the episode that has passed
    | wrench   | 6 a | of each of a arms on the object about its contact, [moment; force], object axes [N m, N]
    | q, qd    | n, n| joint positions and rates [rad or m, rad/s or m/s]

    The reward of a control step of length dt is the sum of the following terms, in which turn and distance are those of
    the gap (zero once the receiver holds the object) or those from the goal:

    - for the gap, dt reach_reward / (1 + (turn / capture_angle)^2 + (distance / capture)^2);
    - for the goal, after the release, dt goal_reward / (1 + (turn / tolerance_angle)^2 + (distance / tolerance)^2);
    - -dt internal_cost max(0, internal_force / largest_internal - 1) - dt effort_cost mean(a[:n]^2);
    - once, when the receiver grasps, -impact_cost times the speed between its tip and its place;
    - once, success_reward at the goal, or -failure_cost if the episode terminates otherwise.

    An episode terminates with success when the giver has released the object and it is at its goal within the
    tolerances, and slower than `still`. It terminates without success when a grasp slips, a joint exceeds a limit, the
    configuration is singular or a step fails, when the internal force exceeds `crushing_internal`, or when the object
    is farther than `lost` from its initial position. It is truncated after `duration`.

    `info` has `internal_force` [N], `distance` [m] and `angle` [rad] from the goal, `gap` [m], `speed` [m/s] between
    tip and place, `within_reach` (1.0 if the receiver could grasp), `phase` (0.0: the giver holds the object, 1.0: both
    arms, 2.0: the receiver), `success` (1.0 or 0.0), and `status`, the name of a `RolloutStatus`.

    Attributes:
        chain: arms, object and grasps, those of giver and receiver among them; two Pandas on a 1 kg box by default.
        state: closed state in which both arms hold the object; must be given with `chain`.
        giver: name of the arm that holds the object first; by default the first with a grasp.
        receiver: name of the arm that takes over; by default the next one with a grasp.
        retreat: (N,) largest random offsets of the receiver's joints [rad or m]; 0.15 rad, 0.05 m by default.
        displacement: (3,) largest random displacement of C from `state` to the goal, world axes [m].
        turn: (3,) largest random rotation vector from `state` to the goal, world axes [rad].
        duration: duration of an episode [s].
        step: h of the integration steps within a control step [s].
        steps_per_action: number of integration steps in a control step.
        mass_spread: the payload's mass lies within 1 +- this times the model's mass, which the controller assumes.
        push: (6,) largest constant wrench [moment; force] on the object about C, world axes [N m, N].
        stop_at_limits: whether a joint beyond a limit of position, rate or effort terminates the episode.
        joint_torque: (n,) torques at an action of 1; by default a tenth of the effort limits, or 10 without a limit.
        joint_damping: damping of all joints [N m s/rad or N s/m].
        internal_force: push of every holding arm along its contact normal, while two or more arms hold the object [N].
        capture: largest distance of the tip from its place at which it can grasp [m].
        capture_angle: largest angle between them [rad].
        capture_speed: largest speed of the tip relative to its place [m/s].
        capture_rate: largest angular rate between them [rad/s].
        largest_internal: internal force above which the reward decreases [N].
        crushing_internal: internal force at which the object breaks [N].
        lost: distance from its initial position at which the object counts as lost [m].
        tolerance: distance within which the object counts as at its goal [m].
        tolerance_angle: angle within which it does [rad].
        still: speed below which the object counts as at rest at its goal [m/s].
        reach_reward: reward for a second at the grasp.
        goal_reward: reward for a second at the goal.
        internal_cost: cost of a second at twice the largest internal force.
        effort_cost: cost of a second with all torques at 1.
        impact_cost: cost of grasping at 1 m/s.
        success_reward: reward for reaching the goal.
        failure_cost: cost of a termination without success.
        sampling: as for `CarryTask`.
    """

    chain: ClosedChain = NOT_GIVEN
    state: State = NOT_GIVEN
    giver: str = ""
    receiver: str = ""
    retreat: OptionalArrayField = NOT_GIVEN
    displacement: ArrayField = field(default_factory=making(np.full, 3, 0.05))
    turn: ArrayField = field(default_factory=making(np.zeros, 3))
    duration: float = 4.0
    step: float = 0.002
    steps_per_action: int = 10
    mass_spread: float = 0.1
    push: ArrayField = field(default_factory=making(np.zeros, 6))
    stop_at_limits: bool = True
    joint_torque: OptionalArrayField = NOT_GIVEN
    joint_damping: float = 5.0
    internal_force: float = 0.0
    capture: float = 0.02
    capture_angle: float = 0.2
    capture_speed: float = 0.1
    capture_rate: float = 0.5
    largest_internal: float = 40.0
    crushing_internal: float = 200.0
    lost: float = 0.5
    tolerance: float = 0.02
    tolerance_angle: float = 0.2
    still: float = 0.05
    reach_reward: float = 0.5
    goal_reward: float = 1.0
    internal_cost: float = 1.0
    effort_cost: float = 0.01
    impact_cost: float = 1.0
    success_reward: float = 5.0
    failure_cost: float = 5.0
    sampling: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        put, what = object.__setattr__, "hand-over"
        self._check_common(what, two_hands)
        put(self, "joint_torque", torques(self.joint_torque, self.chain, what))
        put(self, "giver", _holding(self.chain, self.giver, "giver", ""))
        put(self, "receiver", _holding(self.chain, self.receiver, "receiver", self.giver))
        for name in ("displacement", "turn"):
            put(self, name, spread(getattr(self, name), 3, f"{what}: {name}"))
        joints = self.chain.arms[self.receiver].joints
        retreat = np.where([joint.turns for joint in joints], 0.15, 0.05) if self.retreat is None else self.retreat
        put(self, "retreat", spread(retreat, len(joints), f"{what}: retreat"))
        captures = "capture", "capture_angle", "capture_speed", "capture_rate"
        sizes = "duration", "largest_internal", "crushing_internal", "lost", "still"
        self._check_numbers(what, (*captures, *sizes), above=0.0)
        rewards = "reach_reward", "goal_reward", "success_reward"
        self._check_numbers(what, (*rewards, "joint_damping", "internal_cost", "impact_cost"), at_least=0.0)
        self._check_numbers(what, ("internal_force",))

    @property
    def action_size(self) -> int:
        """Number of entries of an action."""
        return self.chain.joint_count + 2

    @property
    def observed(self) -> Mapping[str, Array]:
        """Bounds of the parts of an observation, in the order of the observation."""
        twist = np.full(6, terms.OBSERVED_TWIST)
        return {
            "gap": terms.pose_bounds(),
            "gap_twist": 2.0 * twist,
            "goal": terms.pose_bounds(),
            "twist": twist,
            "holds": np.ones(2),
            "time": np.ones(1),
            "wrench": np.full(6 * len(self.chain.arms), terms.OBSERVED_FORCE * self.largest_internal),
            **terms.joint_bounds(self.chain),
        }

    @property
    def info_names(self) -> tuple[str, ...]:
        """Names of the numbers in `info`."""
        return "internal_force", "distance", "angle", "gap", "speed", "within_reach", "phase", "success"

    @property
    def drawn(self) -> Mapping[str, Shape]:
        """Shapes of the random quantities of an episode: payload, push, goal, and the receiver's joint offsets."""
        joints = self.chain.arms[self.receiver].joint_count
        return {**super().drawn, "displacement": (3,), "turn": (3,), "retreat": (joints,)}

    @property
    def kept(self) -> Mapping[str, Shape]:
        """Shapes of the memory of an episode: the grasp poses on the object, and the speed at which one just closed."""
        return {"grasp_pose": (len(self.chain.grasps), 7), "impact": ()}

    def draw(self, generator: np.random.Generator) -> dict[str, Array]:
        """Return random values for an episode, and the initial values of its memory."""
        found = super().draw(generator)
        for name in ("displacement", "turn", "retreat"):
            largest = getattr(self, name)
            found[name] = largest * generator.uniform(-1.0, 1.0, len(largest))
        poses = [grasp.frame.wxyz_xyz for grasp in self.chain.grasps.values()]
        return found | {"grasp_pose": np.array(poses), "impact": np.array(0.0)}

    def start(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return initial states of episodes, with the receiver's joints moved by their offsets within their limits."""
        found = super().start(drawn, phase)
        if phase != GIVING:
            return found
        part = self.chain.joints[self.receiver]
        low, high = np.array([joint.position_limits for joint in self.chain.all_joints[part]]).T
        found["q"][:, part] = np.clip(found["q"][:, part] + drawn["retreat"], low, high)
        return found

    def load(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return payload, push and grasp poses of episodes as parameters of a phase's rollout."""
        held = [row for row, name in enumerate(self.chain.grasps) if name in self.chains[phase].grasps]
        return super().load(drawn, phase) | {"grasp_pose": drawn["grasp_pose"][:, held]}

    def commanded(self, actions: Array) -> Array:
        """Return the entries of actions that are passed to the control law."""
        return actions[:, :-2]

    @property
    def episode_steps(self) -> int:
        """Number of control steps after which an episode is truncated."""
        return self._control_steps(self.duration)

    @cached_property
    def chains(self) -> tuple[ClosedChain, ClosedChain, ClosedChain]:
        """The chain of each phase."""
        return self.chain.without_grasp(self.receiver), self.chain, self.chain.without_grasp(self.giver)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The three phases: the giver holds the object, both arms hold it, the receiver holds it."""
        return tuple(Phase(self._rollout(chain), self._evaluation(k)) for k, chain in enumerate(self.chains))

    def _rollout(self, chain: ClosedChain) -> Rollout:
        assert self.joint_torque is not None
        internal_force = self.internal_force if len(chain.grasps) > 1 else 0.0
        law = terms.joint_law(chain, self.joint_torque, internal_force, self.joint_damping)
        return compile_rollout(chain, self.sampled(law, chain))

    def _evaluation(self, phase: int) -> BatchFunction:
        inputs = self.argument_shapes(self.chains[phase]) | {name: x.shape for name, x in self.frames.items()}
        return BatchFunction(partial(self.evaluate, phase), inputs, self.result_shapes())

    @frozen_property
    def frames(self) -> Mapping[str, Array]:
        """Base poses, with the names of the machine code."""
        own = parameters_of(self.chain, None)
        return {name: own[name] for name in ("base_R", "base_p")}

    @cached_property
    def tip_on_object(self) -> Pose:
        """Pose of the receiver's tip in the object's frame, in `state`."""
        tip = tip_frames(self.chain, self.state, [self.receiver])[self.receiver]
        return self.state.object_frame.inverse() @ tip

    def prepare(self, episodes: Episodes, rows: Array) -> None:
        """Close the receiver's grasp and open the giver's, where the actions command it."""
        phase, actions = episodes.phase[rows], episodes.actions[rows]
        grips = (phase == GIVING) & (actions[:, -2] > 0.0) & (episodes.seen["within_reach"][rows] > 0.5)
        lets_go = (phase == BOTH) & (actions[:, -1] > 0.0)
        episodes.drawn["impact"][rows] = np.where(grips, episodes.seen["speed"][rows], 0.0)
        column = list(self.chain.grasps).index(self.receiver)
        for row in rows[grips].tolist():
            state = episodes.systems[GIVING].state(row)
            tip = tip_frames(self.chain, state, [self.receiver])[self.receiver]
            there = grasp_here(self.chain.grasps[self.receiver], state.object_frame, tip, self.receiver)
            episodes.drawn["grasp_pose"][row, column] = there.frame.wxyz_xyz
        for some, to in ((rows[grips], BOTH), (rows[lets_go], TAKEN)):
            if len(some):
                episodes.take_over(some, to)

    def evaluate(self, phase: int, given: Given) -> dict[str, Any]:
        """Return observation, reward and termination of one system in a phase.

        Args:
            phase: index of the phase.
            given: its state, grasp wrenches, frames, time, action, and the random values and memory of its episode.
        """
        t, dt = given["t"][()], self.step * self.steps_per_action
        state, motion = traced_state(self.chain, given), self._motion(self.chains[phase], given)
        home, gap, slip = self.state.object_frame, np.zeros(6), np.zeros(6)
        if phase == GIVING:
            arm, wanted = motion.arms[self.receiver], state.object_frame @ self.tip_on_object
            gap = terms.away(wanted, arm.at.tip)
            slip = shift_twist(wanted.p - state.object_frame.p, state.object_twist) - arm.tip_twist
        goal = Pose.unchecked(rotation.exp(given["turn"]) @ home.R, home.p + given["displacement"])
        e = terms.away(goal, state.object_frame)
        parts = {
            "gap": gap,
            "gap_twist": slip,
            "goal": e,
            "twist": state.object_twist,
            "holds": np.array([float(phase != TAKEN), float(phase != GIVING)]),
            "time": array([t / (self.episode_steps * dt)]),
            "wrench": terms.in_object_axes(state, given["grasp_wrench"]),
            "q": state.q,
            "qd": state.qd,
        }
        turned, far = terms.size(gap[:3]), terms.size(gap[3:])
        spinning, speed = terms.size(slip[:3]), terms.size(slip[3:])
        close = turned <= self.capture_angle, far <= self.capture
        near = _all(*close, speed <= self.capture_speed, spinning <= self.capture_rate)
        angle, distance = terms.size(e[:3]), terms.size(e[3:])
        resting = terms.size(state.object_twist[3:]) <= self.still
        there = _all(angle <= self.tolerance_angle, distance <= self.tolerance, resting)
        success = there if phase == TAKEN else 0.0
        length = terms.moment_length(self.chains[phase])
        force = terms.internal_force(motion.chain, state, given["grasp_wrench"], length)
        failed = where(given["code"][()] > 0.5, 1.0, 0.0)
        for over in (force > self.crushing_internal, terms.size(state.object_frame.p - home.p) > self.lost):
            failed = where(over, 1.0, failed)
        success = where(failed > 0.5, 0.0, success)
        rate = self.reach_reward * terms.nearness(gap, self.capture_angle, self.capture)
        if phase == TAKEN:
            rate = rate + self.goal_reward * terms.nearness(e, self.tolerance_angle, self.tolerance)
        rate = rate - self.internal_cost * terms.excess(force, self.largest_internal)
        rate = rate - self.effort_cost * terms.effort(given["action"][:-2])
        once = self.success_reward * success - self.failure_cost * failed - self.impact_cost * given["impact"][()]
        return {
            "observation": terms.bounded(parts, self.observed),
            "reward": dt * rate + once,
            "terminated": where(success > 0.5, 1.0, failed),
            "internal_force": force,
            "distance": distance,
            "angle": angle,
            "gap": far,
            "speed": speed,
            "within_reach": near if phase == GIVING else 0.0,
            "phase": float(phase),
            "success": success,
        }

    def _motion(self, chain: ClosedChain, given: Given) -> ChainMotion:
        """Return the motion of a chain whose grasps are at the poses of an episode."""
        rows = [row for row, name in enumerate(self.chain.grasps) if name in chain.grasps]
        poses = given["grasp_pose"]
        places = {
            "grasp_R": array([rotation.from_quaternion(poses[row][:4]) for row in rows]),
            "grasp_p": array([poses[row][4:] for row in rows]),
        }
        own = traced_chain(Structure(chain, Options()), {**given, **places})
        state = traced_state(chain, given)
        return chain_motion(own, state, np.zeros(chain.joint_count), traced_inputs(own, {}))


def _all(*conditions: Any) -> Any:
    """Return 1 if all conditions hold, else 0."""
    found = 1.0
    for condition in conditions:
        found = where(condition, found, 0.0)
    return found


def _holding(chain: ClosedChain, name: str, what: str, other: str) -> str:
    """Return the given name of an arm with a grasp; without one, the first such arm other than `other`.

    Raises:
        ModelError: there is no such arm, or its grasp is a bushing, which cannot open.
    """
    known = [arm for arm in chain.grasps if arm != other]
    found = name or (known[0] if known else "")
    if found not in known:
        hint = f" '{other}' is the giver." if name and name == other else checks.did_you_mean(name, known)
        raise ModelError(f"hand-over: {what}: expected an arm with a grasp, got {name or 'none'!r}.{hint}")
    if chain.grasps[found].of_kind.compliant:
        raise ModelError(f"hand-over: {what}: expected an arm whose grasp opens and closes, got '{found}', a bushing")
    return found
