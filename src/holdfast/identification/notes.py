"""Remarks on an estimate: what limits it, and what is likely to be wrong."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.consistency import closure
from holdfast.identification.equations import Equations
from holdfast.identification.estimate import Estimate
from holdfast.identification.free_fit import noise_of_columns
from holdfast.identification.motion_noise import JointNoise
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

FAR = 0.01  # tip errors above this are reported [m or rad]
CHECKED_SAMPLES = 10  # samples in which they are checked
ROUNDING_MISFIT = 1e-3  # mean square of whitened residuals below which these are rounding rather than noise
POORLY = 2.0  # mean square of residuals, in units of the noise, above which a note is added
MOVED_BY_ROUNDING = 0.01  # squared standard deviations below which a move by the bound of feasible bodies is rounding
FEW_TIMES = 4  # times that are named
SEEN = 0.01  # share of the residuals' variance above which the noise of positions is named
ROUGH = 0.03  # noise of given accelerations, relative to their size, above which a note is added
DENSELY = 0.3  # relative error of the trapezoidal rule, and size of a step, below which samples are close together
MOSTLY = 0.9  # share above which nothing is said of the remaining part


def notes_on_estimate(found: Estimate, motion: list[JointNoise], system: Equations, noise_given: bool) -> list[str]:
    """Return remarks on the quality of the estimate."""
    notes = []
    if found.moved > MOVED_BY_ROUNDING:
        notes.append(
            "the unconstrained estimate is not a feasible body; the feasible body that fits best is returned,"
            f" {np.sqrt(found.moved):.2g} standard deviations away"
        )
    elif not found.held:
        notes.append(
            "the guess's values of what is not identified belong to no feasible body with the identified values; they"
            " are those of the feasible body nearest to the guess"
        )
    if found.misfit > POORLY:
        whose = "given noise" if noise_given else "noise that the unconstrained estimate leaves"
        cause = "friction" if noise_given else "the right signs, units or frames"
        notes.append(
            f"residuals are {np.sqrt(found.misfit):.2g} times the {whose}: the model lacks something, such as {cause},"
            " and deviations are too small" + ("; try noise=None" if noise_given else "")
        )
    if not found.settled:
        notes.append("weights and estimate did not converge together; deviations are rough; try noise=")
    after = found.autocorrelation
    if after.significant and found.misfit > ROUNDING_MISFIT and found.motion_share < MOSTLY:
        times = float(np.sqrt(after.widening))
        widened = (
            f"deviations are increased {times:.2g} times" if times > 1.05 else "deviations are those of white noise"
        )
        notes.append(f"residuals of neighbouring samples are correlated ({after.of_neighbours:.2f}): {widened}")
    if found.motion_share > SEEN:
        notes.append(note_on_positions(motion))
    if system.left_out:
        notes.append(f"{system.left_out} samples at singular configurations were left out")
    return notes


def notes_on_far(far: Array, t: Array) -> list[str]:
    """Return a remark on samples that are left out as their residuals are beyond chance, at times t, (samples,)."""
    if not far.any():
        return []
    times = ", ".join(f"{x:.4g}" for x in t[far][:FEW_TIMES].tolist()) + (" .." if far.sum() > FEW_TIMES else "")
    return [
        f"{int(far.sum())} samples are beyond chance and were left out, at {times} s: joints accelerate there within"
        " less time than the samples show, as when a controller is switched on, or a measurement is wrong"
    ]


def note_on_positions(motion: list[JointNoise]) -> str:
    """Return a remark on the noise of positions."""
    return (
        f"positions have noise of up to {max(one.spline.noise for one in motion):.2g} (rad or m); rates and"
        " accelerations are those of smoothing splines, and deviations include their errors"
    )


def notes_on_motion(recordings: list[Recording]) -> list[str]:
    """Return a remark if given accelerations are noisy, as they are if noisy positions were differentiated twice."""
    for one in recordings:
        found = {}
        for name, of in (("qdd", "qd"), ("object_acceleration", "object_twist")):
            x, rates = getattr(one, name), getattr(one, of)
            if x is not None and rates is not None and _is_sampled_densely(one.t, rates, x):
                size = max(float(np.sqrt((x**2).sum(axis=1).mean())), 1e-300)
                found[name] = float(np.linalg.norm(noise_of_columns(x))) / size
        if found and max(found.values()) > ROUGH:
            name = max(found, key=lambda name: found[name])
            return [
                f"{name} has noise of {100 * found[name]:.2g} % of its size, which draws estimates towards zero: try"
                " without qd and qdd, which are then found from the positions, with their noise in the deviations"
            ]
    return []


def _is_sampled_densely(t: Array, rates: Array, accelerations: Array) -> bool:
    """Return whether rates change from sample to sample as the accelerations say, by far less than in all."""
    steps = np.diff(rates, axis=0)
    expected = 0.5 * (accelerations[1:] + accelerations[:-1]) * np.diff(t)[:, None]
    whole = rates - rates.mean(axis=0)
    return bool(
        np.linalg.norm(np.cumsum(steps - expected, axis=0)) < DENSELY * np.linalg.norm(whole)
        and np.linalg.norm(steps) < DENSELY * np.linalg.norm(whole)
    )


def notes_on_grasps(chain: ClosedChain, recordings: list[Recording], frames: dict[str, Array]) -> list[str]:
    """Return remarks on the grasps: frames that were not estimated, and tips that are away from their grasps."""
    notes = []
    if frames and (others := [name for name in chain.grasps if name not in frames]):
        notes.append(f"the grasp frames of {', '.join(map(repr, others))} are the model's")
    apart = dict.fromkeys(chain.grasps, 0.0)
    for one in recordings:
        for k in np.linspace(0, len(one) - 1, CHECKED_SAMPLES).round().astype(int).tolist():
            for name, gap in closure(chain, one.state(k)).items():
                apart[name] = max(apart[name], float(np.abs(gap.position).max(initial=0.0)))
    far = {name: gap for name, gap in apart.items() if gap > FAR}
    if far:
        said = ", ".join(f"'{name}' {gap:.2g}" for name, gap in far.items())
        notes.append(
            f"tips are off their grasps by up to [m or rad]: {said}; try grasp_frames=True, or look at units, joint"
            " zeros and the model's frames"
        )
    return notes
