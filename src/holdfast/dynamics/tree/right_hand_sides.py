"""Right-hand sides of a forest's equations, on their way inward through its plan and outward again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.tree.forest_motion import ClosureMotion, Limb
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.model.forest import GROUND
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.spatial_vector import shift_wrench


class ForestLoads(NamedTuple):
    """Loads and right-hand sides of the rows of a forest, on which its factors do not depend.

    Attributes:
        bodies: per body, its loads, torques and external wrenches; None within limbs.
        falling: by free body, its acceleration without an external wrench, if nothing hangs on it.
        closures: the closures, of which only the right-hand sides matter.
        coupled: per coupling, the right-hand side of its row.
        limbs: limbs on bodies, of which only the loads on their columns matter.
        gaps: by closure of a limb, (6,) relative acceleration at its tip without any force; without it, that of the
            limb's measurement.
    """

    bodies: Sequence[Any]
    falling: Mapping[int, Array]
    closures: Sequence[ClosureMotion]
    coupled: Sequence[Scalar]
    limbs: Sequence[Limb] = ()
    gaps: Mapping[int, Array] = MappingProxyType({})


@dataclass
class Inward:
    """A right-hand side on its way inward.

    Attributes:
        rhs: the right-hand side.
        load: by body, (6,) z of everything that has settled on it.
        nu: by body, (m,) D^-1 eps; of a free body -D^-1 z.
        x: (n,) accelerations of the open frames of the present part.
        on_root: (c,) load on its root.
        kept: per part, for every step what its way back needs.
    """

    rhs: ForestLoads
    load: dict[int, Array] = field(default_factory=dict)
    nu: dict[int, Array] = field(default_factory=dict)
    x: Array = field(default_factory=lambda: np.zeros(0))
    on_root: Array = field(default_factory=lambda: np.zeros(0))
    kept: dict[int, list[Any]] = field(default_factory=dict)

    @staticmethod
    def of(rhs: ForestLoads) -> Inward:
        """Return a right-hand side before any body has settled, with the loads of limbs on the bodies below them."""
        side = Inward(rhs, {k: body.load for k, body in enumerate(rhs.bodies) if body is not None})
        for limb in rhs.limbs:
            base = limb.tip.base
            if base is not None:
                side.load[limb.on] = side.load[limb.on] + shift_wrench(limb.offset, base.at_rest)
                if len(base.wrench) == 6:  # otherwise they belong to joint rates (`crossing`)
                    side.load[limb.on] = side.load[limb.on] + base.wrench
        return side

    def begin(self, part: int, width: int) -> None:
        """Begin the steps of a part whose root has `width` columns."""
        self.x, self.on_root, self.kept[part] = np.zeros(0), np.zeros(width), []

    def settle(self, k: int, parent: int, body: SettledBody) -> None:
        """Let the load of a body settle at its parent."""
        load, torque = self.load[k], self.rhs.bodies[k].torque
        falling = None if body.free is None else self.rhs.falling.get(k)
        self.nu[k] = body.nu(load, torque) if falling is None else falling
        if parent != GROUND:
            self.load[parent] = self.load[parent] + body.load_on_parent(load, torque)


@dataclass
class Outward:
    """A right-hand side on its way outward, and the accelerations and forces that are known so far.

    Attributes:
        inward: the same on its way inward.
        columns: (c,) accelerations of the columns of the present root.
        s: by frame of the present part, the wrench on it.
        extra: by body, the joint accelerations that forces within its part add.
        qdd: by body, joint accelerations; none of bodies within limbs.
        beta: by body, the acceleration that the joints add; 0 of the world.
        wrenches: by closure, f about its contact point.
        multipliers: by coupling, lambda.
    """

    inward: Inward
    columns: Array = field(default_factory=lambda: np.zeros(0))
    s: dict[int, Array] = field(default_factory=dict)
    extra: dict[int, Array] = field(default_factory=dict)
    qdd: dict[int, Array] = field(default_factory=dict)
    beta: dict[int, Array] = field(default_factory=lambda: {GROUND: np.zeros(6)})
    wrenches: dict[int, Array] = field(default_factory=dict)
    multipliers: dict[int, Scalar] = field(default_factory=dict)

    @property
    def rhs(self) -> ForestLoads:
        """The right-hand side."""
        return self.inward.rhs

    def moves(self, k: int, qdd: Array, beta: Array) -> None:
        """Note the acceleration of a body."""
        self.qdd[k], self.beta[k] = qdd, beta

    def stacked(self, frames: Mapping[int, int]) -> Array:
        """Return s as one vector (n,)."""
        return concatenate([np.zeros(0), *(self.s[name] for name in frames)])

    def unstack(self, frames: Mapping[int, int], s: Array) -> None:
        """Put s from one vector (n,)."""
        start = 0
        for name, size in frames.items():
            self.s[name] = s[start : start + size]
            start += size
