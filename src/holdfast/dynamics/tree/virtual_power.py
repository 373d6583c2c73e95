"""The virtual power of a forest's equations, a scalar from which its questions and their derivatives follow.

With z = (qdd, lambda, mu), the accelerations, the forces of closures along their rows and those of couplings, and
multipliers y = (y_q, y_f, y_c) of the same layout,

    L = sum over bodies U.(M beta + b - w) + sum over joints y_q.(armature qdd + damping qd - tau)
        - sum over closures [y_f.(c_a beta_a + c_b beta_b - r) + lambda.(c_a U_a + c_b U_b)]
        - sum over couplings [y_c (c.qdd - r) + mu c.y_q]

with the virtual twists U of joint rates y_q. The equations are dL/dy = 0, and K = d2L/dz dy is symmetric; K z = r is
the forest at rest, with the entries of r as torques and gaps (docs/theory/tree.md).
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.tree.elimination import Tips
from holdfast.dynamics.tree.forest_dynamics import by_plan
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.limb_power import LimbsInMotion
from holdfast.spatial.differentiation import gradient
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import shift_twist


class ForestUnknowns(NamedTuple):
    """The unknowns z of a forest's equations, or their multipliers y.

    Attributes:
        rates: per body, (m,) joint accelerations; of a free body (6,) that of its mass centre. Or virtual rates.
        closures: per closure, (rows,) its force along its rows.
        couplings: (couplings,) multipliers.
    """

    rates: list[Array]
    closures: list[Array]
    couplings: Array

    @property
    def flat(self) -> Array:
        """All of them, (n_v + rows of closures and couplings,)."""
        return concatenate([*self.rates, *self.closures, self.couplings])


class ForestOutputs(NamedTuple):
    """What forward dynamics returns; see `ForestResult`."""

    qdd: Array
    acceleration: Array
    closure_wrench: Array
    coupling_force: Array


def unknowns_from(motion: ForestMotion, flat: Array) -> ForestUnknowns:
    """Return unknowns from one vector."""
    forest = motion.forest
    sizes = [at.stop - at.start for at in forest.velocities]
    sizes += [len(closure.grasp.of_kind.transmitted) for closure in forest.closures]
    parts = [flat[i:j] for i, j in pairwise(np.cumsum([0, *sizes, len(motion.coupled)]).tolist())]
    count = len(motion.bodies)
    return ForestUnknowns(parts[:count], parts[count:-1], parts[-1])


def unknowns_of(
    motion: ForestMotion, rates: list[Array], wrenches: Iterable[Array], multipliers: Any
) -> ForestUnknowns:
    """Return unknowns whose closures have some wrenches, (6,) each about the contact point."""
    along = [c.K @ f for c, f in zip(motion.closures, wrenches, strict=True)]
    return ForestUnknowns(rates, along, concatenate([multipliers]))


def carried(motion: ForestMotion, rates: list[Array]) -> list[Array]:
    """Return per body the twist, or acceleration, of its point due to joint rates, (6,); 0 in limbs. O(bodies)."""
    found: list[Array] = []
    for body, part, x in zip(motion.forest.bodies, motion.bodies, rates, strict=True):
        own = np.zeros(6) if part is None else part.H @ x
        found.append(own if part is None or body.parent is None else shift_twist(part.reach, found[body.parent]) + own)
    return found


def along_rows(
    motion: ForestMotion, rates: list[Array], moved: list[Array], tips: Tips = MappingProxyType({})
) -> tuple[list[Array], list[Scalar]]:
    """Return the product of the rows of closures, (rows,) each, and of couplings with joint rates.

    Args:
        motion: the forest's motion.
        rates: per body, (m,).
        moved: what they add to the points of the bodies, `carried`.
        tips: by closure and whether its body b ends a limb, the motion of the limb's tip.
    """
    forest, closed = motion.forest, []
    for i, (closure, c) in enumerate(zip(forest.closures, motion.closures, strict=True)):
        own = c.K @ tips[i, True] if (i, True) in tips else c.on_b @ moved[closure.b]
        if (i, False) in tips:
            own = own - c.K @ tips[i, False]
        closed.append(own if closure.a is None or (i, False) in tips else own + c.on_a @ moved[closure.a])
    return closed, [sum(c * rates[k][i] for k, i, c in coupling.terms) for coupling in forest.couplings]


def virtual_power(whole: LimbsInMotion, z: ForestUnknowns, beta: list[Array], y: ForestUnknowns) -> Scalar:
    """Return L. O(bodies + closures).

    Args:
        whole: the forest's motion, with the part of its limbs.
        z: accelerations and forces.
        beta: the accelerations of the bodies' points, `carried`.
        y: the multipliers.
    """
    motion, power = whole.motion, whole.power
    virtual_twists = carried(motion, y.rates)
    for body, a, U, qdd, rate in zip(motion.bodies, beta, virtual_twists, z.rates, y.rates, strict=True):
        if body is None:
            continue
        power = power + U @ (body.inertia.apply(a) + body.load - body.wrench)
        if not body.floats:
            power = power + rate @ (body.armature * qdd - body.torque)
    (moved, coupled), (apart, uncoupled) = (
        along_rows(motion, y.rates, virtual_twists, whole.virtual),
        along_rows(motion, z.rates, beta, whole.accelerations),
    )
    closures = zip(motion.closures, moved, apart, z.closures, y.closures, strict=True)
    for c, virtual, gap, force, multiplier in closures:
        if len(c.K):
            power = power - force @ virtual - multiplier @ (gap - c.r)
    couplings = zip(motion.coupled, coupled, uncoupled, z.couplings, y.couplings, strict=True)
    return power - sum(force * virtual + x * (gap - r) for r, virtual, gap, force, x in couplings)


def residual(motion: ForestMotion, z: ForestUnknowns) -> Array:
    """Return dL/dy, what the equations leave, in the layout of `ForestUnknowns.flat`."""
    beta, whole = carried(motion, z.rates), LimbsInMotion(motion)
    return gradient(lambda y: virtual_power(whole, z, beta, unknowns_from(motion, y)), np.zeros(len(z.flat)))[0]


def outputs(motion: ForestMotion, z: ForestUnknowns, beta: list[Array]) -> ForestOutputs:
    """Return what forward dynamics returns; without the accelerations of bodies within limbs, which are 0.

    Args:
        motion: the forest's motion.
        z: the unknowns.
        beta: their accelerations of the bodies' points, `carried`.
    """
    gravity = motion.forest.gravity
    bodies = list(zip(motion.bodies, beta, strict=True))
    acceleration = [np.zeros(6) if body is None else body.true_acceleration(x, gravity) for body, x in bodies]
    rates = [
        x if body is None or not body.floats else a
        for body, a, x in zip(motion.bodies, acceleration, z.rates, strict=True)
    ]
    wrenches = [f @ c.K if len(c.K) else np.zeros(6) for c, f in zip(motion.closures, z.closures, strict=True)]
    return ForestOutputs(concatenate(rates), array(acceleration), array(wrenches).reshape(-1, 6), z.couplings)


def solved_at_rest(motion: ForestMotion, r: ForestUnknowns) -> ForestUnknowns:
    """Return the solution of K z = r: the forest at rest with torques and gaps, by the elimination in its order.

    Args:
        motion: the forest's motion.
        r: right-hand sides in the layout of z.
    """
    still = motion.at_rest_with([-x for x in r.closures], [-x for x in r.couplings], r.rates)
    found = by_plan(still)
    return unknowns_of(still, list(found.qdd), found.wrenches, found.multipliers)
