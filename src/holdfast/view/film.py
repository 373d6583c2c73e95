"""What is shown of a run: a few moments a second, with everything that the pictures need at each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from holdfast.dynamics.arm.posture import Posture, posture
from holdfast.dynamics.near_singular import arm_strength
from holdfast.errors import ModelError
from holdfast.forces.force_split import split
from holdfast.forces.margins import grasp_margins
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.instant import Instant
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.view.pieces import Piece

Looks = Mapping[str, Sequence[Sequence[Piece]]]
RATE = 30.0  # moments a second
SMALLEST_HOLD = 1e-9  # N
MOST_MOMENTS = 20_000  # more take minutes to draw, and as long to load


@dataclass(frozen=True, eq=False)
class Film:
    """The moments that are shown; the first axis of every array is the moment.

    Attributes:
        chain: the chain.
        title: what it is called.
        t: (moments,) [s].
        q: (moments, n) [rad or m].
        base_pose: (moments, arms, 7) wxyz_xyz.
        object_pose: (moments, 7) wxyz_xyz.
        tip: (moments, arms, 3) tip points, world axes: where an arm that holds touches the object [m].
        wrench: (moments, arms, 6) of each arm on the object about its tip, world axes [N m, N].
        internal: (moments, arms, 6) the part of it that moves nothing.
        margin: (moments, arms) how far each grasp is from giving way [N]; infinite where nothing limits.
        condition: (moments,) of the grasp constraint.
        strength: (moments, arms) of each arm's weakest tip direction, 0 at a singular posture; 1 without a grasp.
        tau: (moments, n) [N m or N].
        looks: what an arm is drawn with, if not with simple solids, by its name; see `pieces`.
    """

    chain: ClosedChain
    title: str
    t: Array
    q: Array
    base_pose: Array
    object_pose: Array
    tip: Array
    wrench: Array
    internal: Array
    margin: Array
    condition: Array
    strength: Array
    tau: Array
    looks: Looks = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def holding(self) -> list[str]:
        """The arms that hold the object at some moment."""
        return [n for i, n in enumerate(self.chain.names) if n in self.chain.grasps or self.wrench[:, i].any()]

    def reserve(self, name: str) -> Array:
        """Return the margin of an arm's friction cone as a share of mu f_n, 0 to 1, (moments,)."""
        i, grasp = self.chain.names.index(name), self.chain.grasps[name]
        if grasp.contact is None:
            return np.ones(len(self))
        normals = np.array([rotation.from_quaternion(pose[:4]) @ grasp.frame.R[:, 2] for pose in self.object_pose])
        hold = grasp.contact.mu * np.sum(normals * self.wrench[:, i, 3:], axis=1)
        reserve = np.clip(self.margin[:, i] / np.maximum(hold, SMALLEST_HOLD), 0.0, 1.0)
        return np.where(self.wrench[:, i].any(axis=1), reserve, 1.0)  # an arm that has let go cannot slip

    def torque_use(self, name: str) -> Array | None:
        """Return the largest |tau| over its limit of an arm's joints, (moments,); None without limits."""
        limits = np.array([joint.effort_limit for joint in self.chain.arms[name].joints])
        return np.abs(self.tau[:, self.chain.joints[name]] / limits).max(axis=1) if np.isfinite(limits).any() else None


def film_of_run(
    chain: ClosedChain,
    run: Trajectory,
    title: str = "run",
    rate: float = RATE,
    base_motion: Mapping[str, BaseMotion] | None = None,
    looks: Looks | None = None,
) -> Film:
    """Return the samples of a run nearest to `rate` moments a second; nothing is interpolated.

    Args:
        chain: the chain that was simulated.
        run: its run.
        title: what it is called.
        rate: moments a second of the run's time.
        base_motion: as for `simulate`.
        looks: as for `Film`.

    Raises:
        StateError: what is no run, or not of this chain.
        ModelError: a rate that is not positive or gives more than 20,000 moments, or a moving base of no arm.
    """
    require_run_of(chain, run)
    k = samples_at(run.t, checks.number(rate, "rate", above=0.0))
    if len(k) > MOST_MOMENTS:
        raise ModelError(f"rate: expected at most {MOST_MOMENTS} moments, got {len(k)}; try a lower rate")
    world = Environment(chain, base_motion or {})
    arms = [world.at(float(t))[0].arms for t in run.t[k]]
    bases = np.array([[arm.base.wxyz_xyz for arm in at.values()] for at in arms])
    postures = [
        [posture(arm, run.q[j, chain.joints[name]]) for name, arm in at.items()] for j, at in zip(k, arms, strict=True)
    ]
    tips = np.array([[at.tip.p for at in now] for now in postures])
    strength = np.array([_strengths(chain, pose, at) for pose, at in zip(run.object_pose[k], postures, strict=True)])
    strength[~run.holding[k]] = 1.0
    return Film(
        chain, title, run.t[k], run.q[k], bases, run.object_pose[k], tips, run.grasp_wrench[k],
        run.internal_wrench[k], run.margin[k], run.condition[k], strength, run.tau[k], looks or {},
    )  # fmt: skip


def film_of_instant(at: Instant, title: str, looks: Looks | None = None) -> Film:
    """Return a film of one moment: a state, its torques, and what forward dynamics found."""
    chain, state, found = at.chain, at.state, at.result
    margin = np.full(len(chain.arms), np.inf)
    margin[[chain.names.index(name) for name in chain.grasps]] = grasp_margins(chain, state, found.grasp_wrench)
    bases = [arm.base.wxyz_xyz for arm in chain.arms.values()]
    postures = [posture(arm, state.q[chain.joints[name]]) for name, arm in chain.arms.items()]
    tips = [at.tip.p for at in postures]
    internal = split(chain, state, found.grasp_wrench).internal
    moment = (
        at.t, state.q, bases, state.object_pose, tips, found.grasp_wrench, internal, margin, found.condition,
        _strengths(chain, state.object_pose, postures), at.tau,
    )  # fmt: skip
    return Film(chain, title, *(np.array([part]) for part in moment), looks=looks or {})


def _strengths(chain: ClosedChain, object_pose: Array, postures: list[Posture]) -> list[float]:
    """Return the strength of each arm's weakest tip direction."""
    R = rotation.from_quaternion(object_pose[:4])
    grasps = chain.grasps
    return [
        arm_strength(arm, at, grasps[name], R) if name in grasps else 1.0
        for (name, arm), at in zip(chain.arms.items(), postures, strict=True)
    ]


def samples_at(t: Array, rate: float) -> Array:
    """Return the indices of the samples nearest to `rate` a second; the first and the last are among them."""
    if (t[-1] - t[0]) * rate > len(t):
        return np.arange(len(t))
    wanted = np.append(np.arange(t[0], t[-1], 1 / rate), t[-1])
    after = np.clip(np.searchsorted(t, wanted), 1, max(len(t) - 1, 1))
    nearest = np.where(wanted - t[after - 1] <= t[np.minimum(after, len(t) - 1)] - wanted, after - 1, after)
    return np.unique(np.minimum(nearest, len(t) - 1))
