"""The result of an identification: values, their uncertainty, and what the recordings do not determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from holdfast.identification.joint_region import in_region
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Frozen, making
from holdfast.spatial.scalar import Array


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
        others: by kind of unknown, what the chain has no fields for: "friction_offset", "friction_asymmetry",
            "drive_gain", "sensor_offset", "sensor_scale", "sensor_drift", "time_offset".
        errors: (samples, channels) the smallest errors of the measurements that explain the residuals; for an arm
            that holds nothing, and for a single arm, measured minus predicted torques. Empty without `unknowns`.
        freedoms: degrees of freedom from which the noise was estimated with `unknowns`; infinite if it was given, or
            without `unknowns`.
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
    others: Mapping[str, Array] = field(default_factory=dict)
    errors: ArrayField = field(default_factory=making(np.zeros, (0, 0)))
    before: ArrayField = field(default_factory=making(np.zeros, 0))
    believed: ArrayField = field(default_factory=making(np.zeros, 0))
    suspicions: tuple[str, ...] = ()
    freedoms: float = np.inf

    @property
    def held_object(self) -> HeldObject:
        """The payload, which is a physically feasible body."""
        return self.chain.held_object

    @property
    def gravity(self) -> Array:
        """(3,) gravity, world axes [m/s^2]."""
        return self.chain.gravity

    def holds(self, values: Mapping[str, float], level: float = 0.9) -> bool:
        """Return whether values lie in the joint region of their estimates. O(k^3).

        The region of k values is e^T C^-1 e < k F(level; k, freedoms), with the errors e and their covariance C.

        Args:
            values: k values by name, e.g. of a data sheet.
            level: probability with which the region holds the truth.

        Raises:
            ModelError: a name is unknown or not determined, or the level is not between 0 and 1.

        Reference:
            Scheffe 1959, The Analysis of Variance, section 3.5.
        """
        estimate = dict(zip(self.names, self.values.tolist(), strict=True))
        return in_region(estimate, self.covariance, self.freedoms, values, level, (*self.kept, *self.partly))

    def __repr__(self) -> str:
        """Return the number of values and the mass, if it is one of them; `print` shows all of them."""
        mass = f": {self.held_object.mass:.4g} kg" if "mass" in self.names else ""
        return f"<Identification of {len(self.names)} values{mass}>"

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
