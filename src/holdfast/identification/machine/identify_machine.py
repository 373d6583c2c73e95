"""Identification of a whole machine: what is asked, the fit, what it determines, and the chain with what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError, StateError
from holdfast.identification.base_parameters import sentences
from holdfast.identification.completed import completed, differentiated
from holdfast.identification.machine.fit import MachineFit, errors_at, machine_fit, with_prior
from holdfast.identification.machine.log_cholesky import body_at
from holdfast.identification.machine.prior import Prior
from holdfast.identification.machine.unknowns import GAINS, KINDS, MachineUnknowns, machine_unknowns
from holdfast.identification.motion_noise import motion_noise
from holdfast.identification.notes import SEEN, note_on_positions, notes_on_far, notes_on_grasps
from holdfast.identification.payload_unknowns import plain_body
from holdfast.identification.recording import Recording
from holdfast.identification.rows import ON_DRIVES, ON_JOINTS, RecordedRows, channels, forces_without_friction, rows_of
from holdfast.identification.suspicions import suspicions
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.model.serial_chain import serial_chain
from holdfast.spatial.inertia import of_parameters
from holdfast.spatial.scalar import Array

WIDE = 100.0  # factor of the prior's deviations without which a value must be told to count as determined
CHANCE_OF_ERROR = 1e-5  # that a value is beyond the interval in which it counts as determined
NOTHING_TOLD = 0.9  # standard deviation, relative to the prior's, above which the recordings tell nothing
AT_BOUND = 1e-9  # of the prior's deviation, below which a value is at its bound
SLOW = 1.2  # density of slow noise, in units of white noise, above which a note is added
STAND_IN = HeldObject.box(1.0, 0.1, 0.1, 0.1)  # for chains that hold nothing, whose equations it does not enter


@dataclass(frozen=True, eq=False)
class Machine:
    """What was found of a machine.

    Attributes:
        chain: the chain with the values that it has fields for.
        unknowns: the unknowns.
        rows: the equations.
        fit: the estimate.
        values: (p,) plain values.
        covariance: (p, p) of their errors.
        kept: (p,) which are the prior's.
        partly: (p,) which are partly the prior's.
        others: by kind, what the chain has no fields for.
        undetermined: sentences about what is not determined.
        notes: remarks.
        suspicions: those of them that name columns which are likely to be wrong.
    """

    chain: ClosedChain
    unknowns: MachineUnknowns
    rows: RecordedRows
    fit: MachineFit
    values: Array
    covariance: Array
    kept: Array
    partly: Array
    others: Mapping[str, Array]
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]
    suspicions: tuple[str, ...] = ()


@lru_cache(maxsize=8)  # so that machine code of a chain serves its next recording too
def without_object(chain: ClosedChain) -> ClosedChain:
    """Return a chain of serial arms that hold nothing with an object that stands in for none."""
    if chain.held_object is None and not chain.grasps and not chain.objects:
        return replace(chain, held_object=STAND_IN)
    return chain


def moving(chain: ClosedChain, recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings with rates and accelerations, and the object's motion if it is held."""
    return [_with_object(chain, differentiated(one)[0]) for one in recordings]


def _with_object(chain: ClosedChain, one: Recording) -> Recording:
    """Return a recording with rates and accelerations, with the object's motion if it is held."""
    return completed(chain, one) if chain.grasps else one


def identify_machine(
    chain: ClosedChain,
    recordings: Sequence[Recording],
    by: str,
    kinds: tuple[str, ...],
    prior: Prior,
    noise: Array | None,
    largest: float,
    huber: bool,
) -> Machine:
    """Return what recordings tell of a machine; see `identify`."""
    smoothed = [differentiated(one) for one in recordings]
    whole = [_with_object(chain, one) for one, _ in smoothed]
    y = np.concatenate([channels(chain, one, by) for one in whole])
    duration = max(float(one.t[-1] - one.t[0]) for one in whole)
    ones = np.ones(y.shape[1])
    unknowns = machine_unknowns(chain, by, kinds, prior, y, ones, duration)
    rows = rows_of(chain, whole, unknowns)
    if by == "current":
        gains = gains_of_model(rows, unknowns)
        unknowns = machine_unknowns(chain, by, kinds, prior, y, gains, duration)
    if rows.b.size < len(unknowns.names) // 2 or len(rows.b) < 8:
        raise StateError(
            f"identify: expected 8 samples or more, and {len(unknowns.names) // 2} rows for "
            f"{len(unknowns.names)} unknowns, got {len(rows.b)} samples and {rows.b.size} rows"
        )
    gain = unknowns.gain(unknowns.start, y.shape[1])

    def as_forces(given: Sequence[Recording]) -> list[Array]:
        return forces_without_friction(chain, given, unknowns, gain)

    motion = motion_noise(smoothed, rows.kept, as_forces, unknowns.friction_of_features())
    fit = machine_fit(rows, unknowns, channel_kinds(chain, by), noise, huber, motion=motion)
    found = machine_of(chain, unknowns, rows, fit, largest)
    notes = (*found.notes, *notes_on_far(fit.far, rows.t))
    if fit.motion_share > SEEN:
        notes = (*notes, note_on_positions(motion))

    def needs(given: Sequence[Recording]) -> RecordedRows:
        return rows_of(chain, given, unknowns)

    apart = notes_on_grasps(chain, whole, {}) if chain.grasps else []
    doubts = (*suspicions(chain, whole, unknowns, rows, needs), *apart)
    of_files = [note for one in recordings for note in one.notes]
    return replace(found, suspicions=doubts, notes=(*doubts, *of_files, *notes))


def channel_kinds(chain: ClosedChain, by: str) -> Array:
    """Return labels of the channels, (channels,), equal for those with the same noise."""
    if by in ON_DRIVES:
        return np.arange(chain.joint_count)
    return np.tile([0, 0, 0, 1, 1, 1] if by == "wrist_wrench" else [1, 1, 1], len(chain.grasps))


def gains_of_model(rows: RecordedRows, unknowns: MachineUnknowns) -> Array:
    """Return the ratios of the torques that the model needs, the smallest ones, to the currents, (channels,) > 0."""
    needed = (rows.A @ unknowns.x(unknowns.start)[0] + rows.b)[:, :, None]
    torques = (np.linalg.pinv(rows.P) @ needed)[:, :, 0]
    currents = np.sqrt((rows.y**2).mean(axis=0))
    if not (currents > 0.0).all():
        raise StateError("identify: recording: expected currents of all joints, got one that is always 0")
    return np.maximum(np.sqrt((torques**2).mean(axis=0)), 1e-9) / currents


def machine_of(
    chain: ClosedChain, unknowns: MachineUnknowns, rows: RecordedRows, fit: MachineFit, largest: float
) -> Machine:
    """Return the result of a fit: its plain values, and which of them the recordings determine."""
    values, slope = unknowns.plain(fit.z, fit.around)
    covariance = slope @ fit.covariance @ slope.T * fit.widened(0.05) ** 2
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    believed = np.sqrt(((slope * unknowns.spread) ** 2).sum(axis=1))
    sizes = believed.copy()
    if "payload" in unknowns.kinds:
        m, radius = values[0], float(np.sqrt((values[4] + values[7] + values[9]) / (2.0 * values[0])))
        sizes[:10] = np.minimum(sizes[:10], [m, *[radius] * 3, *[m * radius**2] * 6])
    kept = deviations > NOTHING_TOLD * fit.widened(0.05) * believed
    alone = with_prior(fit.information, WIDE * unknowns.spread)  # what the recordings tell
    told = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slope, alone, slope), 0.0))
    partly = ~kept & (np.maximum(deviations, told) * fit.widened(CHANCE_OF_ERROR) > largest * sizes)
    return Machine(
        chain=chain_with(chain, unknowns, fit.z),
        unknowns=unknowns,
        rows=rows,
        fit=fit,
        values=values,
        covariance=covariance,
        kept=kept,
        partly=partly,
        others=others_of(unknowns, fit.z),
        undetermined=in_words(unknowns, fit, covariance, sizes, kept | partly, largest),
        notes=remarks(unknowns, rows, fit),
    )


def in_words(
    unknowns: MachineUnknowns, fit: MachineFit, covariance: Array, sizes: Array, unsure: Array, largest: float
) -> tuple[str, ...]:
    """Return sentences about the combinations that the recordings do not determine."""
    links = np.array([kind == "links" for kind in unknowns.kind_of])
    apart, said = unsure & ~links, list[str]()
    if apart.any():
        own = sizes[apart]
        variances, axes = np.linalg.eigh(covariance[np.ix_(apart, apart)] / own[:, None] / own)
        fixed = axes[:, variances > largest**2]
        names = tuple(name for name, one in zip(unknowns.names, apart, strict=True) if one)
        said += sentences(fixed, names, own)
    if "links" in unknowns.kinds:
        of = links
        P = np.diag(unknowns.spread[of] ** -2.0)
        error = fit.covariance[np.ix_(of, of)]
        shares = np.linalg.eigvals(error @ P).real  # of the prior's variance that is left
        told = int((shares < largest**2).sum())
        said.append(
            f"{told} of the {int(of.sum())} combinations of the links' parameters are determined; the others stay at"
            " the model's values"
        )
    return tuple(said)


def remarks(unknowns: MachineUnknowns, rows: RecordedRows, fit: MachineFit) -> tuple[str, ...]:
    """Return remarks on an estimate."""
    notes = []
    bound = [
        name
        for name, z, low, spread in zip(unknowns.names, fit.z, unknowns.lowest, unknowns.spread, strict=True)
        if z - low < AT_BOUND * spread
    ]
    if bound:
        notes.append(f"would be below zero, and are 0: {', '.join(bound)}")
    slow = max((one.slow_noise for one in fit.processes), default=1.0)
    if slow > SLOW:
        notes.append(
            f"residuals depend on those before them; slow noise is up to {np.sqrt(slow):.2g} times that of white noise,"
            " which deviations include"
        )
    if fit.outliers > 0.0:
        notes.append(f"{100 * fit.outliers:.2g} % of the rows are far off and have less weight")
    if not fit.settled:
        notes.append("weights and estimate did not converge together; deviations are rough; try noise=")
    if unknowns.left_out:
        notes.append(f"links without mass stay as they are: {', '.join(unknowns.left_out)}")
    if rows.left_out:
        notes.append(f"{rows.left_out} samples at singular configurations were left out")
    if off := sorted(set(unknowns.kinds) & {"friction_offset", "friction_asymmetry"}):
        notes.append(f"the chain has no {' and '.join(off)}; `others` has them")
    return tuple(notes)


def others_of(unknowns: MachineUnknowns, z: Array) -> dict[str, Array]:
    """Return by kind what the chain has no fields for."""
    others = ("friction_offset", "friction_asymmetry", "sensor_offset", "sensor_drift", *GAINS, "time_offset")
    return {kind: z[unknowns.where(kind)] for kind in unknowns.kinds if kind in others}


def chain_with(chain: ClosedChain, unknowns: MachineUnknowns, z: Array) -> ClosedChain:
    """Return a chain with estimated bodies, armature, damping and friction."""
    if "payload" in unknowns.kinds:
        m, com, I = _mass_com_inertia(body_at(unknowns.roots[0], z[:10])[0])
        chain = replace(chain, held_object=HeldObject(m, I, com))
    first = int("payload" in unknowns.kinds)
    bodies = {
        k: body_at(unknowns.roots[first + i], z[10 * (first + i) : 10 * (first + i) + 10])[0]
        for i, k in enumerate(unknowns.links)
    }
    of_joints = {kind: z[unknowns.where(kind)] for kind in ON_JOINTS[:3] if kind in unknowns.kinds}
    count = 0

    def links_with(links: Sequence[Link]) -> list[Link]:
        nonlocal count
        found = []
        for link in links:
            if count in bodies:
                m, com, I = _mass_com_inertia(bodies[count])
                link = replace(link, mass=m, com=com, inertia=I)
            found.append(link)
            count += 1
        return found

    def joints_with(part: Any, where: slice) -> list[Any]:
        given = [{kind: float(x[where][k]) for kind, x in of_joints.items()} for k in range(len(part.joints))]
        return [replace(joint, **one) for joint, one in zip(part.joints, given, strict=True)]

    trunk = chain.trunk
    if trunk is not None:
        floating, links = trunk.split(links_with(trunk.bodies))
        trunk = replace(trunk, floating=floating, links=links, joints=joints_with(trunk, chain.joints["trunk"]))
    arms = {
        name: replace(arm, links=links_with(arm.links), joints=joints_with(arm, chain.joints[name]))
        for name, arm in chain.arms.items()
    }
    return replace(chain, arms=arms, trunk=trunk)


def _mass_com_inertia(pi: Array) -> tuple[float, Array, Array]:
    """Return mass, mass centre and the inertia about it."""
    plain = plain_body(pi)
    return float(plain[0]), plain[1:4], of_parameters(plain).I


def measurement_errors(
    chain: ClosedChain,
    recording: Recording,
    by: Literal["tau", "current", "wrist_wrench", "wrist_force"],
    others: Mapping[str, ArrayLike] = MappingProxyType({}),
) -> Array:
    """Return the smallest errors of the measurements with which a chain explains a recording, (samples, channels).

    For arms that hold nothing, and for a single arm, these are measured minus predicted torques, or currents. Where
    arms hold one object together, only errors that grasp forces cannot explain are seen. O(samples n^3).

    Args:
        chain: the chain, as `identify` found it.
        recording: a recording, for example one that `identify` did not use.
        by: what is measured.
        others: what `identify` found beside the chain, its `others`.

    Raises:
        ModelError: others are of another measurement, or lack the gains of currents.
        StateError: the recording does not have the measurement.
    """
    return explained(chain, recording, by, others)[0]


def explained(
    chain: ClosedChain, recording: Recording, by: str, others: Mapping[str, ArrayLike]
) -> tuple[Array, RecordedRows]:
    """Return what `measurement_errors` returns, and the equations, which have the samples that are not left out."""
    checks.instance(chain, ClosedChain, "measurement_errors: chain")
    chain = without_object(chain)
    serial_chain(chain, "measurement_errors: chain")
    if not isinstance(by, str) or by not in KINDS:
        raise ModelError(f"measurement_errors: by: expected {' or '.join(map(repr, KINDS))}, got {by!r}")
    if by == "current" and "drive_gain" not in others:
        raise ModelError("measurement_errors: others: expected 'drive_gain' for currents, got none")
    if getattr(recording, by) is None:
        raise StateError(f"measurement_errors: recording: expected {by}, got none")
    given = {name: np.asarray(value, dtype=float) for name, value in others.items()}
    whole = moving(chain, [recording])
    y = channels(chain, whole[0], by)
    gains = given.get("drive_gain", np.ones(y.shape[1]))
    duration = float(recording.t[-1] - recording.t[0])
    kinds = tuple(given) or (KINDS[by][3],)
    unknowns = machine_unknowns(chain, by, kinds, Prior(), y, gains, duration)
    z = unknowns.start.copy()
    for kind, value in given.items():
        z[unknowns.where(kind)] = value
    rows = rows_of(chain, whole, unknowns)
    return errors_at(rows, unknowns, z, np.ones(y.shape[1])), rows
