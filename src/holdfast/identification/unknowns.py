"""The unknowns of the identification, in three sets of coordinates.

    free    theta = [log-Cholesky parameters; b; tilt]   any values are a possible body
    linear  x = [pi; b; tilt]                            the equations are linear in products of its entries
    plain   xi = [m; c; I about c; b; tilt]              the model's parameters, which unidentified ones keep

pi and c are relative to the model's mass centre. Gravity is tilted by g = |g| (n + E tilt) / |n + E tilt|.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.identification.equations import Settings
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.differentiation import linearised
from holdfast.spatial.inertia import PARAMETERS, RigidInertia, of_parameters
from holdfast.spatial.log_cholesky import inertia_of, numbers_of
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.vector import dot, outer

NAMES = ("mass", "com x", "com y", "com z", *(f"inertia {name[1:]}" for name in PARAMETERS[4:]))
UNITS = ("kg", *["m"] * 3, *["kg m^2"] * 6)
AXES = ("moment x", "moment y", "moment z", "force x", "force y", "force z")


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The unknowns of a chain, and their values in the model.

    Attributes:
        names: names of the entries of xi.
        units: units of the entries of xi.
        sizes: typical sizes of the entries of xi, by which they are scaled.
        model: xi of the model; offsets and tilt are 0.
        gravity: (3,) gravity of the model.
        across: (2, 3) E, unit vectors perpendicular to gravity.
        biases: number of sensor offsets.
        tilted: whether gravity's direction is unknown.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    sizes: Array
    model: Array
    gravity: Array
    across: Array
    biases: int
    tilted: bool

    @property
    def linear_sizes(self) -> Array:
        """Typical sizes of the entries of x, in which first moments replace the mass centre."""
        return np.concatenate([self.sizes[:1], self.sizes[0] * self.sizes[1:4], self.sizes[4:]])

    @property
    def start(self) -> Array:
        """Theta of the model."""
        # of the model, c and so m c are 0
        return np.concatenate([numbers_of(of_parameters(self.model[:10])), self.model[10:]])

    def linear(self, theta: Array) -> Array:
        """Return x of theta."""
        return np.concatenate([inertia_of(theta[:10]).parameters, theta[10:]])

    def plain(self, theta: Array) -> Array:
        """Return xi of theta."""
        return np.concatenate([plain_parameters(theta[:10]), theta[10:]])

    def slopes(self, theta: Array) -> tuple[Array, Array]:
        """Return dx/dtheta and dxi/dtheta."""
        text = linearised(lambda x: (inertia_of(x).parameters, plain_parameters(x)), theta[:10])
        columns = [text.rates(unit) for unit in np.eye(10)]
        found = []
        for part in zip(*columns, strict=True):
            whole = np.eye(len(theta))
            whole[:10, :10] = np.array(part).T
            found.append(whole)
        return found[0], found[1]

    def tilted_gravity(self, tilt: Array) -> tuple[Array, Array]:
        """Return gravity (3,) and its derivative (3, 2) by the tilt."""
        size = float(np.linalg.norm(self.gravity))
        v = self.gravity / size + tilt @ self.across
        s = float(np.linalg.norm(v))
        return size * v / s, size * (self.across.T / s - np.outer(v, tilt) / s**3)

    def features(self, x: Array) -> tuple[Array, Array]:
        """Return the features, by which the rows are multiplied, and their derivatives by x."""
        pi, b, one = x[:10], x[10 : 10 + self.biases], np.ones(1)
        p = len(x)
        of_b = np.eye(p)[10 : 10 + self.biases]
        if not self.tilted:
            return np.concatenate([pi, b, one]), np.vstack([np.eye(p)[:10], of_b, np.zeros((1, p))])
        g, slope = self.tilted_gravity(x[-2:])
        of_g = np.hstack([np.zeros((3, p - 2)), slope])
        of_products = np.kron(g[:, None], np.eye(10, p)) + np.kron(of_g, pi[:, None])
        values = np.concatenate([pi, np.kron(g, pi), b, one, g])
        return values, np.vstack([np.eye(10, p), of_products, of_b, np.zeros((1, p)), of_g])


def unknowns_of(chain: ClosedChain, settings: Settings, wrench_sizes: Array) -> Unknowns:
    """Return the unknowns of a chain.

    Args:
        chain: chain with the model's values.
        settings: which unknowns are requested.
        wrench_sizes: (6,) typical sizes of a sensor offset [N m, N].
    """
    body, names, units = chain.held_object, list(NAMES), list(UNITS)
    m, radius = body.mass, float(np.sqrt(np.trace(body.inertia) / (2.0 * body.mass)))
    sizes = [m, *[radius] * 3, *[m * radius**2] * 6]
    model = [m, 0.0, 0.0, 0.0, *body.inertia[np.triu_indices(3)]]
    holding = list(chain.grasps) if settings.sensor_bias else []
    for name in holding:
        names += [f"sensor offset of '{name}', {axis}" for axis in AXES]
        units += ["N m"] * 3 + ["N"] * 3
        sizes += wrench_sizes.tolist()
    across = np.zeros((2, 3))
    if settings.gravity:
        across = np.linalg.svd(chain.gravity[None, :])[2][1:]
        names += ["gravity's tilt, first", "gravity's tilt, second"]
        units, sizes = [*units, "rad", "rad"], [*sizes, 1.0, 1.0]
    model += [0.0] * (len(names) - 10)
    arrays = (np.array(sizes), np.array(model), chain.gravity, across)
    return Unknowns(tuple(names), tuple(units), *arrays, 6 * len(holding), settings.gravity)


def plain_parameters(numbers: Array) -> Array:
    """Return (10,) m, c and I about c for ten log-Cholesky parameters."""
    body = inertia_of(numbers)
    c = numbers[7:]
    about_c = body.I - body.m * (dot(c, c) * np.eye(3) - outer(c, c))
    return concatenate([array([body.m]), c, RigidInertia(body.m, body.h, about_c).parameters[4:]])
