"""Streams of random numbers by the generator MRG32k3a, whose arithmetic is exact in float64.

    x_k = (1403580 x_(k-2) - 810728 x_(k-3)) mod m1
    y_k = (527612 y_(k-1) - 1370589 y_(k-3)) mod m2
    u_k = ((x_k - y_k) mod m1) / (m1 + 1), or m1 / (m1 + 1) if this is 0

All products and sums are integers below 2^53. A control law can therefore draw numbers in machine code, with the bits
that Python computes, and keep the state of its stream, six numbers, in its memory. Streams are 2^127 draws apart.

Reference:
    L'Ecuyer 1999, Good parameters and implementations for combined multiple recursive random number generators.
    L'Ecuyer, Simard, Chen, Kelton 2002, An object-oriented random-number package with many long streams and substreams.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from holdfast.spatial.scalar import Array, Scalar, array, concatenate, cos, rint, scan, sin, sqrt, where

STATE_SIZE = 6
MODULI = 4294967087, 4294944443
TRANSITIONS = (
    ((0, 1, 0), (0, 0, 1), (-810728, 1403580, 0)),
    ((0, 1, 0), (0, 0, 1), (-1370589, 0, 527612)),
)
STREAM_BITS = 63
LOG_SPACING = 127  # logarithm to base 2 of the number of draws from one stream to the next
TERMS = 16  # of the logarithm's series


def stream_states(seed: int, streams: ArrayLike) -> Array:
    """Return the states at which streams begin, (streams, 6).

    Args:
        seed: the seed, an integer >= 0, from which `numpy.random.SeedSequence` makes the state of stream 0.
        streams: (streams,) numbers of the streams, integers from 0 to 2^63 - 1.
    """
    numbers = np.atleast_1d(np.asarray(streams, dtype=np.uint64))
    words = np.random.SeedSequence(seed).generate_state(STATE_SIZE, np.uint64)
    halves = []
    for k, m in enumerate(MODULI):
        modulus = np.uint64(m)
        half = np.tile(1 + words[3 * k : 3 * k + 3] % np.uint64(m - 1), (len(numbers), 1))
        for bit, jump in enumerate(_jumps(k)):
            rows = np.flatnonzero(numbers >> np.uint64(bit) & np.uint64(1))
            if len(rows):
                products = half[rows, None, :] * jump % modulus  # factors below 2^32
                half[rows] = products.sum(axis=2) % modulus
        halves.append(half)
    return np.concatenate(halves, axis=1).astype(float)


@cache
def _jumps(k: int) -> tuple[Array, ...]:
    """Return the matrices (3, 3) that take one of the two recurrences 1, 2, 4 ... streams further."""
    power, found = np.array(TRANSITIONS[k], dtype=object), []
    for squared in range(LOG_SPACING + STREAM_BITS):
        if squared >= LOG_SPACING:
            found.append(power.astype(np.uint64))
        power = power @ power % MODULI[k]
    return tuple(found)


def normals(state: Array, count: int) -> tuple[Array, Array]:
    """Return numbers from the normal distribution of variance 1, (count,), and the stream's state after them.

    Two numbers are made of two draws by the method of Box and Muller; the largest is 6.7.

    Args:
        state: (6,) state of the stream.
        count: how many numbers.
    """
    if count == 0:
        return np.zeros(0), state

    def pair(x: list[Scalar], _: int) -> tuple[list[Scalar], list[Scalar]]:
        x, first = uniform(x)
        x, second = uniform(x)
        radius, angle = sqrt(-2.0 * _log(first)), 2.0 * math.pi * second
        return x, [radius * cos(angle), radius * sin(angle)]

    last, pairs = scan(pair, list(state), range((count + 1) // 2))
    return concatenate([array(one) for one in pairs])[:count], array(last)


def uniform(x: Sequence[Scalar]) -> tuple[list[Scalar], Scalar]:
    """Return the state of a stream after a draw, and the draw, a number between 0 and 1."""
    a = _remainder(1403580.0 * x[1] - 810728.0 * x[0], MODULI[0])
    b = _remainder(527612.0 * x[5] - 1370589.0 * x[3], MODULI[1])
    apart = a - b
    u = where(apart > 0.0, apart, apart + float(MODULI[0])) * (1.0 / (MODULI[0] + 1))
    return [x[1], x[2], a, x[4], x[5], b], u


def _remainder(x: Scalar, m: int) -> Scalar:
    """Return x mod m of an integer |x| < 2^53; the quotient may be rounded to either side."""
    rest = x - float(m) * rint(x * (1.0 / m))
    return where(rest < 0.0, rest + float(m), rest)


def _log(u: Scalar) -> Scalar:
    """Return the logarithm of a number between 2^-32 and 1: log(2^k u) - k log 2, by the series of artanh."""
    scaled = 0.0
    for k in (16, 8, 4, 2, 1):  # 2^k u is at least 1/2 afterwards
        small = u < 2.0**-k
        u, scaled = where(small, 2.0**k * u, u), where(small, scaled + k, scaled)
    z = (u - 1.0) / (u + 1.0)
    total = 0.0
    for k in reversed(range(TERMS)):
        total = total * (z * z) + 1.0 / (2 * k + 1)
    return 2.0 * z * total - math.log(2.0) * scaled
