"""The least time of a path as one convex programme over all nodes, by Clarabel.

minimise sum 2 D / (c_i + c_i+1) with c_i^2 <= b_i, a_i = (b_i+1 - b_i) / 2 D, and the limits in the middle of every
interval; D. Verscheure et al., Time-optimal path tracking for robots: a convex optimization approach, IEEE Transactions
on Automatic Control, 2009.
"""

import clarabel
import numpy as np
from scipy.sparse import csc_matrix, lil_matrix

from holdfast.control.timed_path import point_on_path


def least_time(points, width: float) -> float:
    """Return the least time from rest to rest for the limits in the middle of intervals of this width."""
    count = len(points)
    b, c, d = np.arange(count + 1), count + 1 + np.arange(count + 1), 2 * count + 2 + np.arange(count)
    size, rows, cones = 3 * count + 2, [], []
    rows.append(({b[0]: [1.0]}, [0.0]))
    rows.append(({b[-1]: [1.0]}, [0.0]))
    cones.append(clarabel.ZeroConeT(2))
    for i in range(count + 1):  # |(2 c, b - 1)| <= b + 1
        rows.append(({b[i]: [-1.0, 0.0, -1.0], c[i]: [0.0, -2.0, 0.0]}, [1.0, 0.0, -1.0]))
        cones.append(clarabel.SecondOrderConeT(3))
    for i in range(count):  # d (c + c') >= 2 D
        two = {c[i]: [-1.0, 0.0, 1.0], c[i + 1]: [-1.0, 0.0, 1.0], d[i]: [-1.0, 0.0, -1.0]}
        rows.append((two, [0.0, 2.0 * np.sqrt(2.0 * width), 0.0]))
        cones.append(clarabel.SecondOrderConeT(3))
    for i, point in enumerate(points):
        x = size + np.arange(point.free)
        size += point.free
        for limit in point.limits:
            scale = 1.0 / (limit.weight * point.found.force)
            G, h = scale * limit.G, scale * limit.h
            of_a, of_b = G[:, -3] / (2.0 * width), 0.5 * G[:, -2]
            rows.append(({**dict(zip(x, G.T, strict=False)), b[i]: of_b - of_a, b[i + 1]: of_b + of_a}, h))
            cones.append(clarabel.NonnegativeConeT(1) if len(h) == 1 else clarabel.SecondOrderConeT(len(h)))
    A, right = lil_matrix((sum(len(h) for _, h in rows), size)), np.concatenate([h for _, h in rows])
    at = 0
    for columns, h in rows:
        for column, values in columns.items():
            A[at : at + len(h), column] = np.reshape(values, (-1, 1))
        at += len(h)
    cost = np.zeros(size)
    cost[d] = 1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    found = clarabel.DefaultSolver(csc_matrix((size, size)), cost, csc_matrix(A), right, cones, settings).solve()
    assert str(found.status) in ("Solved", "AlmostSolved"), found.status
    return float(found.obj_val)


def limits_between(timed, limits, count: int):
    """Return the limits of a timed path in the middle of as many intervals."""
    middles = (np.arange(count) + 0.5) / count
    return [point_on_path(timed.chain, timed.route, float(u), limits) for u in middles]
