"""Derivatives at a point as a rule for the differentiation of surrounding code (`spatial.differentiation.by_rule`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.forward_derivatives import backward, forward
from holdfast.dynamics.closed.forward_jacobian import jacobian, units_needed
from holdfast.dynamics.closed.second_solve import Point
from holdfast.questions.arrays import gradient_shapes
from holdfast.spatial.linear import arrays_of
from holdfast.spatial.rotation import quaternion_product
from holdfast.spatial.scalar import Array, array, concatenate


class PointRule(NamedTuple):
    """Derivatives of some results at a point with respect to some arguments.

    Attributes:
        at: the point.
        results: shapes of the results by name, as returned by `forward`.
        arguments: names of the arguments, as for `backward`.
        poses: values of the arguments that are poses wxyz_xyz, and not tangents of poses.
    """

    at: Point
    results: Mapping[str, tuple[int, ...]]
    arguments: tuple[str, ...]
    poses: Mapping[str, Array]

    def rates(self, *rates: Array) -> Sequence[Array]:
        """Return the rates of the results for given rates of the arguments."""
        tangents = {}
        for name, rate in zip(self.arguments, rates, strict=True):
            if not vanishes(rate):
                tangents[name] = motion_of(self.poses[name], rate) if name in self.poses else rate
        if not tangents:
            return [np.zeros(shape) for shape in self.results.values()]
        found = forward(self.at, tangents)
        return [found[name] for name in self.results]

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) with respect to every argument."""
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
        """Return an equivalent rule that computes the Jacobian once, for many products on floats."""
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
    """Derivatives of results with respect to arguments, as a matrix.

    Attributes:
        matrix: rows are the entries of the results, columns those of the arguments.
        results: shapes of the results.
        arguments: shapes of the arguments.
    """

    matrix: Array
    results: tuple[tuple[int, ...], ...]
    arguments: tuple[tuple[int, ...], ...]

    def rates(self, *rates: Array) -> Sequence[Array]:
        """Return the rates of the results for given rates of the arguments."""
        return arrays_of((self.matrix @ np.concatenate([np.ravel(x) for x in rates])).tolist(), self.results)

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) with respect to every argument."""
        return arrays_of((np.concatenate([np.ravel(x) for x in cotangents]) @ self.matrix).tolist(), self.arguments)


def vanishes(x: Array) -> bool:
    """Return whether an array is known to be zero."""
    return all(isinstance(entry, float | int) and entry == 0.0 for entry in np.asarray(x).ravel().tolist())


def motion_of(pose: Array, rate: Array) -> Array:
    """Return [turn; shift] of a pose wxyz_xyz with the given rate (7,); turn is twice the vector part of q_dot q^-1."""
    w, x, y, z = pose[:4]
    turned = quaternion_product(rate[:4], array([w, -x, -y, -z]))
    return concatenate([2.0 * turned[1:], rate[4:]])


def by_pose(pose: Array, by_motion: Array) -> Array:
    """Return the gradient (7,) with respect to a pose wxyz_xyz from the gradient (6,) by its [turn; shift]."""
    turned = quaternion_product(concatenate([np.zeros(1), by_motion[:3]]), pose[:4])
    return concatenate([2.0 * turned, by_motion[3:]])
