"""The report on an assembly: reach, joint limits, closure, mobility, and what was not checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.assembly.limits import longest_reach, required_reach
from holdfast.assembly.on_trunk import on_own_bases
from holdfast.assembly.plausibility import plausibility_notes
from holdfast.dynamics.consistency import closure
from holdfast.dynamics.rank import constraint_rank
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.joint import Joint
from holdfast.model.serial_chain import serial_chain
from holdfast.model.tip_direction import advice_for, tip_angle
from holdfast.model.trunk import TRUNK
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import State

AT_LIMIT = 1e-9  # rad or m


@dataclass(frozen=True)
class ArmReport(Frozen):
    """The report on one arm.

    Attributes:
        name: name of the arm.
        holds: whether it has a grasp.
        reach: distance from its first joint to its contact [m]; NaN without a grasp.
        longest: longest possible reach [m].
        joint: the joint nearest to a limit; "" if no joint has limits.
        margin: distance of that joint from its limit [rad or m]; infinite if no joint has limits.
        unit: unit of the margin, "rad" or "m"; "" if no joint has limits.
        residual: largest position gap at its grasp [m or rad].
        tip_angle: angle between the tip's z axis and the direction out of the hand [rad]; NaN if unknown.
        tip_note: advice if that z axis does not point out of the hand; otherwise "".
        jointed: whether it has joints; an anchor has none, and no reach.
        notes: notes on its file: what was not read, or was read differently.
    """

    name: str
    holds: bool
    reach: float
    longest: float
    joint: str
    margin: float
    unit: str
    residual: float
    tip_angle: float
    tip_note: str
    jointed: bool = True
    notes: tuple[str, ...] = ()

    @property
    def reach_used(self) -> float:
        """Reach relative to the longest reach, 0 to 1; 1 for an anchor."""
        return self.reach / self.longest if self.jointed else 1.0

    def __str__(self) -> str:
        closed, held = f"closed to {self.residual:.1e}", "holds nothing"
        if not self.jointed:
            return f"{self.name}: an anchor, {closed if self.holds else held}"
        if self.holds:
            held = f"reach {self.reach:.3f} m, {100 * self.reach_used:.0f} % of the longest"
        end = closed if self.holds else "in its preferred configuration"
        return f"{self.name}: {held}, {_at_limit(self.joint, self.margin, self.unit)}, {end}"


@dataclass(frozen=True)
class TrunkReport(Frozen):
    """The report on a trunk.

    Attributes:
        joint: the joint nearest to a limit; "" if no joint has limits.
        margin: distance of that joint from its limit [rad or m]; infinite if no joint has limits.
        unit: unit of the margin, "rad" or "m".
        floats: whether its base is free.
        notes: notes on its file, as for an arm.
    """

    joint: str
    margin: float
    unit: str
    floats: bool
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        base = "a floating base" if self.floats else "a base in the world"
        return f"trunk: {base}, {_at_limit(self.joint, self.margin, self.unit)}"


@called
@dataclass(frozen=True)
class AssemblyReport(Frozen):
    """The report on a closed chain.

    Attributes:
        arms: the reports on all arms.
        mobility: dimension of the space of velocities that the grasps allow, n + 6 - rank of K [J, -A]; a floating base
            adds six.
        rank: number of independent rows of the grasp constraint.
        rows: number of all its rows, six per grasp.
        trunk: the report on the trunk; None without one.
        unlikely: notes on numbers that are possible but unlikely, with their likely cause.
        not_checked: what was not checked.
    """

    arms: tuple[ArmReport, ...]
    mobility: int
    rank: int
    rows: int
    trunk: TrunkReport | None = None
    unlikely: tuple[str, ...] = ()
    not_checked: tuple[str, ...] = (
        "collisions between arms, object and surroundings",
        "whether the actuators can bear the load",
        "friction at one-sided contacts",
    )

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes on the files of trunk and arms, each once."""
        parts = [*([] if self.trunk is None else [self.trunk]), *self.arms]
        return tuple(dict.fromkeys(note for part in parts for note in part.notes))

    def __repr__(self) -> str:
        """Return mobility and rank; `print` shows the arms, too."""
        return f"<AssemblyReport: {len(self.arms)} arms, mobility {self.mobility}, rank {self.rank} of {self.rows}>"

    def __str__(self) -> str:
        lines = [*([] if self.trunk is None else [str(self.trunk)]), *map(str, self.arms)]
        lines += [f"  note: {arm.name}: {arm.tip_note}" for arm in self.arms if arm.tip_note]
        lines += [f"  note: {note}" for note in self.unlikely]
        lines += [f"  note: {note}" for note in self.notes]
        lines.append(f"mobility {self.mobility}, rank {self.rank} of {self.rows}")
        if self.rank < self.rows:
            lines.append("  rows are dependent: singular, or grasp forces not unique; holdfast.diagnose tells which")
        lines.append(f"not checked: {'; '.join(self.not_checked)}")
        return "\n".join(lines)


@np.errstate(all="ignore")  # a reach beyond all numbers is infinite
def assembly_report(chain: ClosedChain, state: State) -> AssemblyReport:
    """Return the report on a closed chain: reach, nearest joint limits, closure and mobility.

    Args:
        chain: the chain.
        state: a closed state; if it is not closed, `residual` shows it.

    Raises:
        StateError: the state belongs to another chain.
    """
    serial_chain(chain, "chain")
    gaps = {name: float(np.abs(gap.position).max(initial=0.0)) for name, gap in closure(chain, state).items()}
    rank, (alone, there) = constraint_rank(chain, state), on_own_bases(chain, state)
    return AssemblyReport(
        tuple(_arm_report(alone, there, name, gaps.get(name)) for name in chain.arms),
        chain.velocity_count + chain.contact_freedom_count - rank,
        rank,
        chain.constraint_row_count,
        _trunk_report(chain, state),
        plausibility_notes(chain, state.object_frames),
    )


def _trunk_report(chain: ClosedChain, state: State) -> TrunkReport | None:
    if chain.trunk is None:
        return None
    joint, margin, unit = _nearest_limit(chain.trunk.joints, state.q[chain.joints[TRUNK]])
    return TrunkReport(joint, margin, unit or "rad", chain.floats, tuple(chain.trunk.notes))


def _arm_report(chain: ClosedChain, state: State, name: str, gap: float | None) -> ArmReport:
    arm = chain.arms[name]
    joint, margin, unit = _nearest_limit(arm.joints, state.q[chain.joints[name]])
    return ArmReport(
        name=name,
        holds=gap is not None,
        reach=np.nan if gap is None else required_reach(chain, name, state.object_frame),
        longest=longest_reach(arm),
        joint=joint,
        margin=margin,
        unit=unit,
        residual=np.nan if gap is None else gap,
        tip_angle=tip_angle(arm),
        tip_note=advice_for(arm, chain.grasps[name]) if name in chain.grasps else "",
        jointed=bool(arm.joints),
        notes=tuple(arm.notes),
    )


def _nearest_limit(joints: Sequence[Joint], q: Array) -> tuple[str, float, str]:
    """Return the joint nearest to a limit, its distance from that and its unit; "", infinite and "" without limits."""
    margins = [min(x - j.position_limits[0], j.position_limits[1] - x) for x, j in zip(q, joints, strict=True)]
    nearest = int(np.argmin(margins)) if margins else 0
    if not margins or not np.isfinite(margins[nearest]):
        return "", np.inf, ""
    joint = joints[nearest]
    return joint.name or f"joint {nearest + 1}", float(margins[nearest]), "rad" if joint.turns else "m"


def _at_limit(joint: str, margin: float, unit: str) -> str:
    """Describe how far the joint that is nearest to a limit is from it; the arguments are attributes of the reports."""
    if not joint:
        return "no joint limits"
    return f"{joint} " + ("is at its limit" if margin <= AT_LIMIT else f"nearest to a limit ({margin:.3g} {unit})")
