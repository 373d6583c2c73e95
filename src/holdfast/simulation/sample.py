"""Samples of a run: everything that is recorded at an instant, for one instant or many at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.sliding_hands import wrenches_of_hands
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactStatus
from holdfast.dynamics.result import Status
from holdfast.forces.force_split import split
from holdfast.forces.margin_interval import margin_range
from holdfast.forces.margins import conditions
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import ARRAYS, FLOATING, STATE, state_of
from holdfast.simulation.accounts import account_shapes
from holdfast.simulation.balance import Sums
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.environment import Environment
from holdfast.simulation.events import Occurrence
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import JOINT_QUANTITIES, by_arm
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import Accounting
from holdfast.simulation.trajectory import TOUCH_FIELDS, Trajectory
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

# Arrays of an instant, which have the same names in a result of forward dynamics and in machine code, and those of a
# trunk or a floating base.
OF_RESULT = ("qdd", "object_acceleration", "grasp_wrench", "base_wrench")
DEPENDENT_WRENCHES = 1e-9  # of the largest: contacts whose wrenches depend on each other to this share a load
HAND_WRENCH = "hand_wrench"  # of hands that slide, which have no grasps, among the arrays of an instant
SPLIT_NAMES = {"internal_wrench", "load_share"}
OF_TRUNK = {"floating_acceleration": "base_acceleration", "trunk_base_wrench": "trunk_base_wrench"}


class Samples(NamedTuple):
    """Successive samples; the first axis of every array is the sample.

    Attributes:
        t: (k,) times [s].
        arrays: state, torques ("drive"), accelerations and forces, by the names of machine code.
        margins: current margins of the grasps, and the best and worst that internal forces allow, (k, arms) each.
        gaps: (k, 4) position gap and velocity gap before projection, then both after it.
        work: (k, 4) work since the run's start [J].
        lowest: (k, signals) lowest margins since the previous sample, see `margins.Signals`.
        lowest_time: (k, signals) the times of these [s].
    """

    t: Array
    arrays: Mapping[str, Array]
    margins: tuple[Array, Array, Array]
    gaps: Array
    work: Array
    lowest: Array
    lowest_time: Array

    @classmethod
    def of_one(
        cls,
        t: float,
        arrays: Mapping[str, Array],
        allowed: tuple[Array, Array, Array],
        gaps: Gaps,
        work: Array,
        times: Array,
        margins: Array,
    ) -> Samples:
        """Return one sample.

        Args:
            t: its time [s].
            arrays: its `arrays`.
            allowed: its `margins`.
            gaps: position and velocity gaps before and after projection.
            work: (4,) since the run's start [J].
            times: (k,) times since the previous sample at which the margins of signals were evaluated.
            margins: (k, signals) margins at these times.
        """
        before, after = zip(gaps.position, gaps.velocity, strict=True)
        rest = np.array([[*before, *after]]), work[None], *lowest_of(times[None], margins[None])
        return cls(np.array([t]), arrays, allowed, *rest)


def arrays_of(at: Instant) -> dict[str, Array]:
    """Return the arrays of an instant by the names of machine code, with a sample axis of length 1."""
    state, found = at.state, at.result
    arrays = {name: getattr(state, ARRAYS[name].field) for name in (*STATE, *FLOATING)}
    arrays |= {name: getattr(found, name) for name in OF_RESULT}
    arrays |= {name: getattr(found, field) for name, field in OF_TRUNK.items()}
    arrays |= {"drive": at.tau, "condition": np.array(found.condition)}
    if at.touch is not None:
        rows, force = at.touch.rows, at.touch.force
        modes, wrench = at.touch.modes, rows.wrench(force)
        if at.chain.touching is not None:
            k = len(at.chain.touching.names)  # hands that slide follow
            arrays |= {"touch_force": rows.in_world(force)[:k], "touch_gap": rows.gap[:k], "touch_mode": modes.mode[:k]}
            arrays |= kept_modes(rows, force[:k], modes.mode[:k])
        arrays |= {TOUCH_WRENCH: wrench, HAND_WRENCH: wrenches_of_hands(at.chain, modes.hands, wrench)}
    return {name: x[None] for name, x in arrays.items() if x is not None}


def kept_modes(rows: ContactRows, force: Array, mode: Array) -> dict[str, Array]:
    """Return by how much forces of contacts (k, 3) in contact axes keep their modes, and whether they are unique.

    They are if the forces along which pressing contacts may act are independent as wrenches on the object.
    """
    normal, along = force[:, 2], np.linalg.norm(force[:, :2], axis=1)
    sticks, pressing = mode == ContactMode.STICKS, (mode != ContactMode.OPEN) & (force[:, 2] > 0.0)
    margin = np.where(sticks, rows.friction[: len(mode)] * normal - along, normal)
    acting = [np.zeros((0, rows.C.shape[2]))]
    for j in np.flatnonzero(pressing).tolist():
        directions = np.eye(3) if sticks[j] else (force[j, :3] / np.linalg.norm(force[j, :3]))[None]
        acting.append(directions @ rows.C[j, :3])
    D = np.concatenate(acting)
    unique = not len(D) or int(np.linalg.matrix_rank(D, rtol=DEPENDENT_WRENCHES)) == len(D)
    status = ContactStatus.OK if unique else ContactStatus.INDETERMINATE_FORCES
    return {
        "touch_margin": np.where(mode == ContactMode.OPEN, np.inf, margin),
        "touch_status": np.array([*ContactStatus].index(status)),
    }


def with_kept_modes(chain: ClosedChain, arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Return samples of steps with impulses of contacts, with what `kept_modes` says of each."""
    touching, found = chain.touching, []
    assert touching is not None
    for k, pose in enumerate(arrays["object_pose"]):
        rows = contact_rows(touching, Pose.from_wxyz_xyz(pose), arrays["object_twist"][k])
        force = np.einsum("kia,ka->ki", rows.axes, arrays["touch_force"][k])
        found.append(kept_modes(rows, force, arrays["touch_mode"][k]))
    return {**arrays, **{name: np.stack([one[name] for one in found]) for name in found[0]}}


def sample(
    environment: Environment,
    accounting: Accounting,
    at: Instant,
    gaps: Gaps,
    sums: Sums,
    times: Array,
    margins: Array,
    names: Collection[str],
    occurrences: tuple[Occurrence, ...] = (),
) -> Trajectory:
    """Return a run of one sample.

    Args:
        environment: the chain with its grasps, its base motions and external inputs.
        accounting: returns what is recorded besides the motion.
        at: the instant.
        gaps: position and velocity gaps before and after projection.
        sums: work and impulses since the run's start.
        times: (k,) times since the previous sample at which the margins were evaluated; the last is that of `at`.
        margins: (k, signals) margins at these times, see `margins.Signals`.
        names: the arrays to record.
        occurrences: what has happened since the previous sample.
    """
    now, best, worst = _allowed_margins(at)
    allowed = now[None], best[None], worst[None]
    one = Samples.of_one(at.t, arrays_of(at), allowed, gaps, sums.work, times, margins)
    return recorded(environment, accounting, one, sums, names, occurrences)


def recorded(
    environment: Environment,
    accounting: Accounting,
    samples: Samples,
    sums: Sums,
    names: Collection[str],
    occurrences: tuple[Occurrence, ...] = (),
) -> Trajectory:
    """Return a run of the given samples, completed by what is recorded besides the motion.

    Args:
        environment: the chain with its grasps, its base motions and external inputs.
        accounting: returns what is recorded besides the motion.
        samples: the samples, between which nothing has happened.
        sums: impulses since the run's start.
        names: the arrays to record.
        occurrences: what has happened since the previous sample.
    """
    chain, x, k, l = environment.chain, samples.arrays, len(samples.t), len(environment.chain.arms)
    found = {} if account_shapes(chain, True).keys().isdisjoint(names) else accounting(samples.t, x)
    if "internal_wrench" not in found and not SPLIT_NAMES.isdisjoint(names):
        found = {**found, **_split(environment, samples)}
    of_joints = slice(l, l + 3 * chain.joint_count)
    joint, joint_lowest, joint_when = lowest_joints(samples.lowest[:, of_joints], samples.lowest_time[:, of_joints])
    now, best, worst = samples.margins
    none = np.zeros((k, 0))
    arrays: dict[str, Any] = {name: x[name] for name in OF_RESULT} | found
    if HAND_WRENCH in x:
        arrays["grasp_wrench"] = x["grasp_wrench"] + x[HAND_WRENCH]
    arrays |= {field: x.get(name, none) for name, field in OF_TRUNK.items()}
    arrays |= {
        "t": samples.t,
        "q": x["q"],
        "qd": x["qd"],
        "tau": x["drive"],
        "object_pose": x["object_pose"],
        "object_twist": x["object_twist"],
        "holding": np.tile(np.array([name in chain.grasps for name in chain.names], dtype=bool), (k, 1)),
        "margin": now,
        "best_margin": best,
        "worst_margin": worst,
        "lowest_margin": samples.lowest[:, :l],
        "lowest_margin_time": samples.lowest_time[:, :l],
        "lowest_joint_margin": joint_lowest,
        "lowest_joint_margin_time": joint_when,
        "lowest_joint": joint,
        "position_gap": samples.gaps[:, ::2],
        "velocity_gap": samples.gaps[:, 1::2],
        "work": samples.work,
        "impact": np.full(k, sums.impact),
        "base_impulse": np.tile(sums.base_impulse, (k, 1)),
        "condition": x["condition"],
        "base_pose": x.get("floating_pose", none),
        "base_twist": x.get("floating_twist", none),
        "coupling_force": none,
        **{name: x.get(name, none) for name in TOUCH_FIELDS},
    }
    return Trajectory(**{name: arrays[name] for name in names}, occurrences=occurrences)


def lowest_of(times: Array, margins: Array) -> tuple[Array, Array]:
    """Return the lowest margin of every signal and its time, (..., signals), of margins (..., k, signals)."""
    lowest = margins.min(axis=-2)
    when = np.broadcast_to(times[..., -1:], lowest.shape).copy()
    for k in reversed(range(margins.shape[-2] - 1)):  # argmin searches along any axis but the last item by item
        np.copyto(when, times[..., k : k + 1], where=margins[..., k, :] == lowest)
    return lowest, when


def lowest_joints(lowest: Array, when: Array) -> tuple[Array, Array, Array]:
    """Return for each sample and quantity the joint with the lowest margin, that margin, and its time, (k, 3) each.

    Without joints the margins are infinite and the joint numbers have no meaning.
    """
    shape = (len(lowest), len(JOINT_QUANTITIES))
    if not lowest.size:
        none = np.full(shape, np.inf)
        return np.zeros(shape, dtype=int), none, none
    lowest, when = (array.reshape(*shape, -1) for array in (lowest, when))
    k = np.argmin(lowest, axis=-1)
    least, then = (np.take_along_axis(array, k[..., None], axis=-1)[..., 0] for array in (lowest, when))
    return k, least, then


def _allowed_margins(at: Instant) -> tuple[Array, Array, Array]:
    """Return the current margins, and the best and worst that internal forces allow, each by arm (arms,)."""
    chain, found = at.chain, at.result
    if not any(conditions(grasp) for grasp in chain.grasps.values()):
        none = np.full(len(chain.arms), np.inf)
        return none, none, none
    if found.status is not Status.INDETERMINATE_FORCES:
        now = by_arm(chain, at.grasp_margins)
        return now, now, now
    allowed = margin_range(chain, at.state, found)
    now, best, worst = (by_arm(chain, m) for m in (at.grasp_margins, allowed.best, allowed.worst))
    return now, best, worst


def _split(environment: Environment, samples: Samples) -> dict[str, Array]:
    """Return internal wrenches and load shares, sample by sample, for grasps whose axes or points follow the tips."""
    x, internal, share = samples.arrays, [], []
    for k, t in enumerate(samples.t.tolist()):
        parts = split(environment.chain_at(t), state_of(x, k), x["grasp_wrench"][k])
        internal.append(parts.internal)
        share.append(np.zeros(len(internal[-1])) if parts.load_share is None else parts.load_share)
    return {"internal_wrench": np.array(internal), "load_share": np.array(share)}
