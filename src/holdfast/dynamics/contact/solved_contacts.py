"""What Coulomb's law leaves of a contact problem: forces, velocities, modes and a status."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array


class ContactMode(IntEnum):
    """What a contact does."""

    OPEN = 0
    STICKS = 1
    SLIPS = 2
    CLOSED = 3  # without friction, neither sticks nor slips


class ContactStatus(Enum):
    """The validity of contact forces and of the motion that follows."""

    OK = "the laws hold, and motion and contact forces are unique as far as could be decided"
    INDETERMINATE_FORCES = "the motion does not depend on how contacts share the load; the smallest forces are returned"
    AMBIGUOUS = "several motions satisfy the laws; one is returned, with a range that others reach"
    JAMMED = "no forces satisfy the laws: only an impulse would, without a collision"
    UNRESOLVED = "no forces were found that satisfy the laws to 1e-9"


@called
@dataclass(frozen=True, eq=False)
class ContactSolution(Frozen):
    """The solution of a contact problem; velocities with impulses, or accelerations with forces.

    Attributes:
        force: (k, 3) force or impulse of the world on the object, contact axes [t1, t2, n].
        wrench: (6,) their sum about C, world axes.
        change: (6,) P wrench, the change of the object's velocity or acceleration.
        velocity: (k, 3) u of the object relative to the world, contact axes.
        mode: (k,) numbers of `ContactMode`.
        status: whether all this satisfies the laws, and is unique.
        residual: violation of the laws, relative to the largest free velocity.
        range: (2, 6) with AMBIGUOUS, the least and largest change that was found to satisfy the laws: a lower bound of
            what is possible, component by component. Else None.
        proven: whether the motion is proven to be the only one.
    """

    force: Array
    wrench: Array
    change: Array
    velocity: Array
    mode: Array
    status: ContactStatus
    residual: float
    range: Array | None = None
    proven: bool = False
