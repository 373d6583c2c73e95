"""What a distribution of forces is asked: limits and costs; and its answer."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.errors import ModelError, StateError
from holdfast.forces.certificate import Certificate
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, Frozen, FrozenDict, OptionalArrayField, frozen
from holdfast.spatial.scalar import Array

PerGrasp = float | Mapping[Any, float] | None


@called
@dataclass(frozen=True, eq=False)
class ForceLimits(Frozen):
    """The limits of a distribution of forces, in addition to the grasps' own conditions (`grasp_margins`).

    A value per grasp is one number for all, or a mapping from names of arms. A mapping may also name contacts
    of the object with the world, "point/shape", and for normal forces a whole shape, the sum over its contacts.

    Attributes:
        effort: share of every joint's effort limit that may be used; None for no limit on torques.
        least_margin: margin that every grasp must keep [N].
        least_normal: smallest force along each contact's normal, into the object [N].
        most_normal: largest force along it [N].
        acceleration: by "arm/joint", lowest and highest joint acceleration [rad/s^2 or m/s^2].
        sample_time: period of the controller [s]. The accelerations of joints with position or rate limits are then
            such that the limits hold at the next sample and the joint can still stop in time.
        braking: deceleration at which the joints can stop then [rad/s^2 or m/s^2].
        last_wrench: (arms, 6) last wrenches of the arms on the object, world axes about the contacts [N m, N].
        wrench_change: largest change of each grasp's wrench from the last one, with moments divided by the distance of
            the contacts from their centroid [N].
    """

    effort: float | None = 1.0
    least_margin: PerGrasp = None
    least_normal: PerGrasp = None
    most_normal: PerGrasp = None
    acceleration: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sample_time: float | None = None
    braking: float = 10.0
    last_wrench: OptionalArrayField = NOT_GIVEN
    wrench_change: float = math.inf

    def __post_init__(self) -> None:
        put = object.__setattr__
        if self.effort is not None:
            put(self, "effort", checks.number(self.effort, "limits: effort", at_least=0.0))
        for name in ("least_margin", "least_normal", "most_normal"):
            put(self, name, _per_grasp(getattr(self, name), f"limits: {name}"))
        checks.instance(self.acceleration, Mapping, "limits: acceleration")
        put(self, "acceleration", frozen({key: _range(key, x) for key, x in self.acceleration.items()}))
        if self.sample_time is not None:
            put(self, "sample_time", checks.number(self.sample_time, "limits: sample_time", above=0.0))
        put(self, "braking", checks.number(self.braking, "limits: braking", above=0.0))
        put(self, "wrench_change", checks.limit(self.wrench_change, "limits: wrench_change"))
        if self.last_wrench is not None:
            put(self, "last_wrench", checks.numbers(self.last_wrench, None, "limits: last_wrench", StateError))
        if (self.last_wrench is None) != math.isinf(self.wrench_change):
            raise ModelError("limits: expected last_wrench and wrench_change together, got one of them")

    def of_grasps(self, name: str, chain: ClosedChain, contacts: Collection[str] = ()) -> dict[Any, float]:
        """Return a limit by key of the grasp or loop, for those that have it.

        One number is for all grasps, and for all loops with a contact. Names of contacts with the world are left out.

        Raises:
            ModelError: an arm holds nothing, or does not exist.
        """
        given = getattr(self, name)
        if given is None:
            return {}
        loops = {key: chain.as_forest.forest.closures[i].grasp for key, i in chain.as_forest.closures.items()}
        if not isinstance(given, Mapping):
            pressed = [key for key, grasp in loops.items() if key not in chain.grasps and grasp.contact is not None]
            return dict.fromkeys([*chain.grasps, *pressed], float(given))
        known = [*chain.grasps, *(key for key in loops if key not in chain.grasps)]
        for key in given:
            if key not in known and key not in contacts:
                raise ModelError(
                    f"limits: {name}: no grasp {key!r}.{checks.did_you_mean(str(key), [str(one) for one in known])}"
                )
        return {key: float(x) for key, x in given.items() if key in known}

    def of_contacts(self, name: str, contacts: Collection[str]) -> dict[str, float]:
        """Return a limit by name of a contact with the world, or of a shape, for those that have it."""
        given = getattr(self, name)
        return {key: x for key, x in given.items() if key in contacts} if isinstance(given, Mapping) else {}


@called
@dataclass(frozen=True, eq=False)
class ForceCost(Frozen):
    """The cost of a distribution of forces.

    1/2 sum w_j tau_j^2 + 1/2 wrench^2 sum |(lambda - wish) / F0|^2 + 1/2 acceleration^2 sum ((qdd_j - wished) / 10)^2
        + 1/2 task^2 |S alpha - s|^2

    with F0, the size of the force that the object needs, and moments divided by the distance of the contacts from their
    centroid. It is strictly convex, so that the torques are unique and change continuously with the state.

    Attributes:
        effort: (n,) w_j [1/(N m)^2 or 1/N^2]; by default the inverse squares of the effort limits, 1 without one.
        wrench: weight of the grasp wrenches, > 0.
        acceleration: weight of the joints' accelerations, in units of 10 rad/s^2 or m/s^2, > 0. With 1, one joint's
            1 rad/s^2 costs as much as a tenth of one drive's effort limit: redundant joints keep to what is wished.
            With little weight they accelerate to where torques are smaller, even if the object stands still.
        wish: (arms, 6) wished wrench of each arm on the object about its contact, contact axes [N m, N]; 0 by default.
            In a chain that is answered as a forest (grasps and loops, 6), as for last wrenches.
        joint_acceleration: (n,) wished accelerations of the joints, for what the object leaves free; 0 by default.
        task: weight of the object's distance from what is asked of it, S alpha = s, which then gives way to the limits,
            > 0 [s^2/rad or s^2/m]; None asks for it exactly. A mapping by name for accelerations by name: those without
            a weight are kept exactly.
        price: cost of passing the limits by F0 (`distribute`).
        barrier: slack times multiplier of every limit in the answer of `distribute`. With a positive one, such as 1e-5,
            torques change smoothly with the state also where a limit becomes active, and have derivatives; they cost
            more than the least by at most this for each condition. 0 for the least cost.
    """

    effort: OptionalArrayField = NOT_GIVEN
    wrench: float = 0.01
    acceleration: float = 1.0
    wish: OptionalArrayField = NOT_GIVEN
    joint_acceleration: OptionalArrayField = NOT_GIVEN
    task: float | Mapping[str, float] | None = None
    price: float = 1e4
    barrier: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("wrench", "acceleration", "price"):
            put(self, name, checks.number(getattr(self, name), f"cost: {name}", above=0.0))
        put(self, "barrier", checks.number(self.barrier, "cost: barrier", at_least=0.0))
        if isinstance(self.task, Mapping):
            weights = {name: checks.number(x, f"cost: task: '{name}'", above=0.0) for name, x in self.task.items()}
            put(self, "task", frozen(weights))
        elif self.task is not None:
            put(self, "task", checks.number(self.task, "cost: task", above=0.0))
        for name in ("effort", "wish", "joint_acceleration"):
            if (given := getattr(self, name)) is not None:
                put(self, name, checks.numbers(given, None, f"cost: {name}", StateError))

    def task_weight(self) -> float | None:
        """Return the weight of what is asked of the object; None if it is asked exactly.

        Raises:
            StateError: there are weights by name, which only chains that are answered as forests take.
        """
        if isinstance(self.task, Mapping):
            raise StateError("cost: task: expected one weight for serial arms that hold one object, got a mapping")
        return self.task

    def effort_weights(self, chain: ClosedChain) -> Array:
        """Return w_j, (n,).

        Raises:
            StateError: a shape is wrong, or a weight is negative.
        """
        if self.effort is None:
            limits = np.array([joint.effort_limit for joint in chain.freedoms])
            return np.where(np.isfinite(limits), limits, 1.0) ** -2.0
        weights = checks.numbers(self.effort, (chain.joint_count,), "cost: effort", StateError)
        if not (weights >= 0.0).all():
            raise StateError(f"cost: effort: expected weights >= 0, got {checks.short(weights)}")
        return weights


@called
@dataclass(frozen=True, eq=False)
class Distribution(Frozen):
    """Torques, wrenches and accelerations that fit together, with what the limits cost.

    Attributes:
        tau: (n,) torques of the drives [N m or N].
        qdd: (n,) accelerations of the joints [rad/s^2 or m/s^2].
        object_acceleration: (6,) [omega_dot; v_dot of C], the true acceleration, world axes, or (k, 6) of k objects.
        grasp_wrench: (arms, 6) wrench of each arm on the object about its contact, world axes [N m, N]; in a chain that
            is answered as a forest (grasps and loops, 6), as in `MechanismResult`.
        base_acceleration: (6,) acceleration of a floating base, world axes; None without one.
        violation: by how much the limits are passed [N], 0 if they are kept; torques by this times the distance of the
            contacts from their centroid, accelerations by 1 rad/s^2 or m/s^2 per newton.
        margin: least margin of the grasps, infinite without one [N].
        prices: by name of a limit, such as "left/joint3 effort" or "left friction", the decrease of the value when that
            limit is raised by one newton, newton metre, or unit of acceleration; 0 for limits that do not matter.
        status: "optimal", "infeasible" if no torques keep the limits, "unbounded" if no limit bounds the value, or
            "undecided" if rounding hides the answer.
        value: the cost; or what a report asks for: the largest margin [N], least peak, or largest share.
        why: the reason in words.
        certificate: the proof that no torques keep the limits; None unless the status is "infeasible".
        residual: largest relative residual of the optimality conditions; with a barrier also what that costs.
        unfelt: number of independent forces that no joint feels. The torques do not decide them: wrenches and margins
            are those of the smallest, and `margin_range` bounds the others. In a singular configuration there are more
            of them than nearby; `forward_dynamics` and `diagnose` tell.
        wrenches: the rows of `grasp_wrench` by the keys of the chain's grasps and loops.
        coupling_force: (couplings,) a coupling acts on each of its joints with c times this.
        touch_force: (k, 3) force of the world on the object at every candidate of `touching`, world axes [N]; this and
            what follows is None without `touching`.
        touch_mode: (k,) numbers of `ContactMode`, what contacts do under this acceleration.
        touch_margin: (k,) by how much the forces of contacts keep that [N]: mu f_n - |f_t| where one sticks, f_n where
            it slides; infinite where it is open.
        touch_status: of `forward_dynamics` with the torques; AMBIGUOUS also if it finds another motion that the laws of
            contact allow. None where forces of contacts do not keep their cones, or the configuration is singular.
        touches: the rows of `touch_force` by name, "point/shape".
    """

    tau: Array
    qdd: Array
    object_acceleration: Array
    grasp_wrench: Array
    base_acceleration: Array | None
    violation: float
    margin: float
    prices: Mapping[str, float]
    status: str
    value: float
    why: str
    certificate: Certificate | None
    residual: float
    unfelt: int = 0
    wrenches: Mapping[Any, Array] = field(default_factory=FrozenDict)
    coupling_force: Array = field(default_factory=lambda: np.zeros(0))
    touch_force: Array | None = None
    touch_mode: Array | None = None
    touch_margin: Array | None = None
    touch_status: ContactStatus | None = None
    touches: Mapping[str, Array] | None = None

    def __repr__(self) -> str:
        """Return the status, the margin and the reason."""
        return f"<Distribution: {self.status}, margin {self.margin:.4g} N; {self.why}>"


def _per_grasp(value: PerGrasp, what: str) -> PerGrasp:
    if isinstance(value, Mapping):
        return frozen({name: checks.number(x, f"{what}: '{name}'") for name, x in value.items()})
    return None if value is None else checks.number(value, what)


def _range(name: str, value: object) -> tuple[float, float]:
    low, high = checks.numbers(value, (2,), f"limits: acceleration of {checks.short(name)}").tolist()
    if not low <= high:
        raise ModelError(f"limits: acceleration of '{name}': expected lower <= upper, got {low:g} and {high:g}")
    return low, high
