"""Identification of the payload, of grasp frames and of the whole machine, from recorded motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError, StateError
from holdfast.identification.base_parameters import parts_kept, sentences
from holdfast.identification.completed import completed, differentiated
from holdfast.identification.equations import Equations, equations
from holdfast.identification.estimate import Estimate, estimate
from holdfast.identification.feasible_bodies import is_feasible
from holdfast.identification.grasp_frames import fitting, measured_grasps
from holdfast.identification.identification import Identification
from holdfast.identification.load_recording import recording_of
from holdfast.identification.machine.identify_machine import Machine, identify_machine, without_object
from holdfast.identification.machine.prior import Prior
from holdfast.identification.machine.unknowns import KINDS, required_kinds
from holdfast.identification.motion_noise import payload_noise
from holdfast.identification.notes import notes_on_estimate, notes_on_far, notes_on_grasps, notes_on_motion
from holdfast.identification.payload_unknowns import PayloadUnknowns, Settings, unknowns_of
from holdfast.identification.recording import Recording
from holdfast.identification.suspicions import suspicions_of_motion
from holdfast.io.result_reader import Result
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.serial_chain import serial_chain
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.inertia import about_origin, of_parameters
from holdfast.spatial.scalar import Array

MEASUREMENTS = ("wrist_wrench", "tau")  # of the payload alone
MEASURED_AT_WRISTS = ("wrist_wrench", "wrist_force")
RecordingSource = Recording | Trajectory | Result | str | PathLike[str]


@np.errstate(all="ignore")  # what overflows is refused
def identify(
    chain: ClosedChain,
    recordings: RecordingSource | Sequence[RecordingSource],
    *,
    by: Literal["wrist_wrench", "tau", "current", "wrist_force"] = "wrist_wrench",
    unknowns: Sequence[str] | None = None,
    prior: Prior | None = None,
    loss: Literal["squares", "huber"] = "squares",
    sensor_bias: bool = False,
    gravity: bool = False,
    grasp_frames: bool = False,
    noise: ArrayLike | None = None,
    largest_deviation: float = 0.3,
) -> Identification:
    """Estimate the payload, or more of the machine, by weighted least squares over physically possible bodies.

    The sum of squared residuals is minimised, weighted by the inverse covariance of their noise, over all bodies that
    some distribution of mass has. Combinations of parameters that the motion does not identify keep the guess's values,
    those of the chain, and are listed in the result; if no feasible body has these, they become those of the nearest
    one that fits as well. Positions without rates or accelerations are smoothed, and their noise enters the weights and
    the covariance. O(samples n), with torques O(samples n^3).

    With `unknowns`, whatever is named is estimated together, with the model's values as its prior, whose deviations are
    those of `prior`: what the recordings do not tell stays there. The arms may hold nothing then. Noise that depends on
    its past enters their deviations.

    Args:
        chain: model of arms, grasps and object.
        recordings: a `Recording`, a simulated run, a result of `load_result`, or the path of a result folder, a .csv
            or a .parquet file; or a list of these.
        by: the measurements: "wrist_wrench", wrenches of wrist sensors, which give six equations per sample; or "tau",
            joint torques, which give as many equations per sample as the chain has degrees of freedom, without grasp
            forces. With `unknowns` also "current", currents of the drives, and "wrist_force", wrists without moments.
        unknowns: kinds of unknowns: "payload", "links", "armature", "damping", "friction", "friction_offset",
            "friction_asymmetry", "drive_gain", "sensor_offset", "sensor_scale", "sensor_drift", "time_offset"; None
            for the payload without a prior.
        prior: how uncertain the model's values are, a `Prior`; only with `unknowns`.
        loss: "squares", or "huber", with which samples that are far off have less weight; only with `unknowns`.
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
        ModelError: it is not a chain, an unknown cannot be told by the measurements, the payload is flat or not a
            feasible body, or options contradict each other.
        StateError: a recording does not match the chain, lacks measurements, is too short, or identifies nothing; a
            mass below zero explains the recordings best.
        ResultError: a file cannot be read.

    Reference:
        Atkeson, An and Hollerbach 1986; Wensing, Kim and Slotine 2018; `docs/theory/derivatives.md`.
    """
    if unknowns is not None:
        flags = {"sensor_bias": sensor_bias, "gravity": gravity}
        options = (by, unknowns, prior, loss, noise, largest_deviation, grasp_frames)
        return _of_machine(chain, recordings, flags, *options)
    if prior is not None or loss != "squares":
        raise ModelError(f"identify: {'loss' if prior is None else 'prior'}: expected unknowns= with it, got none")
    settings = _settings(chain, by, {"sensor_bias": sensor_bias, "gravity": gravity, "grasp_frames": grasp_frames})
    largest = checks.number(largest_deviation, "identify: largest_deviation", above=0.0)
    given = _recordings(recordings, chain)
    for one in given:
        _require(chain, one, by)
    frames: dict[str, Array] = {}
    if grasp_frames:
        chain, frames = measured_grasps(chain, given)
    moving = [differentiated(fitting(chain, one)) for one in given]
    whole = [completed(chain, one) for one, _ in moving]
    system = equations(chain, whole, settings)
    wrists = np.tile([0, 0, 0, 1, 1, 1], len(chain.grasps))
    kinds = wrists if by == "wrist_wrench" else np.arange(chain.joint_count)
    sought = unknowns_of(chain, settings, _wrench_sizes(system, by))
    rows, p = system.rows[..., 0].size, len(sought.names)
    if rows < 2 * p:
        raise StateError(
            f"identify: expected {2 * p} rows or more for {p} unknowns, got {rows} of {len(system.rows)} samples"
        )
    motion = payload_noise(chain, moving, settings, system)
    doubts = suspicions_of_motion(chain, [one for one, _ in moving])
    try:
        found = estimate(system, sought, kinds, _given_noise(noise, chain, by), largest, motion)
    except StateError as error:
        if not doubts:
            raise
        said = str(error).removeprefix("identify: ")
        raise StateError(f"identify: recording: {'; '.join(doubts)}; as it stands, {said}") from error
    notes = [*doubts, *notes_on_estimate(found, motion, system, noise is not None)]
    notes += notes_on_far(found.far, np.concatenate([one.t[k] for one, k in zip(whole, system.kept, strict=True)]))
    notes += [*notes_on_grasps(chain, whole, frames), *notes_on_motion(given)]
    return replace(_identification(chain, sought, found, settings, frames, tuple(notes)), suspicions=tuple(doubts))


def _of_machine(
    chain: Any,
    recordings: Any,
    flags: dict[str, Any],
    by: Any,
    unknowns: Any,
    prior: Any,
    loss: Any,
    noise: Any,
    largest_deviation: Any,
    grasp_frames: Any,
) -> Identification:
    """Return the estimate of the unknowns that are named; see `identify`."""
    checks.instance(chain, ClosedChain, "identify: chain")
    bare = chain.held_object is None
    chain = without_object(chain)
    serial_chain(chain, "identify: chain")
    if not isinstance(by, str) or by not in KINDS:
        raise ModelError(f"identify: by: expected {' or '.join(map(repr, KINDS))}, got {checks.short(by)}")
    kinds = required_kinds(unknowns, by, chain)
    for name, flag in flags.items():
        if flag is not False:
            raise ModelError(f"identify: {name}: expected False with unknowns=, which may have 'sensor_offset'")
    checks.instance(grasp_frames, bool, "identify: grasp_frames")
    checks.instance(prior, (Prior, type(None)), "identify: prior")
    if not isinstance(loss, str) or loss not in ("squares", "huber"):
        raise ModelError(f"identify: loss: expected 'squares' or 'huber', got {checks.short(loss)}")
    if by in MEASURED_AT_WRISTS and not chain.grasps:
        raise ModelError(f"identify: by: expected an arm that holds the object for '{by}', got none; try by='tau'")
    largest = checks.number(largest_deviation, "identify: largest_deviation", above=0.0)
    given = _recordings(recordings, chain)
    for one in given:
        _require(chain, one, by)
        fitting(chain, one)
    frames: dict[str, Array] = {}
    if grasp_frames:
        chain, frames = measured_grasps(chain, given)
    found = identify_machine(
        chain, given, by, kinds, prior or Prior(), _given_noise(noise, chain, by), largest, loss == "huber"
    )
    result = _machine_result(found, frames)
    return replace(result, chain=replace(result.chain, held_object=None)) if bare else result


def _machine_result(found: Machine, frames: dict[str, Array]) -> Identification:
    """Return the result of a machine's estimate."""
    names, unsure = found.unknowns.names, found.kept | found.partly
    before, slope = found.unknowns.plain(found.unknowns.start)
    sizes = np.where(unsure, np.inf, np.sqrt(np.maximum(np.diag(found.covariance), 0.0)))
    return Identification(
        chain=found.chain,
        names=names,
        values=found.values,
        covariance=found.covariance,
        deviations=dict(zip(names, sizes.tolist(), strict=True)),
        kept=tuple(name for name, one in zip(names, found.kept, strict=True) if one),
        partly=tuple(name for name, one in zip(names, found.partly, strict=True) if one),
        undetermined=found.undetermined,
        notes=found.notes,
        sensor_bias=None,
        grasp_deviations=frames,
        residuals=found.fit.residuals,
        noise=found.fit.noise,
        misfit=found.fit.misfit,
        others=found.others,
        errors=found.fit.errors,
        before=before,
        believed=np.sqrt(((slope * found.unknowns.spread) ** 2).sum(axis=1)),
        suspicions=found.suspicions,
        freedoms=found.fit.freedoms,
    )


def _recordings(recordings: Any, chain: ClosedChain) -> list[Recording]:
    """Return all recordings; refuse none."""
    listed = isinstance(recordings, list | tuple)
    given = [recording_of(one, chain) for one in (recordings if listed else [recordings])]
    if not given:
        raise StateError("identify: recordings: expected at least one, got none")
    return given


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


def _require(chain: ClosedChain, one: Recording, by: str) -> None:
    """Refuse a recording without the measurements, or with another number of arms."""
    measured = getattr(one, by)
    if measured is None:
        other = next((name for name in KINDS if getattr(one, name) is not None), None)
        hint = f"; it has {other}: try by='{other}'" if other else ""
        raise StateError(f"identify: recording: expected {by}, got none{hint}")
    if by in MEASURED_AT_WRISTS and measured.shape[1] != len(chain.arms):
        raise StateError(f"recording: {by}: expected {len(chain.arms)} arms, got {measured.shape[1]}")


def _given_noise(noise: Any, chain: ClosedChain, by: str) -> Array | None:
    """Return the given standard deviations for each channel, (channels,), or None."""
    if noise is None:
        return None
    given = checks.numbers(noise, None, "identify: noise")
    l, n, at_wrist = len(chain.arms), chain.joint_count, 6 if by == "wrist_wrench" else 3
    shapes = [(at_wrist,), (l, at_wrist)] if by in MEASURED_AT_WRISTS else [(), (n,)]
    if given.shape not in shapes:
        raise ModelError(f"identify: noise: expected shape {' or '.join(map(str, shapes))}, got {given.shape}")
    if (given <= 0.0).any():
        raise ModelError(f"identify: noise: expected standard deviations > 0, got {given.min():g}")
    if by not in MEASURED_AT_WRISTS:
        return np.broadcast_to(given, (n,))
    return np.broadcast_to(given, (l, at_wrist))[[chain.names.index(name) for name in chain.grasps]].ravel()


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
        undetermined=sentences(found.fixed, unknowns.names, unknowns.sizes),
        notes=notes,
        sensor_bias=bias,
        grasp_deviations=frames,
        residuals=found.residuals,
        noise=found.noise,
        misfit=found.misfit,
    )
