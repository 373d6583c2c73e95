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
from holdfast.gym.actions import joint_law
from holdfast.gym.batch_text import BatchText
from holdfast.gym.episodes import Episodes
from holdfast.gym.ready_made import two_hands
from holdfast.gym.setting import common_setting, control_steps, not_negative, positive, spread, torques
from holdfast.gym.task import Phase, Task, chain_and_state
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.compile_rollout import compile_rollout
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.spatial import rotation
from holdfast.spatial.converted import NOT_GIVEN, ArrayField, OptionalArrayField, making
from holdfast.spatial.frozen import Frozen, FrozenDict, read_only
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, where
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import State

TENFOLD = 10.0  # of the bound on internal forces: that of observed forces
GIVING, BOTH, TAKEN = range(3)  # phases


@dataclass(frozen=True, eq=False)
class HandOverTask(Frozen, Task):
    """Hand the object from one arm to another: reach for it, grip, let go, bring it to a place.

    In `state` both hold. Episodes begin with the giver holding alone, the receiver's joints away from there by drawn
    offsets.

    Action, (n + 2,), every entry within [-1, 1] (beyond, it is clipped), held for a control step:

    | 0 to n-1 | torques besides those that carry the weight and damp the joints, arms in order, base to tip, in
    |          | parts of `joint_torque` [N m or N]
    | n        | above 0 the receiver grips where its tip is, if that is within `capture`, `capture_angle`,
    |          | `capture_speed` and `capture_rate` of its place; what still moves stops by an impulse
    | n + 1    | above 0 the giver lets go, if the receiver holds

    Observation, in SI units, each part within the bounds of `observation_space`, beyond which it is clipped:

    | gap      | 6   | from the receiver's tip to its place on the object, where it is in `state`: [rotation vector;
    |          |     | shift], world axes [rad, m]; zero once it holds
    | gap_twist| 6   | twist of that place less the tip's, world axes [rad/s, m/s]
    | goal     | 6   | from the object to its goal, as gap [rad, m]
    | twist    | 6   | of the object, [omega; v of C], world axes [rad/s, m/s]
    | holds    | 2   | 1 where giver, receiver holds, else 0
    | time     | 1   | parts of the episode that have passed
    | wrench   | 6 a | of each of a arms on the object about its contact, [moment; force], object axes [N m, N]
    | q, qd    | n, n| joint positions and rates [rad or m, rad/s or m/s]

    Reward of a control step of length dt: dt times `reach_reward` / (1 + (turn / capture_angle)^2 + (distance /
    capture)^2) of the gap, all of it once the receiver holds; once the giver has let go, dt times `goal_reward`
    likewise of the way to the goal, by `tolerance_angle` and `tolerance`, besides; less dt times `internal_cost` times
    what the internal force exceeds `largest_internal` by, in parts of it; less dt times `effort_cost` times the mean
    square of the torques' actions. Once, less `impact_cost` times the speed between tip and place as it grips; plus
    `success_reward` at the goal; less `failure_cost` where the episode terminates otherwise.

    Terminated with success when the giver has let go and the object is at its goal within the tolerances, slower
    than `still`; otherwise when a grasp slips, a joint passes a limit, the configuration is singular or a step fails,
    when the internal force exceeds `crushing_internal`, or the object is farther than `lost` from where it was.
    Truncated after `duration`.

    `info` has `internal_force` [N], `distance` [m] and `angle` [rad] from the goal, `gap` [m], `speed` [m/s] between
    tip and place, `within_reach` (1.0 where the receiver would grip), `phase` (0.0: the giver holds, 1.0: both, 2.0:
    the receiver), `success` (1.0 or 0.0), and `status`, the name of a `RolloutStatus`.

    Attributes:
        chain: arms, object and grasps, those of giver and receiver among them; two Pandas on a 1 kg box by default.
        state: closed, both holding; given with `chain`.
        giver: name of the arm that holds at first; by default the first with a grasp.
        receiver: name of the arm that takes over; by default the next one.
        retreat: (N,) largest drawn offsets of the receiver's joints [rad or m]; 0.15 rad, 0.05 m by default.
        displacement: (3,) largest drawn displacement of C from `state` to the goal, world axes [m].
        turn: (3,) largest drawn rotation vector likewise [rad].
        duration: of an episode [s].
        step: h of the steps within a control step [s].
        steps_per_action: how many of them an action is held for.
        mass_spread: the payload's mass lies within 1 +- this times the model's, which the controller believes.
        push: (6,) largest constant wrench [moment; force] on the object about C, world axes [N m, N].
        stop_at_limits: whether a joint beyond a limit of position, rate or effort terminates the episode.
        joint_torque: (n,) torques at an action of 1; by default a tenth of the effort limits, 10 where there is none.
        joint_damping: of all joints [N m s/rad or N s/m].
        squeeze: of every arm that holds, along its contact normal, while two or more do [N].
        capture: distance of the tip from its place on the object within which it grips [m].
        capture_angle: angle likewise [rad].
        capture_speed: speed likewise [m/s].
        capture_rate: angular rate likewise [rad/s].
        largest_internal: internal force from which it costs [N].
        crushing_internal: internal force at which the object breaks [N].
        lost: distance of the object from where it was at which it counts as lost [m].
        tolerance: distance from the goal that counts as being there [m].
        tolerance_angle: angle likewise [rad].
        still: speed at the goal that counts as resting [m/s].
        reach_reward: of a second at the grasp.
        goal_reward: of a second at the goal.
        internal_cost: of a second at twice the largest internal force.
        effort_cost: of a second with all torques at 1.
        impact_cost: of gripping at 1 m/s.
        success_reward: of reaching the goal.
        failure_cost: of a termination otherwise.
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
    squeeze: float = 0.0
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

    def __post_init__(self) -> None:
        put, what = object.__setattr__, "hand-over"
        chain, state = chain_and_state(self.chain, self.state, two_hands, what)
        put(self, "chain", chain)
        put(self, "state", state)
        put(self, "giver", _holding(chain, self.giver, "giver", ""))
        put(self, "receiver", _holding(chain, self.receiver, "receiver", self.giver))
        common_setting(self, what)
        for name in ("displacement", "turn"):
            put(self, name, spread(getattr(self, name), 3, f"{what}: {name}"))
        joints = chain.arms[self.receiver].joints
        retreat = np.where([joint.turns for joint in joints], 0.15, 0.05) if self.retreat is None else self.retreat
        put(self, "retreat", spread(retreat, len(joints), f"{what}: retreat"))
        put(self, "joint_torque", torques(self.joint_torque, chain, what))
        captures = "capture", "capture_angle", "capture_speed", "capture_rate"
        for name in (*captures, "duration", "largest_internal", "crushing_internal", "lost", "still"):
            put(self, name, positive(self, name, what))
        for name in ("joint_damping", "reach_reward", "goal_reward", "internal_cost", "impact_cost", "success_reward"):
            put(self, name, not_negative(self, name, what))
        put(self, "squeeze", checks.number(self.squeeze, f"{what}: squeeze"))

    @property
    def action_size(self) -> int:
        """How many numbers an action has."""
        return self.chain.joint_count + 2

    @property
    def observed(self) -> Mapping[str, Array]:
        """Bounds of the parts of an observation, in order."""
        twist = np.full(6, terms.TWIST)
        return {
            "gap": terms.pose_bounds(),
            "gap_twist": 2.0 * twist,
            "goal": terms.pose_bounds(),
            "twist": twist,
            "holds": np.ones(2),
            "time": np.ones(1),
            "wrench": np.full(6 * len(self.chain.arms), TENFOLD * self.largest_internal),
            **terms.joint_bounds(self.chain),
        }

    @property
    def info_names(self) -> tuple[str, ...]:
        """Names of the numbers in `info`."""
        return "internal_force", "distance", "angle", "gap", "speed", "within_reach", "phase", "success"

    @property
    def drawn(self) -> Mapping[str, Shape]:
        """What differs between episodes: payload, push, the goal's displacement and turn, the receiver's offsets."""
        joints = self.chain.arms[self.receiver].joint_count
        return {**super().drawn, "displacement": (3,), "turn": (3,), "retreat": (joints,)}

    @property
    def kept(self) -> Mapping[str, Shape]:
        """What episodes keep besides: where the grasps are on the object, and how fast one closed just now."""
        return {"grasp_pose": (len(self.chain.grasps), 7), "impact": ()}

    def draw(self, generator: np.random.Generator) -> dict[str, Array]:
        """Return what is drawn for an episode, and what it keeps at first."""
        found = super().draw(generator)
        for name in ("displacement", "turn", "retreat"):
            largest = getattr(self, name)
            found[name] = largest * generator.uniform(-1.0, 1.0, len(largest))
        poses = [grasp.frame.wxyz_xyz for grasp in self.chain.grasps.values()]
        return found | {"grasp_pose": np.array(poses), "impact": np.array(0.0)}

    def start(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return the states in which episodes begin: the receiver's joints away, within their limits."""
        found = super().start(drawn, phase)
        if phase != GIVING:
            return found
        part = self.chain.joints[self.receiver]
        low, high = np.array([joint.position_limits for joint in self.chain.all_joints[part]]).T
        found["q"][:, part] = np.clip(found["q"][:, part] + drawn["retreat"], low, high)
        return found

    def load(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return payload and push of episodes, and where their grasps are, as parameters of a phase's rollout."""
        held = [row for row, name in enumerate(self.chain.grasps) if name in self.chains[phase].grasps]
        return super().load(drawn, phase) | {"grasp_pose": drawn["grasp_pose"][:, held]}

    def commanded(self, actions: Array) -> Array:
        """Return the part of actions that the control law takes."""
        return actions[:, :-2]

    @property
    def episode_steps(self) -> int:
        """Control steps until an episode is truncated."""
        return control_steps(self, self.duration)

    @cached_property
    def chains(self) -> tuple[ClosedChain, ClosedChain, ClosedChain]:
        """The chain of each phase."""
        return self.chain.without_grasp(self.receiver), self.chain, self.chain.without_grasp(self.giver)

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The giver holds, both do, the receiver does."""
        return self._phases

    @cached_property
    def _phases(self) -> tuple[Phase, ...]:
        return tuple(Phase(self._rollout(chain), self._look_in(k)) for k, chain in enumerate(self.chains))

    def _rollout(self, chain: ClosedChain) -> Rollout:
        assert self.joint_torque is not None
        squeeze = self.squeeze if len(chain.grasps) > 1 else 0.0
        return compile_rollout(chain, joint_law(chain, self.joint_torque, squeeze, self.joint_damping))

    def _look_in(self, phase: int) -> BatchText:
        inputs = self.looked_at(self.chains[phase]) | {name: x.shape for name, x in self.frames.items()}
        return BatchText(partial(self.look, phase), inputs, self.says())

    @property
    def frames(self) -> Mapping[str, Array]:
        """Where the bases are, by the machine code's names."""
        return self._bases

    @cached_property
    def _bases(self) -> Mapping[str, Array]:
        own = parameters_of(self.chain, None)
        return FrozenDict({name: read_only(own[name]) for name in ("base_R", "base_p")})

    @cached_property
    def tip_on_object(self) -> Pose:
        """Pose of the receiver's tip in the object's frame where both hold, in `state`."""
        tip = tip_frames(self.chain, self.state, [self.receiver])[self.receiver]
        return self.state.object_frame.inverse() @ tip

    def prepare(self, episodes: Episodes, rows: Array) -> None:
        """Close the receiver's grasp and open the giver's, as the actions say."""
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

    def look(self, phase: int, given: Given) -> dict[str, Any]:
        """Return observation, reward and end of one system in a phase.

        Args:
            phase: which.
            given: its state, grasp wrenches, frames, time, action, what was drawn for it and what it keeps.
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
        near = _all(
            turned <= self.capture_angle,
            far <= self.capture,
            speed <= self.capture_speed,
            spinning <= self.capture_rate,
        )
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
        """Return a chain in motion, its grasps where an episode has them."""
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
    """Return 1 where all conditions hold, else 0."""
    found = 1.0
    for condition in conditions:
        found = where(condition, found, 0.0)
    return found


def _holding(chain: ClosedChain, name: str, what: str, other: str) -> str:
    """Return the name of an arm with a grasp, the first other one if none is given.

    Raises:
        ModelError: there is none of that name, or it is a bushing, which does not open.
    """
    known = [arm for arm in chain.grasps if arm != other]
    found = name or (known[0] if known else "")
    if found not in known:
        hint = f" '{other}' is the giver." if name and name == other else checks.did_you_mean(name, known)
        raise ModelError(f"hand-over: {what}: expected an arm with a grasp, got {name or 'none'!r}.{hint}")
    if chain.grasps[found].of_kind.compliant:
        raise ModelError(f"hand-over: {what}: expected an arm whose grasp opens and closes, got '{found}', a bushing")
    return found
