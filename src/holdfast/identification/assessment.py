"""How good an identification is: what it leaves of each channel, what it predicts, and where it is bad."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.identification.identification import Identification
from holdfast.identification.identify import identify
from holdfast.identification.load_recording import recording_of
from holdfast.identification.machine.identify_machine import explained, measurement_errors
from holdfast.identification.notes import POORLY
from holdfast.identification.recording import Recording
from holdfast.identification.rows import ON_DRIVES
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

HELD_OUT = 3  # one part of so many of a recording is held out
UNEXPLAINED = 0.5  # residual of a channel, relative to how much it varies, from which a fit is bad
MINOR = 0.1  # a channel that varies less than this, relative to the largest one, is not judged
WORSE = 2.0  # ratio of held-out to fitted residuals from which a fit is bad
WRIST_AXES = ("moment x", "moment y", "moment z", "force x", "force y", "force z")
UNIT_OF = {"tau": "N m or N", "current": "A", "wrist_force": "N", "wrist_wrench": "N m or N"}


@called
@dataclass(frozen=True, eq=False)
class Assessment(Frozen):
    """An identification with what it leaves and predicts.

    Attributes:
        found: the identification from all recordings.
        by: what was measured.
        channels: names of the measurements, joints or axes of wrists.
        t: by recording, (samples,) times [s].
        measured: by recording, (samples, channels).
        errors: by recording, (samples, channels) measured minus predicted, as `measurement_errors` returns them.
        fitted: (channels,) root mean squares of these.
        held_out: (channels,) root mean squares of the errors in the last third of the recordings, or in others, which a
            fit to the rest predicts; None if that fit failed.
        criteria: sentences by which the fit is bad; none if it is good.
    """

    found: Identification
    by: str
    channels: tuple[str, ...]
    t: tuple[Array, ...]
    measured: tuple[Array, ...]
    errors: tuple[Array, ...]
    fitted: Array
    held_out: Array | None
    criteria: tuple[str, ...]

    @property
    def measured_rms(self) -> Array:
        """The root mean squares of what was measured, (channels,)."""
        return _rms(np.concatenate(self.measured))

    def __repr__(self) -> str:
        """Return how many criteria are not met."""
        return f"<Assessment of {self.found!r}: {'bad' if self.criteria else 'good'}>"

    def __str__(self) -> str:
        """Return the values, residuals by channel, and the criteria by which the fit is bad."""
        width, later = max(map(len, self.channels)), self.held_out
        lines = [str(self.found), f"residuals [{UNIT_OF[self.by]} rms]: measured, left by the fit, held out"]
        whole = self.measured_rms
        for k, name in enumerate(self.channels):
            held = "" if later is None else f"  {later[k]:>9.4g}"
            lines.append(f"{name:<{width}}  {whole[k]:>9.4g}  {self.fitted[k]:>9.4g}{held}")
        return "\n".join([*lines, *(f"bad fit: {one}" for one in self.criteria)])


def assess(
    chain: ClosedChain, recordings: Any, *, by: str, unknowns: Sequence[str], held_out: Any = None, **options: Any
) -> Assessment:
    """Identify a machine, and predict what was held out: the last third of the recordings, or others.

    The criteria are: columns that are likely to be wrong; a channel of which more than half of what varies is left,
    among those that vary by a tenth of the largest; held-out errors more than twice the fitted ones; nothing that the
    recordings tell; residuals far beyond a given noise. Costs two calls of `identify`.

    Args:
        chain: the model.
        recordings: as for `identify`.
        by: the measurements, likewise.
        unknowns: kinds of unknowns, likewise.
        held_out: recordings that are not used, but predicted; None for the last third of those that are.
        options: other arguments of `identify`.

    Returns:
        An `Assessment`.

    Raises:
        ModelError, StateError, ResultError: as for `identify`.
    """
    given: dict[str, Any] = {"by": by, "unknowns": unknowns, **options}
    whole = [recording_of(one, chain) for one in _listed(recordings)]
    found = identify(chain, whole, **given)
    errors, rows = zip(*(explained(found.chain, one, by, found.others) for one in whole), strict=True)
    measured = tuple(one.y for one in rows)
    fitted = _rms(np.concatenate(errors))
    later = _held_out(chain, whole, held_out, given)
    names = _channel_names(chain, by)
    return Assessment(
        found=found,
        by=by,
        channels=names,
        t=tuple(one.t for one in rows),
        measured=measured,
        errors=errors,
        fitted=fitted,
        held_out=later,
        criteria=(*found.suspicions, *_criteria(found, names, by, np.concatenate(measured), fitted, later, given)),
    )


def _listed(given: Any) -> list[Any]:
    """Return one or several recordings as a list."""
    return list(given) if isinstance(given, list | tuple) else [given]


def _held_out(chain: ClosedChain, whole: list[Recording], others: Any, given: dict[str, Any]) -> Array | None:
    """Return (channels,) root mean squares of errors that were predicted; None if too little is left for a fit."""
    if others is None:
        cuts = [len(one) - len(one) // HELD_OUT for one in whole]
        first = [one.part(slice(None, cut)) for one, cut in zip(whole, cuts, strict=True)]
        later = [one.part(slice(cut, None)) for one, cut in zip(whole, cuts, strict=True)]
    else:
        first, later = whole, [recording_of(one, chain) for one in _listed(others)]
    try:
        fit = identify(chain, first, **given)
        return _rms(np.concatenate([measurement_errors(fit.chain, one, given["by"], fit.others) for one in later]))
    except StateError:
        if others is not None:
            raise
        return None


def _channel_names(chain: ClosedChain, by: str) -> tuple[str, ...]:
    """Return the names of the measurements."""
    if by in ON_DRIVES:
        return tuple(chain.joint_names())
    return tuple(
        f"{name} {axis}" for name in chain.grasps for axis in (WRIST_AXES if by == "wrist_wrench" else WRIST_AXES[3:])
    )


def _criteria(
    found: Identification,
    names: tuple[str, ...],
    by: str,
    measured: Array,
    fitted: Array,
    later: Array | None,
    given: dict[str, Any],
) -> list[str]:
    """Return by what the fit is bad."""
    said, varying = list[str](), measured.std(axis=0)
    judged = varying > MINOR * max(float(varying.max(initial=0.0)), 1e-12)
    for k in np.flatnonzero(judged & (fitted > UNEXPLAINED * varying)).tolist():
        said.append(
            f"the fit leaves {100.0 * fitted[k] / varying[k]:.0f} % of what varies in {by} of '{names[k]}': a column,"
            " sign or unit of it or of the positions is wrong, or something acts that the model does not have"
        )
    if later is not None:
        ratio = float(np.sqrt((later[judged] ** 2).sum() / max(float((fitted[judged] ** 2).sum()), 1e-300)))
        if ratio > WORSE and (later[judged] > 0.05 * varying[judged]).any():
            said.append(f"what was held out is predicted {ratio:.2g} times worse than what was fitted")
    if len(found.kept) + len(found.partly) == len(found.names):
        said.append("the recordings tell none of the unknowns apart from the model: try a livelier motion")
    if given.get("noise") is not None and found.misfit > POORLY**2:
        said.append(f"residuals are {np.sqrt(found.misfit):.2g} times the given noise")
    return said


def _rms(errors: Array) -> Array:
    """Return root mean squares by channel."""
    return np.sqrt((errors**2).mean(axis=0))
