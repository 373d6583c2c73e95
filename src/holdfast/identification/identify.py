"""Identification of the payload, and of grasp frames, from recorded motions; its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.contact_places import tip_frames
from holdfast.errors import ModelError, StateError
from holdfast.identification.base_parameters import parts_kept, sentences
from holdfast.identification.completed import completed, differentiated
from holdfast.identification.equations import Equations, PayloadUnknowns, Settings, equations, unknowns_of
from holdfast.identification.estimate import Estimate, estimate
from holdfast.identification.feasible_bodies import is_feasible
from holdfast.identification.motion_noise import motion_noise
from holdfast.identification.notes import notes_on_estimate, notes_on_grasps, notes_on_motion
from holdfast.identification.recording import Recording, recording_of
from holdfast.io.result_reader import Result
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial import rotation
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.inertia import about_origin, of_parameters
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State

MEASUREMENTS = ("wrist_wrench", "tau")
RecordingSource = Recording | Trajectory | Result | str | PathLike[str]


@called
@dataclass(frozen=True, eq=False)
class Identification(Frozen):
    """The estimated payload, the other estimated quantities, and their uncertainty.

    Attributes:
        chain: the chain with the estimates in place of the model's values.
        names: (p,) names of the unknowns: mass, com x .. z from C, inertia xx, xy, xz, yy, yz, zz about the mass
            centre, all in object axes; then sensor offsets and the tilt of gravity, if they were requested.
        values: (p,) their values [kg, m, kg m^2, ...].
        covariance: (p, p) covariance of the values; 0 along combinations that are not identified.
        deviations: standard deviations by name; infinite for values that are entirely or partly from the guess.
        kept: names of the values that are from the guess, because the motion does not identify them.
        partly: names of the values that are partly from the guess, because only combinations of them are identified.
        undetermined: combinations that the motion does not identify and that keep the guess's values, as text.
        notes: remarks on the estimate, as text.
        sensor_bias: (arms, 6) offset of each wrist sensor, tip axes [N m, N]; None if it was not requested.
        grasp_deviations: standard deviations (6,) of estimated grasp frames by arm, [turn; shift], object axes [rad,
            m].
        residuals: (samples, rows) residuals of the equations: [moment; force] about C along world axes, or with
            torques the power along an orthonormal basis of motions.
        noise: (channels,) standard deviations of the measurements, by which the rows are weighted [N m, N].
        misfit: mean square of the residuals in units of that noise and of the noise of the motion; far above 1 if no
            feasible body explains the recordings.
    """

    chain: ClosedChain
    names: tuple[str, ...]
    values: Array
    covariance: Array
    deviations: Mapping[str, float]
    kept: tuple[str, ...]
    partly: tuple[str, ...]
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]
    sensor_bias: Array | None
    grasp_deviations: Mapping[str, Array]
    residuals: Array
    noise: Array
    misfit: float

    @property
    def held_object(self) -> HeldObject:
        """The payload, which is a physically feasible body."""
        return self.chain.held_object

    @property
    def gravity(self) -> Array:
        """(3,) gravity, world axes [m/s^2]."""
        return self.chain.gravity

    def __repr__(self) -> str:
        """Return the number of values and the mass; `print` shows all of them."""
        return f"<Identification of {len(self.names)} values: {self.held_object.mass:.4g} kg>"

    def __str__(self) -> str:
        """Return a table of the values, followed by the misfit, undetermined combinations and notes."""
        width, said = max(map(len, self.names)), dict.fromkeys(self.kept, "from the guess")
        said |= dict.fromkeys(self.partly, "partly from the guess")
        lines = [
            f"{name:<{width}}  {value:>+12.5g}  {said.get(name, f'+- {self.deviations[name]:.2g}')}"
            for name, value in zip(self.names, self.values.tolist(), strict=True)
        ]
        misfit = f"misfit {self.misfit:.3g}: mean square of the residuals, in units of the noise"
        return "\n".join([*lines, misfit, *self.undetermined, *(f"note: {note}" for note in self.notes)])


@np.errstate(all="ignore")  # what overflows is refused
def identify(
    chain: ClosedChain,
    recordings: RecordingSource | list[RecordingSource] | tuple[RecordingSource, ...],
    *,
    by: Literal["wrist_wrench", "tau"] = "wrist_wrench",
    sensor_bias: bool = False,
    gravity: bool = False,
    grasp_frames: bool = False,
    noise: ArrayLike | None = None,
    largest_deviation: float = 0.3,
) -> Identification:
    """Estimate mass, mass centre and inertia of the payload by weighted least squares over feasible bodies.

    The sum of squared residuals is minimised, weighted by the inverse covariance of their noise, over all bodies that
    some distribution of mass has. Combinations of parameters that the motion does not identify keep the guess's values,
    those of the chain, and are listed in the result; if no feasible body has these, they become those of the nearest
    one that fits as well. Positions without rates or accelerations are smoothed, and their noise enters the weights and
    the covariance. O(samples n), with torques O(samples n^3).

    Args:
        chain: model of arms, grasps and object.
        recordings: a `Recording`, a simulated run, a result of `load_result`, or the path of a result folder, a .csv
            or a .parquet file; or a list of these.
        by: the measurements: "wrist_wrench", wrenches of wrist sensors, which give six equations per sample; or "tau",
            joint torques, which give as many equations per sample as the chain has degrees of freedom, without grasp
            forces.
        sensor_bias: whether to estimate a constant offset of each wrist sensor too.
        gravity: whether to estimate the direction of gravity too, for example if the base may be tilted.
        grasp_frames: whether to estimate the frames of rigid grasps first, from the poses of tips and object.
        noise: standard deviations of the measurements: (6,) or (arms, 6) for wrists [N m, N], (n,) or one number for
            torques [N m or N]. With None they are estimated, and the covariance remains valid for noise that is
            unequal; for noise that is correlated from sample to sample, deviations are increased, with a note.
        largest_deviation: a combination is estimated if its standard deviation, relative to its typical size, is below
            this; the sizes are the mass m, the radius of gyration r, and m r^2 of the estimate as far as the recordings
            determine them, or else of the guess.

    Returns:
        An `Identification`.

    Raises:
        ModelError: it is not a chain, the payload is flat or not a feasible body, or options contradict each other.
        StateError: a recording does not match the chain, lacks measurements, is too short, or identifies nothing; a
            mass below zero explains the recordings best.
        ResultError: a file cannot be read.

    Reference:
        Atkeson, An and Hollerbach 1986; Wensing, Kim and Slotine 2018; `docs/theory/derivatives.md`.
    """
    settings = _settings(chain, by, {"sensor_bias": sensor_bias, "gravity": gravity, "grasp_frames": grasp_frames})
    largest = checks.number(largest_deviation, "identify: largest_deviation", above=0.0)
    listed = isinstance(recordings, list | tuple)
    given = [recording_of(one, chain) for one in (recordings if listed else [recordings])]
    if not given:
        raise StateError("identify: recordings: expected at least one, got none")
    for one in given:
        _require(chain, one, by)
    frames: dict[str, Array] = {}
    if grasp_frames:
        chain, frames = measured_grasps(chain, given)
    moving = [differentiated(_fitting(chain, one)) for one in given]
    whole = [completed(chain, one) for one, _ in moving]
    system = equations(chain, whole, settings)
    wrists = np.tile([0, 0, 0, 1, 1, 1], len(chain.grasps))
    kinds = wrists if by == "wrist_wrench" else np.arange(chain.joint_count)
    unknowns = unknowns_of(chain, settings, _wrench_sizes(system, by))
    rows, p = system.rows[..., 0].size, len(unknowns.names)
    if rows < 2 * p:
        raise StateError(
            f"identify: expected {2 * p} rows or more for {p} unknowns, got {rows} of {len(system.rows)} samples"
        )
    motion = motion_noise(chain, moving, settings, system)
    found = estimate(system, unknowns, kinds, _given_noise(noise, chain, by), largest, motion)
    notes = [*notes_on_estimate(found, motion, system, noise is not None), *notes_on_grasps(chain, whole, frames)]
    notes += notes_on_motion(given)
    return _identification(chain, unknowns, found, settings, frames, tuple(notes))


def _settings(chain: Any, by: Any, flags: dict[str, Any]) -> Settings:
    """Return the measurements and the unknowns; refuse options that do not match the chain."""
    serial_chain(chain, "identify: chain")
    if by not in MEASUREMENTS:
        raise ModelError(f"identify: by: expected {' or '.join(map(repr, MEASUREMENTS))}, got {checks.short(by)}")
    for name, flag in flags.items():
        checks.instance(flag, bool, f"identify: {name}")
    if by == "tau" and flags["sensor_bias"]:
        raise ModelError(
            "identify: sensor_bias: expected by='wrist_wrench' with it, as torques do not show it; got 'tau'"
        )
    if not chain.grasps:
        raise ModelError("identify: chain: expected an arm that holds the object, got none")
    if flags["gravity"] and not chain.gravity.any():
        raise ModelError("identify: gravity: expected a chain with gravity, whose size is known; got none")
    if not is_feasible(about_origin(chain.held_object.mass, np.zeros(3), chain.held_object.inertia).parameters):
        raise ModelError(
            "identify: object: expected principal moments of which any two sum to more than the third; got a flat or an"
            " impossible body; try HeldObject.box with three edges as a first guess"
        )
    return Settings(by, flags["sensor_bias"], flags["gravity"])


def _fitting(chain: ClosedChain, one: Recording) -> Recording:
    """Return a recording with as many joints as the chain; refuse others."""
    if one.q.shape[1] != chain.joint_count:
        raise StateError(f"recording: q: expected {chain.joint_count} joints, got {one.q.shape[1]}")
    return one


def _require(chain: ClosedChain, one: Recording, by: str) -> None:
    """Refuse a recording without the measurements, or with another number of arms."""
    measured = getattr(one, by)
    if measured is None:
        other = next((name for name in MEASUREMENTS if getattr(one, name) is not None), None)
        hint = f"; it has {other}: try by='{other}'" if other else ""
        raise StateError(f"identify: recording: expected {by}, got none{hint}")
    if by == "wrist_wrench" and measured.shape[1] != len(chain.arms):
        raise StateError(f"recording: wrist_wrench: expected {len(chain.arms)} arms, got {measured.shape[1]}")


def measured_grasps(chain: ClosedChain, recordings: list[Recording]) -> tuple[ClosedChain, dict[str, Array]]:
    """Return the chain with the mean frames of its rigid grasps, from the poses of the tips, and their deviations.

    No force measurement is needed. If the object's pose was not recorded, it is computed from the first of these arms,
    which keeps its frame.

    Args:
        chain: the chain with the model's frames.
        recordings: recordings of which all or none have the object's pose.

    Returns:
        The chain, and by arm the standard deviations (6,) of the mean, [turn; shift], object axes [rad, m].

    Raises:
        StateError: only some recordings have the object's pose, or no frame can be identified.
    """
    rigid = [name for name, grasp in chain.grasps.items() if not grasp.free]
    posed = [recording.object_pose is not None for recording in recordings]
    if any(posed) != all(posed):
        raise StateError("identify: grasp_frames: expected object_pose in all recordings or in none, got it in some")
    sought = rigid if all(posed) else rigid[1:]
    if not sought:
        raise StateError(
            "identify: grasp_frames: expected two rigid grasps, or object_pose and one, as a tip's pose against the"
            " object says where it holds; got neither"
        )
    found = {name: [] for name in sought}
    for recording in recordings:
        for k, q in enumerate(_fitting(chain, recording).q):
            state = recording.on_base(k, State(q, 0.0 * q, np.r_[1.0, np.zeros(6)]))
            tips = tip_frames(chain, state, rigid)
            if recording.object_pose is None:
                seen = tips[rigid[0]] @ chain.grasps[rigid[0]].frame.inverse()
            else:
                seen = Pose.from_wxyz_xyz(recording.object_pose[k])
            for name in sought:
                found[name].append(seen.inverse() @ tips[name])
    grasps, deviations = dict(chain.grasps), {}
    for name, poses in found.items():
        mean = Pose(
            rotation.nearest(np.mean([pose.R for pose in poses], axis=0)), np.mean([pose.p for pose in poses], axis=0)
        )
        off = np.array([np.r_[rotation.log(pose.R @ mean.R.T), pose.p - mean.p] for pose in poses])
        deviations[name] = np.sqrt((off**2).sum(axis=0) / max(len(poses) - 1, 1) / len(poses))
        grasps[name] = replace(chain.grasps[name], frame=mean)
    return replace(chain, grasps=grasps), deviations


def _given_noise(noise: Any, chain: ClosedChain, by: str) -> Array | None:
    """Return the given standard deviations for each channel, (channels,), or None."""
    if noise is None:
        return None
    given = checks.numbers(noise, None, "identify: noise")
    l, n = len(chain.arms), chain.joint_count
    shapes = [(6,), (l, 6)] if by == "wrist_wrench" else [(), (n,)]
    if given.shape not in shapes:
        raise ModelError(f"identify: noise: expected shape {' or '.join(map(str, shapes))}, got {given.shape}")
    if (given <= 0.0).any():
        raise ModelError(f"identify: noise: expected standard deviations > 0, got {given.min():g}")
    if by == "tau":
        return np.broadcast_to(given, (n,))
    return np.broadcast_to(given, (l, 6))[[chain.names.index(name) for name in chain.grasps]].ravel()


def _wrench_sizes(system: Equations, by: str) -> Array:
    """Return (6,) root mean squares of moments and forces, at least 1e-3 of each other."""
    if by == "tau":
        return np.ones(6)
    halves = system.measured.reshape(-1, 2, 3)
    sizes = np.sqrt((halves**2).mean(axis=(0, 2)))
    return np.repeat(np.maximum(sizes, max(1e-3 * sizes.max(), 1e-9)), 3)


def _identification(
    chain: ClosedChain,
    unknowns: PayloadUnknowns,
    found: Estimate,
    settings: Settings,
    frames: dict[str, Array],
    notes: tuple[str, ...],
) -> Identification:
    """Return the result of an estimate, with a chain that has the estimated values."""
    values = np.array(found.plain)
    values[1:4] += chain.held_object.com
    payload = HeldObject(values[0], of_parameters(values[:10]).I, values[1:4])
    bias = None
    if settings.sensor_bias:
        bias = np.zeros((len(chain.arms), 6))
        bias[[chain.names.index(name) for name in chain.grasps]] = values[10 : 10 + unknowns.biases].reshape(-1, 6)
    g = unknowns.tilted_gravity(values[-2:])[0] if settings.gravity else chain.gravity
    model, partly = parts_kept(found.fixed)
    sizes = np.where(model | partly, np.inf, np.sqrt(np.maximum(np.diag(found.covariance), 0.0)))
    return Identification(
        chain=replace(chain, held_object=payload, gravity=g),
        names=unknowns.names,
        values=values,
        covariance=found.covariance,
        deviations=dict(zip(unknowns.names, sizes.tolist(), strict=True)),
        kept=tuple(name for name, one in zip(unknowns.names, model, strict=True) if one),
        partly=tuple(name for name, one in zip(unknowns.names, partly, strict=True) if one),
        undetermined=sentences(found.fixed, unknowns),
        notes=notes,
        sensor_bias=bias,
        grasp_deviations=frames,
        residuals=found.residuals,
        noise=found.noise,
        misfit=found.misfit,
    )
