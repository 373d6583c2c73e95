"""What identification returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class Identification(Frozen):
    """A payload and what else was asked for, and how sure they are.

    Attributes:
        chain: the chain with all that was found in the place of the model's values.
        names: (p,) what was looked for: mass, com x .. z from C, inertia xx, xy, xz, yy, yz, zz about the mass centre,
            all in object axes; then sensor offsets and gravity's tilt, if they were asked for.
        values: (p,) [kg, m, kg m^2, ...].
        covariance: (p, p) of the values; 0 along combinations that keep the model's values.
        deviations: by name, standard deviations; infinite where a value is the model's, or rests on it in part.
        kept: the names whose values are the model's, because the motion cannot tell them.
        partly: the names whose values rest on the model in part, because only combinations with others are told.
        undetermined: what the motion cannot tell, in words; there the model is kept.
        notes: what else is to be known of the estimate, in words.
        sensor_bias: (arms, 6) what each wrist sensor shows too much, tip axes [N m, N]; None if not asked for.
        grasp_deviations: by arm whose grasp frame was asked for, (6,) of [turn; shift] in object axes [rad, m].
        residuals: (samples, rows) left of the equations: [moment; force] about C along world axes, from torques the
            power along an orthonormal basis of motions.
        noise: (channels,) standard deviations of what was measured, by which rows are weighted [N m, N].
        misfit: mean square of the residuals in units of that noise.
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
        """The payload: a body that some distribution of mass has."""
        return self.chain.held_object

    @property
    def gravity(self) -> Array:
        """(3,) world axes [m/s^2]."""
        return self.chain.gravity

    def __str__(self) -> str:
        """Return a table, and below it what cannot be told and what is to be known."""
        width, said = max(map(len, self.names)), dict.fromkeys(self.kept, "the model's")
        said |= dict.fromkeys(self.partly, "in part the model's")
        lines = [
            f"{name:<{width}}  {value:>+12.5g}  {said.get(name, f'+- {self.deviations[name]:.2g}')}"
            for name, value in zip(self.names, self.values.tolist(), strict=True)
        ]
        return "\n".join([*lines, *self.undetermined, *self.notes])
