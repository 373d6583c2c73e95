"""A smooth surface through heights on a grid: ground, or a worn table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.world.shape import Distance, WorldShape
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, frozen_property
from holdfast.spatial.scalar import Array, Scalar, array, clip, maximum, sqrt, where
from holdfast.spatial.vector import outer

FOOT_STEPS = 8
MOST_SPACINGS = 1e6  # of heights: steeper ground has no digits left


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class HeightField(WorldShape):
    """All points below z = h(x, y), the bicubic spline through heights on a grid, twice continuously differentiable.

    h = sum_ij c_ij B(x / s - i) B(y / s - j),   6 B(t) = max(2 - |t|, 0)^3 - 4 max(1 - |t|, 0)^3

    The nearest point (a, b, h) has (x - a) + (z - h) h_a = 0, and so for y; Newton's method from (x, y) finds it where
    the surface is not bent more sharply than the point is away. phi = +- its distance, n the normal there, and
    S = K / (1 + phi K) with the surface's K = dn/dx. Beyond the grid the height is that of its border, which the
    surface meets with slope zero across it.

    A distance costs O(grid points), so that the text can be traced.

    Attributes:
        heights: (rows, columns) h at x = row * spacing, y = column * spacing, at least 4 of each [m].
        spacing: distance of neighbouring points of the grid, > 0 [m].
    """

    heights: ArrayField = REQUIRED
    spacing: float = REQUIRED

    def __post_init__(self) -> None:
        super().__post_init__()
        what = self.what
        heights = checks.numbers(self.heights, None, f"{what}: heights")
        if heights.ndim != 2 or min(heights.shape) < 4:
            raise ModelError(f"{what}: heights: expected shape (rows, columns) of at least (4, 4), got {heights.shape}")
        spacing = checks.number(self.spacing, f"{what}: spacing", above=0.0)
        if not (steepest := float(np.abs(heights).max())) <= MOST_SPACINGS * spacing:
            raise ModelError(
                f"{what}: heights: expected at most {MOST_SPACINGS:g} times the spacing of {spacing:g} m, got"
                f" {steepest:g} m; try another spacing, or a pose"
            )
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "spacing", spacing)

    @frozen_property
    def coefficients(self) -> Array:
        """The coefficients c, (rows + 2, columns + 2): splines are centred from one point before the grid on."""
        return _coefficients(_coefficients(self.heights).T).T

    def surface(self, a: Scalar, b: Scalar) -> tuple[Scalar, Array, Array]:
        """Return h, its gradient (2,) and its Hessian (2, 2) at a place of the grid's plane."""
        rows, columns = self.heights.shape
        X, Y = _basis(a / self.spacing, rows), _basis(b / self.spacing, columns)
        c, s = self.coefficients, 1.0 / self.spacing
        h, h_x, h_xx = (x @ c @ Y[0] for x in X)
        h_y, h_xy, h_yy = X[0] @ c @ Y[1], X[1] @ c @ Y[1], X[0] @ c @ Y[2]
        return h, s * array([h_x, h_y]), s * s * array([[h_xx, h_xy], [h_xy, h_yy]])

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        foot = x[:2]
        for _ in range(FOOT_STEPS):
            h, g, H = self.surface(foot[0], foot[1])
            left = foot - x[:2] + (h - x[2]) * g
            J = np.eye(2) + outer(g, g) + (h - x[2]) * H
            least = maximum(J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0], 0.1)  # of a point that is not too far within
            foot = foot - array([J[1, 1] * left[0] - J[0, 1] * left[1], J[0, 0] * left[1] - J[1, 0] * left[0]]) / least
        h, g, H = self.surface(foot[0], foot[1])
        size = sqrt(1.0 + g @ g)
        n = array([-g[0], -g[1], 1.0]) / size
        phi = n @ array([x[0] - foot[0], x[1] - foot[1], x[2] - h])
        # K in the tangent plane: with M the columns of the plane's basis, K = -M (M^T M)^-1 (H / size) (M^T M)^-1 M^T
        G = np.eye(2) + outer(g, g)
        inverse = array([[G[1, 1], -G[0, 1]], [-G[1, 0], G[0, 0]]]) / (size * size)
        W = inverse @ (H / size)  # -K on the basis
        one = np.eye(2) - phi * W
        scale = one[0, 0] * one[1, 1] - one[0, 1] * one[1, 0]
        adjugate = array([[one[1, 1], -one[0, 1]], [-one[1, 0], one[0, 0]]])
        B = -(adjugate @ W @ inverse) / where(scale > 0.0, scale, 1.0)
        M = array([[1.0, 0.0], [0.0, 1.0], [g[0], g[1]]])
        return Distance(phi, n, M @ B @ M.T)


def _basis(t: Scalar, count: int) -> tuple[Array, Array, Array]:
    """Return the values (count + 2,) of all splines at a place in units of the grid, and two derivatives of them."""
    inside = clip(t, 0.0, count - 1.0)
    values, slopes, bends = [], [], []
    free = where(t < 0.0, 0.0, where(t > count - 1.0, 0.0, 1.0))  # beyond the border nothing changes
    for i in range(-1, count + 1):
        d = inside - i
        sign = where(d < 0.0, -1.0, 1.0)
        far, near = maximum(2.0 - sign * d, 0.0), maximum(1.0 - sign * d, 0.0)
        values.append((far * far * far - 4.0 * near * near * near) / 6.0)
        slopes.append(free * sign * (2.0 * near * near - 0.5 * far * far))
        bends.append(free * (far - 4.0 * near))
    return array(values), array(slopes), array(bends)


def _coefficients(heights: Array) -> Array:
    """Return the coefficients (count + 2, ...) along the first axis of heights (count, ...).

    (c_(i-1) + 4 c_i + c_(i+1)) / 6 = h_i; slope zero at the ends makes c_(-1) = c_1 and c_count = c_(count-2).
    """
    count = len(heights)
    bands = np.array([np.full(count, 1.0), np.full(count, 4.0), np.full(count, 1.0)]) / 6.0
    bands[0, 1] = bands[2, -2] = 2.0 / 6.0
    from scipy.linalg import solve_banded  # imported here because it takes half a second

    c = solve_banded((1, 1), bands, heights)
    return np.concatenate([c[1:2], c, c[-2:-1]])
