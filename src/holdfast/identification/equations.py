"""The equations of the identification of a payload, which are linear in features: the unknowns and some products.

With known gravity the features are [pi; b; 1], otherwise [pi; g_x pi; g_y pi; g_z pi; b; 1; g]:

    rows @ features(x) = -maps @ noise,    x = [pi; b; tilt]

Here pi are the object's ten inertial parameters about the model's mass centre, object axes, so that the rows are well
conditioned; b are the offsets of the wrist sensors; tilt rotates gravity. The rows are those of a machine (`rows`) of
which nothing else is unknown, A pi + b - P y. They are linear in gravity, and so are found from those without gravity
and those with the three unit vectors as gravity.

A floating base stays where it is in the motions N, while the base itself moves as recorded. Other motions would add the
balance of the base, in which no measurement has a share: it would count as exact, and is not, since rates and
accelerations of base and joints are measured or smoothed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.regressor import UNIT_BODIES
from holdfast.identification.payload_unknowns import Settings
from holdfast.identification.recording import Recording
from holdfast.identification.rows import forces_without_friction, rows_of, terms_of
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class Equations:
    """The rows of all samples.

    Attributes:
        rows: (samples, r, features) coefficients of the features.
        motions: (samples, r, freedoms) orthonormal, along which the rows are: of joints and object; with wrists, axes
            at C.
        maps: (samples, r, channels) from the noise of the channels to the rows.
        measured: (samples, channels) measurements [N m, N].
        kept: by recording, which samples these are. Others are left out because their configuration is singular, so
            that the number of degrees of freedom differs.
    """

    rows: Array
    motions: Array
    maps: Array
    measured: Array
    kept: list[Array]

    @property
    def left_out(self) -> int:
        """The number of samples that are left out."""
        return sum(int((~one).sum()) for one in self.kept)


def equations(chain: ClosedChain, recordings: list[Recording], settings: Settings) -> Equations:
    """Return the equations of completed recordings. O(samples n), with torques O(samples n^3)."""
    terms = terms_of(chain, settings.source, _kinds(settings))
    found = [rows_of(chain, recordings, terms, gravity) for gravity in _gravities(chain, settings)]
    first = found[0]
    parts = [
        np.concatenate([one.A, (one.b - np.einsum("src,sc->sr", one.P, one.y))[:, :, None]], axis=2) for one in found
    ]
    return Equations(_of_features(chain, parts), first.N, first.P, first.y, first.kept)


def payload_forces(chain: ClosedChain, recordings: Sequence[Recording], settings: Settings) -> list[Array]:
    """Return (samples, freedoms, features) of each of some recordings, which have the same inputs.

    They are the rows as forces along all freedoms, without dry friction.
    """
    terms = terms_of(chain, settings.source, _kinds(settings))
    found = [
        forces_without_friction(chain, recordings, terms, gravity=gravity) for gravity in _gravities(chain, settings)
    ]
    return [_of_features(chain, parts) for parts in zip(*found, strict=True)]


def _kinds(settings: Settings) -> tuple[str, ...]:
    """Return the kinds of unknowns beside gravity."""
    return ("payload", "sensor_offset") if settings.sensor_bias else ("payload",)


def _gravities(chain: ClosedChain, settings: Settings) -> list[Array]:
    """Return gravity, or none and its unit vectors if its direction is unknown."""
    return [np.zeros(3), *np.eye(3)] if settings.gravity else [chain.gravity]


def _of_features(chain: ClosedChain, parts: Sequence[Array]) -> Array:
    """Return coefficients of the features, from those of [the payload about C, sensor offsets, 1] by gravity."""
    first, apart = parts[0], [part - parts[0] for part in parts[1:]]
    to_C = np.array([body.moved(np.eye(3), chain.held_object.com).parameters for body in UNIT_BODIES]).T
    of_payload = [part[..., :10] @ to_C for part in (first, *apart)]
    return np.concatenate([*of_payload, first[..., 10:], *(part[..., -1:] for part in apart)], axis=-1)
