"""Distributions of the parameters of runs; a draw is a function of the seed, the parameter's name and the run."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.real_numbers import numbers
from holdfast.spatial.scalar import Array

PER_COUNT = 4  # 64-bit numbers that Philox computes from one counter


def uniforms(seed: int, name: str, begin: int, end: int, width: int) -> Array:
    """Return the uniform random numbers in [0, 1) of some runs, (end - begin, width).

    They are computed by Philox from a key and a counter, so that those of a run do not depend on other runs.

    Args:
        seed: seed of the sweep.
        name: name of the parameter.
        begin: number of the first run.
        end: number of the run after the last.
        width: number of random numbers per run.

    Reference:
        Salmon, Moraes, Dror, Shaw 2011, Parallel random numbers: as easy as 1, 2, 3.
    """
    counts = -(-width // PER_COUNT)
    key = np.frombuffer(hashlib.sha256(f"{seed} {name}".encode()).digest()[:16], dtype="<u8")
    source = np.random.Philox(key=key.astype(np.uint64))
    source.advance(begin * counts)
    return np.random.Generator(source).random((end - begin, counts * PER_COUNT))[:, :width]


@called
@dataclass(frozen=True, eq=False)
class Uniform(Frozen):
    """Independent uniform distributions of all entries.

    Attributes:
        low: lower bound, in the shape of the parameter, or one number for all entries.
        high: upper bound, likewise.
    """

    low: Any
    high: Any

    def width(self, shape: tuple[int, ...]) -> int:
        """Return the number of uniform random numbers per draw."""
        return int(np.prod(shape))

    def values(self, name: str, shape: tuple[int, ...], u: Array) -> Array:
        """Return draws, (runs, *shape), from uniform numbers (runs, width).

        Raises:
            StateError: the bounds have another shape, are not finite, or are in the wrong order.
        """
        low, high = fitted(f"{name}: low", self.low, shape), fitted(f"{name}: high", self.high, shape)
        if not (low <= high).all():
            raise StateError(
                f"{name}: expected low <= high, got Uniform({checks.short(self.low)}, {checks.short(self.high)})"
            )
        with np.errstate(over="ignore"):
            return _finite(name, low + (high - low) * u.reshape(-1, *shape))


@called
@dataclass(frozen=True, eq=False)
class Normal(Frozen):
    """Independent normal distributions of all entries.

    Attributes:
        mean: mean, in the shape of the parameter, or one number for all entries.
        deviation: standard deviation, likewise.
    """

    mean: Any
    deviation: Any

    def width(self, shape: tuple[int, ...]) -> int:
        """Return the number of uniform random numbers per draw."""
        return int(np.prod(shape))

    def values(self, name: str, shape: tuple[int, ...], u: Array) -> Array:
        """Return draws, (runs, *shape), from uniform numbers (runs, width).

        Raises:
            StateError: the numbers have another shape or are not finite, or a deviation is negative.
        """
        from scipy.special import ndtri

        mean = fitted(f"{name}: mean", self.mean, shape)
        deviation = fitted(f"{name}: deviation", self.deviation, shape)
        if not (deviation >= 0.0).all():
            raise StateError(f"{name}: expected a deviation >= 0, got {checks.short(self.deviation)}")
        with np.errstate(over="ignore"):
            return _finite(name, mean + deviation * ndtri(np.maximum(u, 2.0**-54)).reshape(-1, *shape))


@called
@dataclass(frozen=True, eq=False)
class NearPose(Frozen):
    """Poses near given ones, rotated and displaced in their own axes by uniformly distributed coordinates.

    Attributes:
        pose: poses wxyz_xyz, in the shape of the parameter, (..., 7).
        turn: largest coordinate of the rotation vector [rad].
        shift: largest coordinate of the displacement [m].
    """

    pose: Any
    turn: float = 0.0
    shift: float = 0.0

    def width(self, shape: tuple[int, ...]) -> int:
        """Return the number of uniform random numbers per draw, six per pose."""
        return int(np.prod(shape[:-1])) * 6

    def values(self, name: str, shape: tuple[int, ...], u: Array) -> Array:
        """Return draws, (runs, *shape), from uniform numbers (runs, width).

        Raises:
            StateError: the parameter is not a pose, or the numbers have another shape, are not finite or are negative.
        """
        if shape[-1:] != (7,):
            raise StateError(
                f"{name}: expected numbers or a distribution of shape {shape}, got NearPose: it is no pose"
            )
        pose = fitted(f"{name}: pose", self.pose, shape)
        size = np.repeat([float(fitted(f"{name}: {n}", getattr(self, n), ())) for n in ("turn", "shift")], 3)
        if not (size >= 0.0).all():
            raise StateError(
                f"{name}: expected turn and shift >= 0, got {checks.short(self.turn)} and {checks.short(self.shift)}"
            )
        with np.errstate(all="ignore"):
            return _finite(name, _near(name, pose, size * (2.0 * u.reshape(-1, *shape[:-1], 6) - 1.0)))


ParameterDistribution = Uniform | Normal | NearPose


def _finite(name: str, draws: Array) -> Array:
    """Return draws after checking that they are finite.

    Raises:
        StateError: some are not finite.
    """
    if not np.isfinite(draws).all():
        raise StateError(
            f"{name}: expected a distribution of finite numbers, got one that overflows; try a narrower one"
        )
    return draws


def _near(name: str, pose: Array, away: Array) -> Array:
    """Return poses (..., 7) rotated and displaced in their own axes by coordinates (runs, ..., 6).

    Raises:
        StateError: a quaternion has length zero.
    """
    norm = np.linalg.norm(pose[..., :4], axis=-1, keepdims=True)
    if not (norm > 0.0).all():
        raise StateError(f"{name}: pose: expected quaternions (wxyz first), got one of length zero")
    wxyz = np.broadcast_to(pose[..., :4] / norm, (len(away), *pose.shape[:-1], 4))
    half = 0.5 * np.linalg.norm(away[..., :3], axis=-1, keepdims=True)
    turned = _product(wxyz, np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * away[..., :3]], axis=-1))
    vector, scalar = wxyz[..., 1:], wxyz[..., :1]
    across = 2.0 * np.cross(vector, away[..., 3:])
    moved = away[..., 3:] + scalar * across + np.cross(vector, across)
    return np.concatenate([turned, pose[..., 4:] + moved], axis=-1)


def _product(a: Array, b: Array) -> Array:
    """Return the quaternion product of arrays of wxyz."""
    w = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    xyz = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w, xyz], axis=-1)


def fitted(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return finite numbers, broadcast to a shape.

    Raises:
        StateError: the values are not finite numbers, or do not have this shape.
    """
    x = numbers(value, None, name, StateError)
    if x.shape not in ((), shape):
        raise StateError(f"{name}: expected one number or shape {shape}, got shape {x.shape}")
    return np.broadcast_to(x, shape)
