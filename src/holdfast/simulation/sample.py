"""One sample of a run: everything that is recorded at an instant."""

from __future__ import annotations

import math

import numpy as np

from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.closed.spring_wrenches import with_springs
from holdfast.dynamics.energy import Body, bodies, elastic_energy
from holdfast.forces.force_split import split
from holdfast.forces.margin_interval import margin_range
from holdfast.forces.margins import grasp_margins
from holdfast.forces.wrist import wrist_wrenches
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import Sums
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import JOINT_QUANTITIES, by_arm
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Occurrence, Trajectory
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.vector import cross
from holdfast.state import State


def sample(
    at: Instant,
    gaps: Gaps,
    sums: Sums,
    times: Array,
    margins: Array,
    occurrences: tuple[Occurrence, ...] = (),
) -> Trajectory:
    """Return one sample: the fields of a trajectory without the sample axis.

    Args:
        at: the instant.
        gaps: what projection found and left.
        sums: since the run's start.
        times: (looks,) at which margins were looked at since the sample before, this one's last.
        margins: (looks, signals) then, see `margins.Signals`.
        occurrences: what happened since the sample before.
    """
    chain, state, found = at.chain, at.state, at.result
    parts = split(chain, state, found.grasp_wrench)
    allowed = margin_range(chain, state, found)
    given = grasp_margins(chain, state, found.grasp_wrench)
    now, best, worst = (by_arm(chain, m) for m in (given, allowed.best, allowed.worst))
    lowest, when = _lowest(times, margins)
    every = list(bodies(chain, state, at.inputs))
    l = len(chain.arms)
    joint, joint_lowest, joint_when = _lowest_joints(lowest[l:], when[l:])
    return Trajectory(
        t=np.array(at.t),
        q=state.q,
        qd=state.qd,
        qdd=found.qdd,
        tau=at.tau,
        object_pose=state.object_pose,
        object_twist=state.object_twist,
        object_acceleration=found.object_acceleration,
        grasp_wrench=found.grasp_wrench,
        internal_wrench=parts.internal,
        load_share=np.zeros(l) if parts.load_share is None else parts.load_share,
        wrist_wrench=wrist_wrenches(chain, state, found),
        base_wrench=found.base_wrench,
        holding=np.array([name in chain.grasps for name in chain.names]),
        spin=spins(chain, state),
        margin=now,
        best_margin=best,
        worst_margin=worst,
        lowest_margin=lowest[:l],
        lowest_margin_time=when[:l],
        lowest_joint_margin=joint_lowest,
        lowest_joint_margin_time=joint_when,
        lowest_joint=joint,
        position_gap=gaps.position,
        velocity_gap=gaps.velocity,
        kinetic=np.array(sum(body.kinetic_energy for body in every) + _rotors(chain, state)),
        potential=np.array(sum(body.potential_energy(chain.gravity) for body in every) + elastic_energy(chain, state)),
        work=sums.work,
        impact=np.array(sums.impact),
        momentum=np.sum([body.momentum(np.zeros(3)) for body in every], axis=0),
        momentum_rate=_wrenches(at, every),
        base_impulse=sums.base_impulse,
        condition=np.array(found.condition),
        occurrences=occurrences,
    )


def spins(chain: ClosedChain, state: State) -> Array:
    """Return how far each soft finger's contact is turned about its normal, (arms,) [rad]; 0 for other grasps.

    The part about z of the turn from tip frame to contact frame, within -pi .. pi. No spin rate is transmitted,
    and yet rolling turns it (Appendix A): it is reported, not corrected.
    """
    turned = np.zeros(len(chain.arms))
    for name, grasp in chain.grasps.items():
        if grasp.of_kind.rate_rows:
            tip = posture(chain.arms[name], state.q[chain.joints[name]]).tip.R
            q = rotation.to_quaternion(tip.T @ state.object_frame.R @ grasp.frame.R)
            turned[chain.names.index(name)] = 2.0 * math.atan2(q[3], q[0])
    return turned


def _rotors(chain: ClosedChain, state: State) -> float:
    """Return the kinetic energy of the drives' rotors [J]."""
    return 0.5 * float(np.concatenate([arm.armature for arm in chain.arms.values()]) @ state.qd**2)


def _wrenches(at: Instant, every: list[Body]) -> Array:
    """Return what changes the momentum about the world's origin: `momentum_rate` over bodies that are known."""
    chain, given = at.chain, with_springs(at.chain, at.state, at.inputs.shaped(at.chain))
    assert given.object_wrench is not None
    total = shift_wrench(every[-1].origin, given.object_wrench)
    for arm, f in zip(chain.arms.values(), at.result.base_wrench, strict=True):
        total = total + shift_wrench(arm.base.p, f)
    if given.link_wrenches is not None:
        for body, f in zip(every, given.link_wrenches, strict=False):
            total = total + shift_wrench(body.origin, f)
    mass, com = sum(body.inertia.m for body in every), np.sum([body.com for body in every], axis=0)
    return total + np.concatenate([cross(com, chain.gravity), mass * chain.gravity])


def _lowest(times: Array, margins: Array) -> tuple[Array, Array]:
    """Return the lowest margin of every signal, and when it was."""
    k = np.argmin(margins, axis=0)
    return margins[k, np.arange(margins.shape[1])], times[k]


def _lowest_joints(lowest: Array, when: Array) -> tuple[Array, Array, Array]:
    """Return per quantity the joint whose margin was lowest, that margin, and when it was, (3,) each."""
    lowest, when = (array.reshape(len(JOINT_QUANTITIES), -1) for array in (lowest, when))
    k = np.argmin(lowest, axis=1)
    rows = np.arange(len(k))
    return k, lowest[rows, k], when[rows, k]
