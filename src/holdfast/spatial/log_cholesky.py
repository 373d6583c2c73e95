"""Ten free numbers for a rigid body: every choice of them is an inertia that some mass distribution has.

The pseudo-inertia of a body is the second moment of its mass in homogeneous coordinates,

    J = [Sigma, h; h^T, m] = U U^T,   Sigma = tr(I) / 2 1 - I,   I about the origin

positive definite if and only if mass could be spread so. U is upper triangular, made of (a, d, s, t):

    U = e^a [e^d1 s12 s13 t1; 0 e^d2 s23 t2; 0 0 e^d3 t3; 0 0 0 1]

so that m = e^2a, the mass centre is t, and d and s are the spread about it (Rucker and Wensing 2022).
"""

from __future__ import annotations

import math

import numpy as np

from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.scalar import Array, array, exp
from holdfast.spatial.symmetric import mirrored
from holdfast.spatial.vector import outer, product


def inertia_of(numbers: Array) -> RigidInertia:
    """Return the inertia about the origin that ten free numbers stand for.

    Args:
        numbers: (10,) a, d1, d2, d3, s12, s13, s23, t1, t2, t3.
    """
    a, d1, d2, d3, s12, s13, s23, *t = numbers.tolist()
    spread = array([[exp(d1), s12, s13], [0.0, exp(d2), s23], [0.0, 0.0, exp(d3)]])
    t, m = array(t), exp(2.0 * a)
    second = m * (product(spread, spread.T) + outer(t, t))
    (xx, _, _), (_, yy, _), (_, _, zz) = second.tolist()
    return RigidInertia(m, m * t, mirrored((xx + yy + zz) * np.eye(3) - second))


def numbers_of(body: RigidInertia) -> Array:
    """Return the ten numbers, (10,), of an inertia; `inertia_of` the other way.

    Raises:
        ValueError: no mass distribution of three extents has it.
    """
    if body.m <= 0.0:
        raise ValueError(f"expected a mass > 0, got {body.m!r}")
    t = body.h / body.m
    second = (0.5 * np.trace(body.I) * np.eye(3) - body.I) / body.m - np.outer(t, t)
    try:
        lower = np.linalg.cholesky(second[::-1, ::-1])  # from the last axis on: U U^T instead of L L^T
    except np.linalg.LinAlgError as cause:
        raise ValueError("expected principal moments of which any two sum to more than the third") from cause
    U = lower[::-1, ::-1]
    d = [math.log(x) for x in np.diag(U).tolist()]
    return np.array([0.5 * math.log(body.m), *d, U[0, 1], U[0, 2], U[1, 2], *t])
