"""Derivatives of a forest's forward dynamics by dual numbers over the equations in which nothing is eliminated.

The equations of `ForestEquations` are linear in the unknowns x. With their coefficients and right-hand sides of dual
numbers, along every direction of the arguments at once,

    K x = b,     K dx = db - dK x

x is solved for in fifty digits. Nothing is differentiated through a solver, and no recursion of the library is used.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.spatial.frozen import changed
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import cos, sin
from tests.oracles.arithmetic import Arithmetic
from tests.oracles.arm_kinematics import cross_matrix
from tests.oracles.chain_derivatives import symmetric_basis
from tests.oracles.forest_equations import ForestEquations
from tests.spatial.dual import tangents_of, values_of, with_tangents
from tests.systems.random_forests import ForestProblem


class ForestDerivatives(NamedTuple):
    """Partial derivatives of forward dynamics.

    Attributes:
        at: by argument, where its directions lie among all; inertias have six.
        matrices: by result, (size, directions).
    """

    at: dict[str, slice]
    matrices: dict[str, np.ndarray]


def forest_derivatives(p: ForestProblem, by: tuple[str, ...]) -> ForestDerivatives:
    """Return derivatives by some arguments, in which rows that follow from others are left out."""
    plain = ForestEquations(*p[1:], digits=50)
    dependent = plain.judged()[1]
    kept = [i for i in range(len(plain.system.rows)) if i not in dependent]
    with plain.numbers.precision():
        x = plain.system.solved(kept).astype(float)
    seeded, at, count = with_directions(p, by)
    dual = ForestEquations(*seeded, numbers=DUALS)
    system, slopes = dual.system, np.zeros((len(x), count))
    for i in kept:
        of_row = tangents_of(np.array([system.rhs[i]]), count)[0]
        terms = [(j, value) for j, value in system.rows[i].items() if x[j] != 0.0]
        coefficients = tangents_of(np.array([value for _, value in terms], dtype=object), count)
        slopes[i] = of_row - np.array([x[j] for j, _ in terms]) @ coefficients
    K = plain.system.floats(kept, kept)
    lu = splu(K)
    dx = np.zeros((len(x), count))
    for _ in range(3):
        dx[kept] += lu.solve(slopes[kept] - K @ dx[kept])
    rates = np.concatenate([dx[a] if part is None else dx[part] for a, part in zip(dual.alpha, dual.qdd, strict=True)])
    wrench = [np.zeros((0, count))]
    for K_of, part in zip(dual.K, dual.closures, strict=True):
        turned = np.einsum("ijd,i->jd", tangents_of(K_of, count), x[part])
        wrench.append(turned + values_of(K_of).astype(float).T @ dx[part])
    coupled = [dx[part] for part in dual.couplings]
    return ForestDerivatives(
        at,
        {
            "qdd": rates,
            "acceleration": np.concatenate([dx[a] for a in dual.alpha]),
            "closure_wrench": np.concatenate(wrench),
            "coupling_force": np.concatenate([np.zeros((0, count)), *coupled]),
        },
    )


def with_directions(p: ForestProblem, by: tuple[str, ...]) -> tuple[tuple, dict[str, slice], int]:
    """Return the arguments of `ForestEquations` with a tangent along every direction, and where these are."""
    forest, values = p.forest, ForestArguments(*p[1:]).values(by)
    at, count = {}, 0
    for name, x in values.items():
        size = 6 * len(x) if name == "link_inertia" else x.size
        at[name] = slice(count, count + size)
        count += size

    def seeded(name: str, x: np.ndarray, tangents: np.ndarray | None = None) -> np.ndarray:
        if name not in at:
            return x
        whole = np.zeros((*np.shape(x), count))
        own = np.eye(np.size(x)).reshape(*np.shape(x), -1) if tangents is None else tangents
        whole[..., at[name]] = own
        return with_tangents(np.asarray(x, dtype=float), whole)

    def q() -> np.ndarray:
        tangents = np.zeros((len(p.q), forest.velocity_count))
        for body, a, v in zip(forest.bodies, forest.positions, forest.velocities, strict=True):
            if body.joint.of_kind.pose:
                w, *u = p.q[a][:4]
                turned = 0.5 * np.vstack([-np.array(u), w * np.eye(3) - cross_matrix(np.array(u))])
                tangents[a.start : a.start + 4, v.start : v.start + 3] = turned
                tangents[a.start + 4 : a.stop, v.start + 3 : v.stop] = np.eye(a.stop - a.start - 4)
            else:
                tangents[a, v] = np.eye(v.stop - v.start)
        return seeded("q", p.q, tangents)

    def pose(name: str, frame: Pose, row: int) -> Pose:
        if name not in at:
            return frame
        whole = np.zeros((12, count))
        turned = [(cross_matrix(unit) @ frame.R).ravel() for unit in np.eye(3)]
        start = at[name].start + 6 * row
        whole[:9, start : start + 3] = np.array(turned).T
        whole[9:, start + 3 : start + 6] = np.eye(3)
        found = with_tangents(np.concatenate([frame.R.ravel(), frame.p]), whole)
        return Pose.unchecked(found[:9].reshape(3, 3), found[9:])

    masses, coms, armatures, dampings = (
        seeded(name, values.get(name, ForestArguments(*p[1:]).values([name])[name]))
        for name in ("link_mass", "link_com", "armature", "damping")
    )
    bodies = []
    for k, body in enumerate(forest.bodies):
        inertia = body.link.inertia
        if "link_inertia" in at:
            whole, start = np.zeros((3, 3, count)), at["link_inertia"].start + 6 * k
            whole[..., start : start + 6] = np.moveaxis(symmetric_basis(), 0, -1)
            inertia = with_tangents(inertia, whole)
        link = changed(body.link, mass=masses[k], com=coms[k], inertia=inertia)
        joint = changed(body.joint, armature=armatures[k], damping=dampings[k])
        if not body.joint.of_kind.floats:
            joint = changed(joint, placement=pose("joint_pose", joint.placement, k))
        bodies.append(changed(body, link=link, joint=joint))
    closures = [
        changed(c, tip=pose("tip_pose", c.tip, i), grasp=changed(c.grasp, frame=pose("grasp_pose", c.grasp.frame, i)))
        for i, c in enumerate(forest.closures)
    ]
    varied = changed(forest, bodies=tuple(bodies), closures=tuple(closures), gravity=seeded("gravity", forest.gravity))
    further = (seeded(name, x) for name, x in (("qd", p.qd), ("tau", p.tau), ("link_wrench", p.wrenches)))
    return (varied, q(), *further), at, count


def _array(values) -> np.ndarray:
    found = np.asarray(values)
    return found if found.dtype == object else found.astype(float)


DUALS = Arithmetic(_array, sin, cos, lambda *_: None, nullcontext)
