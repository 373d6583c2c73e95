"""Derivatives at a point as a rule that a recorded text goes by (`spatial.differentiation.by_rule`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.forward_derivatives import backward, forward
from holdfast.dynamics.closed.forward_jacobian import gradient_shapes, jacobian, units_needed
from holdfast.dynamics.closed.second_solve import Point
from holdfast.spatial.rotation import quaternion_product
from holdfast.spatial.scalar import Array, array, concatenate


class PointRule(NamedTuple):
    """Derivatives of some results at a point by some arguments.

    Attributes:
        at: the point.
        results: shapes by name, as `forward` returns them.
        arguments: as `backward` names them.
        poses: of the arguments that are poses wxyz_xyz, not tangents of them.
    """

    at: Point
    results: Mapping[str, tuple[int, ...]]
    arguments: tuple[str, ...]
    poses: Mapping[str, Array]

    def rates(self, *rates: Array) -> Sequence[Array]:
        """Return how fast the results change while the arguments do."""
        tangents = {}
        for name, rate in zip(self.arguments, rates, strict=True):
            if not vanishes(rate):
                tangents[name] = motion_of(self.poses[name], rate) if name in self.poses else rate
        if not tangents:
            return [np.zeros(shape) for shape in self.results.values()]
        found = forward(self.at, tangents)
        return [found[name] for name in self.results]

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) by every argument."""
        given = {name: x for name, x in zip(self.results, cotangents, strict=True) if not vanishes(x)}
        shapes = gradient_shapes(self.at.motion.chain)
        if not given:
            found = {name: np.zeros(shapes[name]) for name in self.arguments}
        else:
            found = backward(self.at, given, self.arguments)
        return [
            by_pose(self.poses[name], found[name]) if name in self.poses else found[name].reshape(shapes[name])
            for name in self.arguments
        ]

    def whole(self) -> JacobianRule:
        """Return the same on floats by the Jacobian, found once for many products."""
        shapes = gradient_shapes(self.at.motion.chain)
        units = np.eye(units_needed(self.at.motion.chain, self.arguments)) if self.arguments else np.zeros((0, 0))
        found = jacobian(self.at, list(self.results), self.arguments, units)
        blocks = {}
        for (of, by), rows in found.items():
            block = np.asarray(rows, dtype=float).reshape(-1, math.prod(self.results[of])).T
            if by in self.poses:
                block = np.array([by_pose(self.poses[by], row) for row in block])
            blocks[of, by] = block
        sizes = [self.poses[name].shape if name in self.poses else shapes[name] for name in self.arguments]
        matrix = np.block([[blocks[of, by] for by in self.arguments] for of in self.results])
        return JacobianRule(matrix, tuple(self.results.values()), tuple(sizes))


class JacobianRule(NamedTuple):
    """Derivatives of results by arguments as a matrix.

    Attributes:
        matrix: rows are entries of the results, columns those of the arguments.
        results: shapes.
        arguments: likewise.
    """

    matrix: Array
    results: tuple[tuple[int, ...], ...]
    arguments: tuple[tuple[int, ...], ...]

    def rates(self, *rates: Array) -> Sequence[Array]:
        """Return how fast the results change while the arguments do."""
        return _parts(self.matrix @ np.concatenate([np.ravel(x) for x in rates]), self.results)

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) by every argument."""
        return _parts(np.concatenate([np.ravel(x) for x in cotangents]) @ self.matrix, self.arguments)


def _parts(x: Array, shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Return one vector as arrays of some shapes."""
    ends = np.cumsum([0, *(math.prod(shape) for shape in shapes)])
    return [x[a:b].reshape(shape) for a, b, shape in zip(ends, ends[1:], shapes, strict=False)]


def vanishes(x: Array) -> bool:
    """Return whether an array is known to be zero."""
    return all(isinstance(entry, float | int) and entry == 0.0 for entry in np.asarray(x).ravel().tolist())


def motion_of(pose: Array, rate: Array) -> Array:
    """Return [turn; shift] of a pose wxyz_xyz that changes at a rate (7,): twice the vector of its own quaternion."""
    w, x, y, z = pose[:4]
    turned = quaternion_product(rate[:4], array([w, -x, -y, -z]))
    return concatenate([2.0 * turned[1:], rate[4:]])


def by_pose(pose: Array, by_motion: Array) -> Array:
    """Return the gradient (7,) by a pose wxyz_xyz of what has a gradient (6,) by its [turn; shift]."""
    turned = quaternion_product(concatenate([np.zeros(1), by_motion[:3]]), pose[:4])
    return concatenate([2.0 * turned, by_motion[3:]])
