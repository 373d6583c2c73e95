"""Clarabel on the elastic programme that the library solves."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse

from holdfast.forces.arm_block import FARTHEST
from holdfast.forces.programme_block import Block
from holdfast.spatial.scalar import Array


def cost(blocks: Sequence[Block], x: list[Array], v: float, price: float) -> float:
    """Return the objective."""
    own = sum(0.5 * y @ block.P @ y + block.c @ y for block, y in zip(blocks, x, strict=True))
    return float(own + price * v + 0.5 * v * v)


def solved(blocks: Sequence[Block], e: Array, price: float) -> tuple[list[Array], float]:
    """Return Clarabel's x of every block, and v."""
    clarabel: Any = import_module("clarabel")

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    *given, places = arguments(blocks, e, price)
    found = np.array(clarabel.DefaultSolver(*given, settings).solve().x)
    return [found[place] for place in places], float(found[-1])


def arguments(blocks: Sequence[Block], e: Array, price: float) -> tuple[Any, ...]:
    """Return P, c, A, b and cones for Clarabel's solver, and the places of the blocks' unknowns; v is the last."""
    clarabel: Any = import_module("clarabel")

    ends = np.cumsum([0, *(block.own for block in blocks)])
    shared = np.arange(ends[-1], ends[-1] + blocks[-1].shared)
    places = [np.r_[np.arange(a, b), shared] for a, b in pairwise(ends)]
    n = ends[-1] + len(shared) + 1
    P, c, E = np.zeros((n, n)), np.zeros(n), np.zeros((len(e), n))
    P[-1, -1], c[-1] = 1.0, price
    for block, place in zip(blocks, places, strict=True):
        P[np.ix_(place, place)] += block.P
        c[place] += block.c
        E[:, place] += block.E
    rows, right, cones = [E], [e], []
    cones.append(clarabel.ZeroConeT(len(e)))

    def put(G: Array, h: Array, place: Array, by_v: Array) -> None:
        A = np.zeros((len(h), n))
        A[:, place], A[:, -1] = G, -by_v
        rows.append(A)
        right.append(h)

    for block, place in zip(blocks, places, strict=True):
        G, h = np.concatenate([block.R, -block.R]), np.concatenate([block.high, -block.low])
        near = h < 0.5 * FARTHEST
        put(G[near], h[near], place, np.ones(near.sum()))
        cones.append(clarabel.NonnegativeConeT(int(near.sum())))
        for cone in block.cones:
            put(cone.G, cone.h, place, np.eye(len(cone.h))[0])
            cones.append(clarabel.SecondOrderConeT(len(cone.h)))
    put(np.zeros((1, 0)), np.zeros(1), np.zeros(0, dtype=int), np.ones(1))
    cones.append(clarabel.NonnegativeConeT(1))
    P = scipy.sparse.triu(scipy.sparse.csc_matrix(P), format="csc")
    return P, c, scipy.sparse.csc_matrix(np.vstack(rows)), np.concatenate(right), cones, places
