"""The object's filter carried through a trunk: inward body by body, then the arms in the world, and back.

The belief about the object is alpha(G) = x + X beta, mobility P, beta what the trunk's joints add to the acceleration
of the body that is reached. At a body every arm that holds there is one more measurement, whose answer has a column for
each component of beta (`measurement`); what the grasps learn of beta is an inertia N and a wrench n on the body. Then
the body's joint is crossed, a = (eps + W^T s) / D - G^T phi^T beta with W = X H:

    P += W D^-1 W^T,   x += W eps / D,   X <- (X - W G^T) phi^T

It is block elimination of the whole chain's equations in another order, hence exact; nothing is subtracted from N or P
(docs/theory/trunk.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.measurement import Measurement, Update, measurement, size_at_centre
from holdfast.dynamics.closed.object_filter import ObjectSolution, by_rows, initial_size, wrench_at_contact
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C
from holdfast.dynamics.closed.rigid_update import rigid_update
from holdfast.dynamics.closed.row_updates import row_updates
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration, TrunkBody, TrunkMotion
from holdfast.spatial.linalg import RANK_TOLERANCE, forward_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, minimum
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6, mirrored, symmetric6, zero6
from holdfast.spatial.vector import outer

NO_INERTIA = 1e-14  # of the largest inertia about a joint of the trunk: what is left is rounding


class Belief(NamedTuple):
    """What is known of the object's acceleration when all arms further out have been seen.

    Attributes:
        x: (6, 7) [x | X], alpha(G) = x + X beta; (6,) x where no trunk is left.
        P: the mobility that is left, (6, 6) or in factors.
        size: (3,) how mobile P is, for judging pivots.
        kept: rows of the constraint that are independent.
        weakest: the smallest pivot kept, relative to a typical one.
    """

    x: Array
    P: Array | FactoredMobility
    size: Array
    kept: Scalar
    weakest: Scalar

    def dense(self) -> Array:
        """Return P, (6, 6)."""
        return self.P.dense() if isinstance(self.P, FactoredMobility) else self.P

    def factors(self) -> FactoredMobility:
        """Return P in factors."""
        return self.P if isinstance(self.P, FactoredMobility) else factored(self.P, by_rows(self.size))

    def seen(self, m: Measurement, tolerance: float) -> tuple[Belief, Update]:
        """Return the belief after an arm, and its back-substitution. A rigid one adds in parallel while P is dense."""
        if m.parallel and not isinstance(self.P, FactoredMobility):
            x, P, update = rigid_update(self.x, self.P, m, self.size)
            size = minimum(self.size, size_at_centre(m.extent))
        else:
            x, P, update = row_updates(self.x, self.factors(), m, self.size, tolerance)
            size = self.size
        return Belief(x, P, size, self.kept + update.kept, minimum(self.weakest, update.weakest)), update

    def released(self, D: list[Scalar], w: list[Array]) -> Belief:
        """Return the belief with P += sum D w w^T."""
        size = self.size
        for d, column in zip(D, w, strict=True):
            turning, moving = d * (column[:3] @ column[:3]), d * (column[3:] @ column[3:])
            size = size + array([turning, moving, moving])
        if isinstance(self.P, FactoredMobility):
            return self._replace(P=self.P.plus(D, w), size=size)
        W = array(w).T
        return self._replace(P=mirrored(self.P + (W * array(D)) @ W.T), size=size)


class Load(NamedTuple):
    """What a body of the trunk feels of everything further out.

    Attributes:
        inertia: about the body's origin.
        wrench: (6,) about it, with beta zero.
    """

    inertia: Symmetric6
    wrench: Array

    def plus(self, inertia: Symmetric6, wrench: Array) -> Load:
        """Return the sum of two loads."""
        return Load(self.inertia.plus(inertia), self.wrench + wrench)


class Crossing(NamedTuple):
    """A joint of the trunk, or its floating base, on the way back.

    Attributes:
        belief: after it.
        carried: the load on the body before.
        accelerated: beta of the body before (6,), s (6,) -> its acceleration, a number or (6,), and beta (6,).
        pivot: inertia about the joint; the smallest pivot of a floating base's, relative to its size.
    """

    belief: Belief
    carried: Load
    accelerated: Callable[[Array, Array], tuple[Array, Array]]
    pivot: Scalar


class TrunkSolution(NamedTuple):
    """What the filter finds.

    Attributes:
        found: grasp wrenches, the object's acceleration and the rank.
        trunk: how the trunk accelerates.
        betas: per body, (6,).
        pivots: (n_t,) inertias about the joints, > 0 for a proper trunk.
    """

    found: ObjectSolution
    trunk: TrunkAcceleration
    betas: list[Array]
    pivots: Array


def trunk_filter(
    trunk: TrunkMotion,
    grasps: Mapping[str, tuple[Contact, TipResponse]],
    lone: Mapping[str, TipResponse],
    body: FreeBody,
    tolerance: float = RANK_TOLERANCE,
) -> TrunkSolution:
    """Return grasp wrenches, and the accelerations of object and trunk. O(l) + O(n_t).

    Args:
        trunk: the trunk in motion.
        grasps: the arms that hold, by name: grasp, and answer at tip and base.
        lone: the answers of the arms on the trunk that hold nothing.
        body: the object.
        tolerance: relative size of a pivot that counts as zero, where the contacts say which rows are held.
    """
    about = {name: c.about(body.centre, body.centripetal) for name, (c, _) in grasps.items()}
    carried = {
        name: tip.base.seen_from(trunk.mounts[name].offset)
        for name, tip in [*((name, tip) for name, (_, tip) in grasps.items()), *lone.items()]
        if tip.base is not None
    }
    rows = {name: measurement(about[name], tip._replace(base=carried.get(name))) for name, (_, tip) in grasps.items()}
    order = {k: in_order(rows, [name for name in rows if on(trunk, name) == k]) for k in range(-1, len(trunk.bodies))}
    everyone = [name for k in reversed(order) for name in order[k]]
    freedoms = sum(len(c.grasp.free) for c in about.values())
    x = np.column_stack([body.acceleration, np.zeros((6, 6))])
    size = initial_size(body, [rows[name] for name in everyone])
    first = [*everyone, None][0]
    P = body.mobility.dense() if first is not None and rows[first].parallel else FactoredMobility(body.D, body.w)
    belief = Belief(x, P, size, freedoms, 1.0)
    load, updates, crossings = Load(zero6(), np.zeros(6)), {}, []
    for k in reversed(range(len(trunk.bodies))):
        load = load.plus(trunk.bodies[k].inertia, trunk.bodies[k].wrench)
        for name, base in carried.items():
            if on(trunk, name) == k:
                load = load.plus(base.Y, base.wrench)
        for name in order[k]:
            belief, updates[name] = belief.seen(rows[name], tolerance)
            wrench_and_inertia = updates[name].on_trunk
            load = load.plus(symmetric6(wrench_and_inertia[:, 1:]), wrench_and_inertia[:, 0])
        crossings.insert(0, crossed(trunk.bodies[k], belief, load))
        belief, load = crossings[0].belief, crossings[0].carried
    belief = belief._replace(x=belief.x[:, 0])  # what carries the trunk does not accelerate by more than was said
    for name in order[-1]:
        belief, updates[name] = belief.seen(rows[name], tolerance)

    s, found = body.wrench, {}
    for name in reversed(order[-1]):
        found[name] = updates[name].back_substitute(s)
        s = s + found[name]
    beta, betas, accelerations = np.zeros(6), [], []
    for k, crossing in enumerate(crossings):
        a, beta = crossing.accelerated(beta, s)
        accelerations.append(a)
        betas.append(beta)
        for name in reversed(order[k]):
            found[name] = updates[name].back_substitute(s, beta)
            s = s + found[name]

    P = belief.dense()
    alpha = belief.x + P @ body.wrench
    answer = ObjectSolution(
        [wrench_at_contact(about[name], found[name]) for name in rows],
        acceleration_at_C(body.centre, body.centripetal, alpha),
        symmetric6(P).mobility_shifted(-body.centre).dense(),
        belief.kept,
        belief.weakest,
        [updates[name].independent for name in rows],
    )
    of_base = accelerations.pop(0) if trunk.floats else None
    pivots = array([crossing.pivot for crossing in crossings])
    return TrunkSolution(answer, TrunkAcceleration(array(accelerations), of_base), betas, pivots)


def on(trunk: TrunkMotion, name: str) -> int:
    """Return the place of the body that an arm stands on; -1 for the world."""
    mount = trunk.mounts.get(name)
    return -1 if mount is None else mount.body


def in_order(rows: Mapping[str, Measurement], names: list[str]) -> list[str]:
    """Return the arms of one body, those first that add in parallel."""
    return [*(n for n in names if rows[n].parallel), *(n for n in names if not rows[n].parallel)]


def crossed(body: TrunkBody, belief: Belief, load: Load) -> Crossing:
    """Return the belief seen from the body before, and what it feels; see the module's equations."""
    if body.H is None:
        return set_free(belief, load)
    H, x, X = body.H, belief.x[:, 0], belief.x[:, 1:]
    felt = load.inertia.apply(H)
    assert body.joint is not None
    D = H @ felt + body.joint.armature
    G, eps, W = felt / D, body.torque - H @ load.wrench, X @ H
    before = array([shift_wrench(body.reach, row) for row in X - outer(W, G)])  # times phi^T
    seen = belief.released([1.0 / D], [W])._replace(x=np.column_stack([x + W * (eps / D), before]))
    inertia = load.inertia.plus_outer(-G, felt).inertia_shifted(body.reach)
    wrench = shift_wrench(body.reach, load.wrench + G * eps)

    def accelerated(beta: Array, s: Array) -> tuple[Array, Array]:
        carried = shift_twist(body.reach, beta)
        a = (eps + W @ s) / D - G @ carried
        return a, carried + a * H

    return Crossing(seen, Load(inertia, wrench), accelerated, D)


def set_free(belief: Belief, load: Load) -> Crossing:
    """Return the belief when the floating base is released: H = 1, D = Ia, no drive."""
    x, X = belief.x[:, 0], belief.x[:, 1:]
    D = ldl(load.inertia.dense(), np.zeros(6))  # positive definite: every pivot counts
    columns = forward_substitution(D.L, X.T)  # L^-1 X^T
    falling = -load.wrench
    x = x + X @ ldl_solve(D, falling)
    seen = belief.released([1.0 / d for d in D.pivots], list(columns))
    seen = seen._replace(x=np.column_stack([x, np.zeros((6, 6))]))

    def accelerated(beta: Array, s: Array) -> tuple[Array, Array]:
        a = ldl_solve(D, falling + s @ X)
        return a, a

    return Crossing(seen, Load(zero6(), np.zeros(6)), accelerated, D.weakest)
