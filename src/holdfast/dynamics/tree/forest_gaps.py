"""How far a state of a forest is from satisfying its closures and couplings."""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.grasp_gap import POSITION_TOLERANCE, VELOCITY_TOLERANCE, position_residual
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.errors import StateError
from holdfast.spatial.scalar import Array, Scalar, maximum


class ForestGaps(NamedTuple):
    """Gaps in position or velocity.

    Attributes:
        closures: per closure, those of its rows, of body b less body a [m, rad; m/s, rad/s].
        couplings: per coupling, sum c q - offset, or 0 without an offset; sum c qd.
    """

    closures: list[Array]
    couplings: list[Scalar]

    @property
    def size(self) -> float:
        """The root of the sum of their squares."""
        return float(np.linalg.norm(np.concatenate([*self.closures, self.couplings])))

    @property
    def largest(self) -> Scalar:
        """The largest of them; 0 without closures and couplings."""
        return reduce(maximum, map(abs, [x for gap in self.closures for x in gap] + self.couplings), 0.0)


def position_gaps(motion: ForestMotion, q: Array) -> ForestGaps:
    """Return the gaps of closures along their position rows, and of couplings with offsets."""
    forest, closures = motion.forest, []
    for closure, c in zip(forest.closures, motion.closures, strict=True):
        closures.append(position_residual(c.contact, motion.bodies[closure.b].at.frame.p + c.contact.origin, c.tip))
    couplings = []
    for coupling in forest.couplings:
        total = sum(c * q[forest.positions[k].start + component] for k, component, c in coupling.terms)
        couplings.append(0.0 if coupling.offset is None else total - coupling.offset)
    return ForestGaps(closures, couplings)


def velocity_gaps(motion: ForestMotion, qd: Array) -> ForestGaps:
    """Return the gaps of closures along their rows, and of couplings."""
    at = motion.forest.velocities
    coupled = [sum(c * qd[at[k].start + i] for k, i, c in coupling.terms) for coupling in motion.forest.couplings]
    return ForestGaps([c.contact.velocity_gap for c in motion.closures], coupled)


def require_closed(motion: ForestMotion, q: Array, qd: Array) -> None:
    """Refuse a state that does not satisfy the closures and the couplings.

    Raises:
        StateError: naming them.
    """
    limit = VELOCITY_TOLERANCE * max(1.0, float(np.linalg.norm(qd)))
    in_position, in_velocity = position_gaps(motion, q), velocity_gaps(motion, qd)
    gaps, closures, couplings = [], motion.forest.closures, motion.forest.couplings
    for i, (gap, speed) in enumerate(zip(in_position.closures, in_velocity.closures, strict=True)):
        x, v = (float(np.abs(part).max(initial=0.0)) for part in (gap, speed))
        if not (x <= POSITION_TOLERANCE and v <= limit):
            name = closures[i].name or f"closure {i}"
            gaps.append(f"{name}: position gap {x:.3g} (m, rad), velocity gap {v:.3g} (m/s, rad/s)")
    for i, (x, v) in enumerate(zip(in_position.couplings, in_velocity.couplings, strict=True)):
        if not (abs(x) <= POSITION_TOLERANCE and abs(v) <= limit):
            of_position = f"position gap {x:.3g}, " if x else ""
            gaps.append(f"{couplings[i].name or f'coupling {i}'}: {of_position}rate {abs(v):.3g}")
    if gaps:
        raise StateError(
            f"the state does not satisfy the forest: {'; '.join(gaps)}. Expected <= {POSITION_TOLERANCE:g} and <="
            f" {limit:.3g}; try the state that close returns, or forest_close for a forest"
        )
