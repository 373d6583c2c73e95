"""Random paths of two and three arms under a law within limits, through postures near singular ones too.

    python -m benchmarks.random_paths [paths]                by default 1,000, some minutes

Every path moves and turns the object from rest to rest with a bump to the side. The law is `cooperative_law` with
limits on torques and joints, a demanded margin and an acceleration that gives way, sampled at 1 kHz. Without the limits
on joint rates, straight arms snap through faster than samples can follow. Half the paths end near the edge of the
reach, or a little beyond, where arms are straight. Counted are runs that diverge, torques beyond their limits, and
slips that no margin below the demanded one foretold.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from tests.control.three_pandas import three_pandas

import holdfast as hf
from benchmarks.bench.systems import facing_pandas
from holdfast.control import InternalForce, cooperative_law, sampled
from holdfast.control.law_parts import CommandedMotion, LawInput
from holdfast.control.paths import pose_error, quintic
from holdfast.dynamics.near_singular import weakest_strength
from holdfast.forces import ForceCost, ForceLimits
from holdfast.simulation.rollout.systems import RolloutStatus
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, concatenate, maximum, minimum

MARGIN, SHARE, SQUEEZE = 2.0, 0.8, 30.0  # N, of effort limits, N
TASK = 10.0
T, DURATION, AFTER = 1e-3, 1.5, 0.3  # s
FREQUENCY = 15.0  # rad/s, of a critically damped error
FASTEST = 30.0  # rad/s: a joint that is faster has run away
SEEN_AHEAD = 1e-6  # N by which a margin must be below the demanded one to foretell a slip
REACH_DIGITS = 1e-4  # m
DRAWN = {"start": (7,), "shift": (3,), "turn": (3,), "bump": (3,)}


@dataclass(frozen=True, eq=False)
class DrawnPath(CommandedMotion):
    """Computed torque along a path whose start, displacement, rotation and bump are parameters of the law."""

    def parameters(self, chain: hf.ClosedChain) -> dict[str, tuple[int, ...]]:
        """Return their shapes."""
        return DRAWN

    def acceleration(self, x: LawInput) -> Array:
        """Return the acceleration of the path, and what draws the object to it."""
        y = minimum(maximum(x.t / DURATION, 0.0), 1.0)
        s, rate, second = quintic(y)
        inner, slope = y * (1.0 - y), 1.0 - 2.0 * y
        side = (64.0 * inner**3, 192.0 * inner**2 * slope, 384.0 * inner * (slope**2 - inner))
        (turn, shift, bump), start = (x.given[name] for name in ("turn", "shift", "bump")), x.given["start"]
        R = rotation.exp(s * turn) @ rotation.from_quaternion(start[:4])
        pose = hf.Pose(R, start[4:] + s * shift + side[0] * bump)
        twist = concatenate([rate * turn, rate * shift + side[1] * bump]) / DURATION
        wanted = concatenate([second * turn, second * shift + side[2] * bump]) / DURATION**2
        off, late = pose_error(pose, x.state.object_frame), twist - x.state.object_twist
        return wanted + FREQUENCY**2 * off + 2.0 * FREQUENCY * late


class Counts(NamedTuple):
    """What happened on the paths of one chain.

    Attributes:
        paths: number of paths.
        diverged: runs whose joints ran away, or that ended otherwise than by a slip.
        beyond: largest torque beyond its limit, relative to it.
        slips: runs that ended in a slip.
        unforeseen: slips without a margin below the demanded one at a sample before.
        near_singular: runs that came below a strength of 0.01.
        gave_way: runs whose acceleration gave way by more than 1 m/s^2.
    """

    paths: int
    diverged: int
    beyond: float
    slips: int
    unforeseen: int
    near_singular: int
    gave_way: int


def law_of(chain: hf.ClosedChain) -> hf.ControlLaw:
    """Return the law."""
    limits = ForceLimits(SHARE, least_margin=MARGIN if holds_by_friction(chain) else None, sample_time=T)
    cost = ForceCost(wrench=0.1, task=TASK)
    return sampled(
        cooperative_law(chain, DrawnPath(), InternalForce(SQUEEZE), limits=limits, cost=cost), chain, sample_time=T
    )


def efforts(chain: hf.ClosedChain) -> Array:
    """Return the effort limits of all joints."""
    return np.array([joint.effort_limit for joint in chain.all_joints])


def holds_by_friction(chain: hf.ClosedChain) -> bool:
    """Return whether grasps can slip."""
    return any(grasp.contact is not None for grasp in chain.grasps.values())


def drawn(chain: hf.ClosedChain, state: hf.State, count: int, random: np.random.Generator) -> dict[str, Array]:
    """Return the parameters of paths; every second one ends near the edge of what the arms reach."""
    ways, turns = random.normal(size=(count, 3)), random.uniform(-0.5, 0.5, (count, 3))
    lengths, bumps = random.uniform(0.05, 0.2, count), random.uniform(-0.06, 0.06, (count, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    for k in range(1, count, 2):
        turns[k] *= 0.2
        bumps[k] *= 0.2
        beyond = 10.0 ** random.uniform(-6.0, -1.3) if random.uniform() < 0.8 else -random.uniform(0.0, 0.02)
        lengths[k] = (1.0 - beyond) * reach(chain, state, ways[k], turns[k])
    return {
        "start": np.tile(state.object_pose, (count, 1)),
        "shift": lengths[:, None] * ways,
        "turn": turns,
        "bump": bumps,
    }


def reach(chain: hf.ClosedChain, state: hf.State, way: Array, turn: Array) -> float:
    """Return how far the arms reach in a direction, by closed states on the way, whatever the joints' limits."""
    q, length, step = state.q, 0.0, 0.05
    while step > REACH_DIGITS:
        there = length + step
        frame = state.object_frame
        pose = hf.Pose(rotation.exp(min(there, 1.0) * turn) @ frame.R, frame.p + there * way)
        try:
            q = hf.close(chain, hf.State(q, 0.0 * q, pose.wxyz_xyz), hold_object=True, limits=False).q
            length = there
        except hf.HoldfastError:
            step *= 0.25
    return length


def counted(chain: hf.ClosedChain, state: hf.State, count: int, seed: int, tell: Callable[[str], Any]) -> Counts:
    """Return what happens on random paths of a chain, and tell of every failure."""
    law, given = law_of(chain), drawn(chain, state, count, np.random.default_rng(seed))
    rollout = hf.compile_rollout(chain, law)
    rows = (np.tile(x, (count, 1)) for x in (state.q, state.qd, state.object_pose, state.object_twist))
    systems, steps = rollout.start(*rows, **given), round((DURATION + AFTER) / T)
    effort = SHARE * efforts(chain)
    record = rollout.run(systems, steps * T, T, record=["q", "qd", "tau", "margin", "memory"], least_margin=0.0)
    ended = list(record.systems.status)
    share = np.abs(record["tau"]) / effort
    fast, least = np.abs(record["qd"]), record["margin"].min(axis=2)
    missed = record["memory"][..., 1]
    strengths = np.array([weakest(chain, state, record["q"][:: steps // 10, k]) for k in range(count)])
    diverged, unforeseen = [], []
    for k in range(count):
        slipped = ended[k] == RolloutStatus.SLIPPED
        if not np.isfinite(fast[:, k]).all() or fast[:, k].max() > FASTEST or not (slipped or usual(ended[k])):
            diverged.append(k)
        if slipped and not (least[:, k] < MARGIN - SEEN_AHEAD).any():
            unforeseen.append(k)
    for what, those in (("diverged", diverged), ("slipped unforeseen", unforeseen)):
        for k in those:
            tell(f"  path {k} of seed {seed} {what}: {ended[k].name}, fastest joint {fast[:, k].max():.3g} rad/s")
    slips = sum(one == RolloutStatus.SLIPPED for one in ended)
    near, gave = int((strengths < 0.01).sum()), int((missed.max(axis=0) > 1.0).sum())
    return Counts(count, len(diverged), float(share.max()) - 1.0, slips, len(unforeseen), near, gave)


def usual(status: RolloutStatus) -> bool:
    """Return whether a run went on to its end."""
    return status in (RolloutStatus.RUNNING, RolloutStatus.UNRESOLVED)


def weakest(chain: hf.ClosedChain, state: hf.State, q: Array) -> float:
    """Return the least strength of an arm over some configurations."""
    return min(weakest_strength(chain, hf.State(one, 0.0 * one, state.object_pose)) for one in q)


def main(count: int = 1000) -> int:
    """Print the counts of every chain; return 1 if one is not zero that has to be."""
    rubber = hf.Friction(mu=0.8, torsion_radius=0.02)
    chains = {
        "two arms, rigid": facing_pandas(),
        "two arms, soft fingers": facing_pandas("softfinger", rubber),
        "three arms, soft fingers": three_pandas(),
    }
    bad = 0
    for seed, (name, (chain, state)) in enumerate(chains.items()):
        begin = time.process_time()
        one = counted(chain, state, -(-count // len(chains)), seed, print)
        bad += one.diverged + one.unforeseen + (one.beyond > 1e-9)
        print(
            f"{name}: {one.paths} paths, {one.near_singular} near singular postures, {one.gave_way} on which the"
            f" acceleration gave way; {one.diverged} diverged, torques beyond limits by {one.beyond:.1e},"
            f" {one.slips} slips, {one.unforeseen} of them unforeseen ({time.process_time() - begin:.0f} s)",
            flush=True,
        )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
