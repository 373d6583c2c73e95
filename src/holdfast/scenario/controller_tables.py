"""The controllers of a scene: their tables and keys, and those of the parts, limits and costs that laws consist of."""

from __future__ import annotations

from typing import Literal

from holdfast.scenario.table import ZEROS, KeyTable, NumberRows, PoseTable, Triple

ByArm = float | dict[str, float] | None


class _Limits(KeyTable):
    """The limits of forces and accelerations, those of `ForceLimits`."""

    effort: float = 1.0
    least_margin: ByArm = None
    least_normal: ByArm = None
    most_normal: ByArm = None
    acceleration: dict[str, tuple[float, float]] = {}


class LimitsTable(_Limits):
    """The limits that a law keeps; with `joint_limits`, those of positions and rates, too, from sample to sample."""

    joint_limits: bool = False
    braking: float = 10.0


class FastestTable(_Limits):
    """The limits within which a path is timed to be the fastest, see `time_path`."""

    nodes: int = 41


class CostTable(KeyTable):
    """The cost of torques within limits, that of `ForceCost`; the wishes are those of the law's other parts."""

    effort: list[float] | None = None
    wrench: float = 0.01
    acceleration: float = 1.0
    price: float = 1e4


class ViaTable(PoseTable, kw_only=True):
    """A world pose through which the object passes at time `t`."""

    t: float


class PathTable(KeyTable):
    """A smooth rest-to-rest motion of the object: a displacement and a rotation, or `through` poses; world axes.

    With `fastest`, it is timed anew: `duration` and the times of poses then only say which way it takes.
    """

    duration: float | None = None
    displacement: Triple = ZEROS
    turn: Triple = ZEROS
    through: list[ViaTable] | None = None
    begin: float = 0.0
    fastest: FastestTable | None = None


class GravityCompensationTable(KeyTable, tag_field="type", tag="gravity_compensation"):
    """Balance gravity."""

    internal_force: float = 0.0
    joint_damping: float = 0.0


class ObjectTrackingTable(KeyTable, tag_field="type", tag="object_tracking"):
    """Move the object along a path by computed torque."""

    path: PathTable
    internal_force: float = 0.0
    stiffness: float = 100.0
    damping: float = 20.0
    joint_damping: float = 10.0


class ObjectImpedanceTable(KeyTable, tag_field="type", tag="object_impedance"):
    """A mass, a spring and a damper between the object and its path."""

    path: PathTable
    stiffness: NumberRows
    damping: NumberRows
    inertia: NumberRows | None = None
    push: NumberRows | None = None


class InternalForceTable(KeyTable, tag_field="type", tag="internal_force"):
    """A push of every arm, or one for each, or wrenches along contact axes."""

    force: NumberRows = 0.0


class LoadShareTable(KeyTable, tag_field="type", tag="load_share"):
    """Shares of the load by arm, by default according to the reserve of the drives."""

    shares: dict[str, float] | None = None
    force: float = 0.0


class RampedForcesTable(KeyTable, tag_field="type", tag="ramped_forces"):
    """Forces that pass from one wish to another."""

    before: Wish
    after: Wish
    begin: float = 0.0
    duration: float = 1.0


class InternalImpedanceTable(KeyTable, tag_field="type", tag="internal_impedance"):
    """Springs and dampers between the tips and where the model has them."""

    stiffness: NumberRows
    damping: NumberRows
    around: Wish | None = None


class HybridForceTable(KeyTable, tag_field="type", tag="hybrid_force"):
    """The integral of the internal force's error; it is measured on the scene's own chain at the samples."""

    gain: float
    around: Wish | None = None
    limit: float | None = None
    late: bool = False


Wish = InternalForceTable | LoadShareTable | RampedForcesTable | InternalImpedanceTable | HybridForceTable


class PostureTable(KeyTable):
    """A posture for what the object leaves free, see `PostureControl`.

    "start" is the initial one, "path" that of the joints along a path that is timed by `fastest`.
    """

    rest: list[float] | Literal["start", "path"] | None = None
    frequency: float = 5.0
    clearance: float = 0.0


class ObserverTable(KeyTable):
    """An observer of the push on the object, see `observed`."""

    gain: float
    threshold: float = 10.0
    release: float = 0.5


class CooperativeLawTable(KeyTable, tag_field="type", tag="cooperative_law"):
    """A law of an object motion, grasp forces and a null motion; with `limits`, within these."""

    motion: ObjectImpedanceTable
    forces: Wish | None = None
    posture: PostureTable | None = None
    limits: LimitsTable | None = None
    cost: CostTable | None = None
    observer: ObserverTable | None = None


class PieceTable(KeyTable):
    """Torques from `begin` to the next piece: polynomials c0 + c1 (t - begin) + ..., [c0, c1, ...] for each joint."""

    begin: float
    torques: list[list[float]]


class TorqueScheduleTable(KeyTable, tag_field="type", tag="torque_schedule"):
    """Torques as given functions of time; they are added to those of the controller `beside`, if there is one."""

    pieces: list[PieceTable]
    beside: GravityCompensationTable | ObjectTrackingTable | None = None


ControllerTable = GravityCompensationTable | ObjectTrackingTable | CooperativeLawTable | TorqueScheduleTable
