"""One sample of a run: everything that is recorded at an instant."""

from __future__ import annotations

import math

import numpy as np

from holdfast.dynamics.contact_places import tip_frames
from holdfast.dynamics.result import Status
from holdfast.forces.force_split import Splitter
from holdfast.forces.margin_interval import margin_range
from holdfast.forces.margins import conditions, grasp_margins
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.accounts import WORTH_COMPILING, Accounts, CompiledAccounts, accounts_of
from holdfast.simulation.balance import Sums
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import JOINT_QUANTITIES, by_arm
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Occurrence, Trajectory
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.state import State


class Recorder:
    """Makes samples of instants: what stays the same from one to the next is found once.

    Attributes:
        worth_compiling: whether there will be so many that machine code keeps the books.
    """

    def __init__(self, samples: int = 1) -> None:
        """Take how many samples there will be, about."""
        self.worth_compiling = samples >= WORTH_COMPILING
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
            gaps: what projection found and left.
            sums: since the run's start.
            times: (looks,) at which margins were looked at since the sample before, this one's last.
            margins: (looks, signals) then, see `margins.Signals`.
            occurrences: what happened since the sample before.
        """
        chain, state, found, books = at.chain, at.state, at.result, self._accounts(at)
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
            wrist_wrench=books.wrist,
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
            kinetic=np.array(books.kinetic),
            potential=np.array(books.potential),
            work=sums.work,
            impact=np.array(sums.impact),
            momentum=books.momentum,
            momentum_rate=books.rate,
            base_impulse=sums.base_impulse,
            condition=np.array(found.condition),
            base_pose=_or_none(state.base_pose),
            base_twist=_or_none(state.base_twist),
            base_acceleration=_or_none(found.base_acceleration),
            trunk_base_wrench=_or_none(found.trunk_base_wrench),
            occurrences=occurrences,
        )

    def _accounts(self, at: Instant) -> Accounts:
        """Return what the books say, by machine code where it suits and is worth while."""
        if not self.worth_compiling or not CompiledAccounts.suit(at.chain, at.inputs):
            return accounts_of(at)
        if self._compiled is None or self._compiled.chain is not at.chain:
            self._compiled = CompiledAccounts(at.chain)
        return self._compiled.of(at)

    def _same(self, chain: ClosedChain) -> OfGrasps:
        """Return what follows from these grasps; wherever bases are, it is the same."""
        if self._of_grasps is None or self._of_grasps.grasps is not chain.grasps:
            self._of_grasps = OfGrasps(chain)
        return self._of_grasps


class OfGrasps:
    """What stays the same as long as the grasps do.

    Attributes:
        grasps: of the chain.
        split: of their wrenches.
        holding: (arms,) whether each arm has one.
        soft: whether the contact of one may spin.
        limited: whether something limits one.
    """

    def __init__(self, chain: ClosedChain) -> None:
        self.grasps, self.split = chain.grasps, Splitter(chain)
        self.holding = np.array([name in chain.grasps for name in chain.names])
        self.soft = any(grasp.of_kind.rate_rows for grasp in chain.grasps.values())
        self.limited = any(conditions(grasp) for grasp in chain.grasps.values())

    def margins(self, at: Instant) -> tuple[Array, Array, Array]:
        """Return the margins now, the best and the worst that internal forces allow, by arm (arms,) each."""
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
    """Return how far each soft finger's contact is turned about its normal, (arms,) [rad]; 0 for other grasps.

    The part about z of the turn from tip frame to contact frame, within -pi .. pi. No spin rate is transmitted,
    and yet rolling turns it (Appendix A): it is reported, not corrected.
    """
    turned = np.zeros(len(chain.arms))
    soft = [name for name, grasp in chain.grasps.items() if grasp.of_kind.rate_rows]
    for name, tip in tip_frames(chain, state, soft).items():
        q = rotation.to_quaternion(tip.R.T @ state.object_frame.R @ chain.grasps[name].frame.R)
        turned[chain.names.index(name)] = 2.0 * math.atan2(q[3], q[0])
    return turned


def _or_none(array: Array | None) -> Array:
    """Return an array of a trunk, without entries where there is none."""
    return np.zeros(0) if array is None else array


def _lowest(times: Array, margins: Array) -> tuple[Array, Array]:
    """Return the lowest margin of every signal, and when it was."""
    k = np.argmin(margins, axis=0)
    return margins[k, np.arange(margins.shape[1])], times[k]


def _lowest_joints(lowest: Array, when: Array) -> tuple[Array, Array, Array]:
    """Return per quantity the joint whose margin was lowest, that margin, and when it was, (3,) each.

    Without joints no margin is finite, and no joint is meant.
    """
    if not lowest.size:
        none = np.full(len(JOINT_QUANTITIES), np.inf)
        return np.zeros(len(none), dtype=int), none, none
    lowest, when = (array.reshape(len(JOINT_QUANTITIES), -1) for array in (lowest, when))
    k = np.argmin(lowest, axis=1)
    rows = np.arange(len(k))
    return k, lowest[rows, k], when[rows, k]
