"""A rigid grasp in the object's filter: the parallel sum of two mobilities at C."""

from __future__ import annotations

from holdfast.dynamics.closed.measurement import Measurement, Step
from holdfast.spatial.linalg import RANK_TOLERANCE, ldl, ldl_solve
from holdfast.spatial.scalar import Array
from holdfast.spatial.symmetric import mirrored


def rigid_step(x: Array, P: Array, m: Measurement, scale: Array) -> tuple[Array, Array, Step]:
    """Return x, P after a rigidly held arm, and its step back.

    S = P + R,  Gt = S^-1 P,  nu = S^-1 (r - x);  x += P nu,  P = P S^-1 R = Gt^T R: nothing is
    subtracted, and R may be singular (beyond.md 1(b')). Null pivots of S are dropped.
    """
    S = ldl(P + m.R, scale, RANK_TOLERANCE)
    gain = ldl_solve(S, P)
    nu = ldl_solve(S, m.r - x)
    step = Step(lambda s: nu - gain @ s, S.kept, S.weakest)
    return x + P @ nu, mirrored(gain.T @ m.R), step
