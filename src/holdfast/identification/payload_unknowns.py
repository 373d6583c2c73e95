"""The unknowns of a payload: the entries of xi and x, the features that equations have of them, and plain values.

The unknowns have two sets of coordinates. The equations are linear in products of the entries of x = [pi; b; tilt];
plain quantities

    xi = [m; c; I about c; b; tilt]

are reported, and keep the model's values where they are not identified. c is relative to the model's mass centre.
Gravity is tilted by g = |g| (n + E tilt) / |n + E tilt|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.inertia import PARAMETERS
from holdfast.spatial.scalar import Array

PARAMETER_NAMES = ("mass", "com x", "com y", "com z", *(f"inertia {name[1:]}" for name in PARAMETERS[4:]))
WRENCH_AXES = ("moment x", "moment y", "moment z", "force x", "force y", "force z")
ENTRIES = np.triu_indices(3)  # of I among the parameters


@dataclass(frozen=True)
class Settings:
    """What is to be found besides the payload.

    Attributes:
        source: "wrist_wrench" or "tau".
        sensor_bias: whether wrist sensors have offsets.
        gravity: whether gravity's direction is unknown.
    """

    source: str
    sensor_bias: bool
    gravity: bool


@dataclass(frozen=True, eq=False)
class PayloadUnknowns:
    """The unknowns of a chain, and their values in the model.

    Attributes:
        names: names of the entries of xi.
        sizes: typical sizes of the entries of xi, by which they are scaled.
        model: xi of the model, and x, since c is 0; offsets and tilt are 0.
        gravity: (3,) gravity of the model.
        across: (2, 3) E, unit vectors perpendicular to gravity.
        biases: number of sensor offsets.
        tilted: whether gravity's direction is unknown.
    """

    names: tuple[str, ...]
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

    def sized(self, mass: float, radius: float) -> PayloadUnknowns:
        """Return the unknowns with the sizes of a body of a mass and a radius of gyration."""
        own = [mass, *[radius] * 3, *[mass * radius**2] * 6]
        return replace(self, sizes=np.concatenate([own, self.sizes[10:]]))

    def plain(self, x: Array) -> Array:
        """Return xi of x."""
        return np.concatenate([plain_body(x[:10]), x[10:]])

    def slopes(self, x: Array) -> Array:
        """Return dxi/dx, (p, p), which is triangular."""
        found = np.eye(len(x))
        found[:10, :10] = plain_slopes(x[:10])
        return found

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


def plain_body(pi: Array) -> Array:
    """Return m, c and I about c of the ten inertial parameters of a body, (10,)."""
    m, h = pi[0], pi[1:4]
    return np.concatenate([[m], h / m, pi[4:10] - (h @ h * np.eye(3) - np.outer(h, h))[ENTRIES] / m])


def plain_slopes(pi: Array) -> Array:
    """Return the derivatives of `plain_body` by pi, (10, 10), which are triangular."""
    m, h, found = pi[0], pi[1:4], np.eye(10)
    found[1:4, 0], found[1:4, 1:4] = -h / m**2, np.eye(3) / m
    found[4:10, 0] = (h @ h * np.eye(3) - np.outer(h, h))[ENTRIES] / m**2
    for k, e in enumerate(np.eye(3)):
        found[4:10, 1 + k] = -(2.0 * h[k] * np.eye(3) - np.outer(e, h) - np.outer(h, e))[ENTRIES] / m
    return found


def unknowns_of(chain: ClosedChain, settings: Settings, wrench_sizes: Array) -> PayloadUnknowns:
    """Return the unknowns of a chain.

    Args:
        chain: chain with the model's values.
        settings: which unknowns are requested.
        wrench_sizes: (6,) typical sizes of a sensor offset [N m, N].
    """
    body, names = chain.held_object, list(PARAMETER_NAMES)
    m, radius = body.mass, float(np.sqrt(np.trace(body.inertia) / (2.0 * body.mass)))
    sizes = [m, *[radius] * 3, *[m * radius**2] * 6]
    model = [m, 0.0, 0.0, 0.0, *body.inertia[ENTRIES]]
    holding = list(chain.grasps) if settings.sensor_bias else []
    for name in holding:
        names += [f"sensor offset of '{name}', {axis}" for axis in WRENCH_AXES]
        sizes += wrench_sizes.tolist()
    across = np.zeros((2, 3))
    if settings.gravity:
        across = np.linalg.svd(chain.gravity[None, :])[2][1:]
        names += ["gravity's tilt, first", "gravity's tilt, second"]
        sizes += [1.0, 1.0]
    model += [0.0] * (len(names) - 10)
    arrays = (np.array(sizes), np.array(model), chain.gravity, across)
    return PayloadUnknowns(tuple(names), *arrays, 6 * len(holding), settings.gravity)
