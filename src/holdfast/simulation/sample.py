"""Samples of a run: everything that is recorded at one instant."""

from __future__ import annotations

import math

import numpy as np

from holdfast.dynamics.contact_places import tip_frames
from holdfast.dynamics.result import Status
from holdfast.forces.force_split import Splitter
from holdfast.forces.margin_interval import margin_range
from holdfast.forces.margins import conditions, grasp_margins
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.accounts import ACCOUNTS_WORTH_COMPILING, Accounts, CompiledAccounts, accounts_of
from holdfast.simulation.balance import Sums
from holdfast.simulation.events import Occurrence
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import JOINT_QUANTITIES, by_arm
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.state import State


class Recorder:
    """Makes the samples of a run, and computes once what is common to successive samples.

    Attributes:
        worth_compiling: whether there will be enough samples to compile the balance quantities to machine code.
    """

    def __init__(self, samples: int = 1) -> None:
        """Store the approximate number of samples."""
        self.worth_compiling = samples >= ACCOUNTS_WORTH_COMPILING
        self._of_grasps: OfGrasps | None = None
        self._compiled: CompiledAccounts | None = None

    def sample(
        self,
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
            gaps: position and velocity gaps before and after projection.
            sums: work and impulses since the run's start.
            times: (k,) times since the previous sample at which the margins were evaluated; the last is that of `at`.
            margins: (k, signals) margins at these times, see `margins.Signals`.
            occurrences: what has happened since the previous sample.
        """
        chain, state, found, accounts = at.chain, at.state, at.result, self._accounts(at)
        same = self._same(chain)
        parts, (now, best, worst) = same.split(state, found.grasp_wrench), same.margins(at)
        lowest, when = _lowest(times, margins)
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
            wrist_wrench=accounts.wrist,
            base_wrench=found.base_wrench,
            holding=same.holding,
            spin=spins(chain, state) if same.soft else np.zeros(l),
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
            kinetic=np.array(accounts.kinetic),
            potential=np.array(accounts.potential),
            work=sums.work,
            impact=np.array(sums.impact),
            momentum=accounts.momentum,
            momentum_rate=accounts.rate,
            base_impulse=sums.base_impulse,
            condition=np.array(found.condition),
            base_pose=_or_none(state.base_pose),
            base_twist=_or_none(state.base_twist),
            base_acceleration=_or_none(found.base_acceleration),
            trunk_base_wrench=_or_none(found.trunk_base_wrench),
            occurrences=occurrences,
        )

    def _accounts(self, at: Instant) -> Accounts:
        """Return the balance quantities, computed by machine code if that is possible and worthwhile."""
        if not self.worth_compiling or not CompiledAccounts.suit(at.chain, at.inputs):
            return accounts_of(at)
        if self._compiled is None or self._compiled.chain is not at.chain:
            self._compiled = CompiledAccounts(at.chain)
        return self._compiled.of(at)

    def _same(self, chain: ClosedChain) -> OfGrasps:
        """Return the data that depend on the grasps only, not on the poses of the bases."""
        if self._of_grasps is None or self._of_grasps.grasps is not chain.grasps:
            self._of_grasps = OfGrasps(chain)
        return self._of_grasps


class OfGrasps:
    """Data that depend on the grasps only.

    Attributes:
        grasps: the grasps of the chain.
        split: splits the grasp wrenches into motion and internal parts.
        holding: (arms,) whether each arm has a grasp.
        soft: whether there is a soft finger, whose contact may spin.
        limited: whether there is a grasp with a limit.
    """

    def __init__(self, chain: ClosedChain) -> None:
        self.grasps, self.split = chain.grasps, Splitter(chain)
        self.holding = np.array([name in chain.grasps for name in chain.names])
        self.soft = any(grasp.of_kind.rate_rows for grasp in chain.grasps.values())
        self.limited = any(conditions(grasp) for grasp in chain.grasps.values())

    def margins(self, at: Instant) -> tuple[Array, Array, Array]:
        """Return the current margins, and the best and worst that internal forces allow, each by arm (arms,)."""
        chain, state, found = at.chain, at.state, at.result
        unique = found.status is not Status.INDETERMINATE_FORCES
        if unique and not self.limited:
            none = np.full(len(self.holding), np.inf)
            return none, none, none
        allowed = margin_range(chain, state, found)
        margin = allowed.best if unique else grasp_margins(chain, state, found.grasp_wrench)
        now, best, worst = (by_arm(chain, m) for m in (margin, allowed.best, allowed.worst))
        return now, best, worst


def spins(chain: ClosedChain, state: State) -> Array:
    """Return the rotation of each soft finger's contact about its normal, (arms,) [rad]; 0 for other grasps.

    This is the component about z of the rotation from the tip frame to the contact frame, within -pi .. pi. The spin
    rate of a soft finger is constrained to zero, but rolling still changes the angle (Appendix A). It is reported, not
    corrected.
    """
    turned = np.zeros(len(chain.arms))
    soft = [name for name, grasp in chain.grasps.items() if grasp.of_kind.rate_rows]
    for name, tip in tip_frames(chain, state, soft).items():
        q = rotation.to_quaternion(tip.R.T @ state.object_frame.R @ chain.grasps[name].frame.R)
        turned[chain.names.index(name)] = 2.0 * math.atan2(q[3], q[0])
    return turned


def _or_none(array: Array | None) -> Array:
    """Return an array that belongs to a trunk, or an empty array if it is None."""
    return np.zeros(0) if array is None else array


def _lowest(times: Array, margins: Array) -> tuple[Array, Array]:
    """Return the lowest margin of every signal, and its time."""
    k = np.argmin(margins, axis=0)
    return margins[k, np.arange(margins.shape[1])], times[k]


def _lowest_joints(lowest: Array, when: Array) -> tuple[Array, Array, Array]:
    """Return for each quantity the joint with the lowest margin, that margin, and its time, (3,) each.

    Without joints the margins are infinite and the joint numbers have no meaning.
    """
    if not lowest.size:
        none = np.full(len(JOINT_QUANTITIES), np.inf)
        return np.zeros(len(none), dtype=int), none, none
    lowest, when = (array.reshape(len(JOINT_QUANTITIES), -1) for array in (lowest, when))
    k = np.argmin(lowest, axis=1)
    rows = np.arange(len(k))
    return k, lowest[rows, k], when[rows, k]
