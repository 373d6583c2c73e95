"""Remarks on an estimate: what limits it, and what is likely to be wrong."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.consistency import closure
from holdfast.identification.equations import Equations
from holdfast.identification.estimate import Estimate
from holdfast.identification.motion_noise import JointNoise
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

FAR = 0.01  # tip errors above this are reported [m or rad]
CHECKED_SAMPLES = 10  # samples in which they are checked
ROUNDING = 1e-3  # mean square of whitened residuals below which these are rounding rather than noise
POORLY = 2.0  # mean square of residuals, in units of the noise, above which a note is added
MOVED = 0.01  # squared standard deviations below which a move by the bound of possible bodies is rounding
SEEN = 0.01  # share of the residuals' variance above which the noise of positions is named
MOSTLY = 0.9  # share above which nothing is said of the remaining part


def notes_on_estimate(found: Estimate, motion: list[JointNoise], system: Equations, noise_given: bool) -> list[str]:
    """Return remarks on the quality of the estimate."""
    notes = []
    if found.moved > MOVED:
        notes.append(
            "the unconstrained estimate is not a possible body; the possible body that fits best is returned,"
            f" {np.sqrt(found.moved):.2g} standard deviations away"
        )
    elif not found.held:
        notes.append(
            "the guess's values of what is not identified belong to no possible body with the identified values; they"
            " are those of the possible body nearest to the guess"
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
    if found.colour.coloured and found.misfit > ROUNDING and found.motion_share < MOSTLY:
        widened = f"deviations are increased {np.sqrt(found.colour.widening):.2g} times"
        notes.append(f"residuals of neighbouring samples are correlated ({found.colour.correlation:.2f}): {widened}")
    if found.motion_share > SEEN:
        largest = max(one.spline.noise for one in motion)
        notes.append(
            f"positions have noise of up to {largest:.2g} (rad or m); rates and accelerations are those of smoothing"
            " splines, and deviations include their errors"
        )
    if system.left_out:
        notes.append(f"{system.left_out} samples at singular configurations were left out")
    return notes


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
