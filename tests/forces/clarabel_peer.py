"""Clarabel on the elastic programme that the library solves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import scipy.linalg
import scipy.sparse

from holdfast.forces import elastic_distribution, elastic_programme
from holdfast.forces.programme_block import Block
from holdfast.spatial.scalar import Array


def cost(blocks: list[Block], x: list[Array], v: float, price: float) -> float:
    """Return the objective."""
    own = sum(0.5 * y @ block.P @ y + block.c @ y for block, y in zip(blocks, x, strict=True))
    return float(own + price * v + 0.5 * v * v)


def solved(blocks: list[Block], e: Array, price: float) -> tuple[list[Array], float]:
    """Return Clarabel's x of every block, and v."""
    import clarabel

    sizes = [len(block.c) for block in blocks]
    places = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    n = sum(sizes) + 1
    P = scipy.sparse.csc_matrix(np.triu(scipy.linalg.block_diag(*(block.P for block in blocks), 1.0)))
    rows, right, cones = [np.hstack([*(block.E for block in blocks), np.zeros((len(e), 1))])], [e], []
    cones.append(clarabel.ZeroConeT(len(e)))

    def put(G: Array, h: Array, place: Array, by_v: Array) -> None:
        A = np.zeros((len(h), n))
        A[:, place], A[:, -1] = G, -by_v
        rows.append(A)
        right.append(h)

    for block, place in zip(blocks, places, strict=True):
        G, h = np.concatenate([block.R, -block.R]), np.concatenate([block.high, -block.low])
        near = h < 0.5 * elastic_distribution.UNLIMITED
        put(G[near], h[near], place, np.ones(near.sum()))
        cones.append(clarabel.NonnegativeConeT(int(near.sum())))
        for cone in block.cones:
            put(cone.G, cone.h, place, np.eye(len(cone.h))[0])
            cones.append(clarabel.SecondOrderConeT(len(cone.h)))
    put(np.zeros((1, 0)), np.zeros(1), np.zeros(0, dtype=int), np.ones(1))
    cones.append(clarabel.NonnegativeConeT(1))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    c = np.concatenate([*(block.c for block in blocks), [price]])
    A = scipy.sparse.csc_matrix(np.vstack(rows))
    found = np.array(clarabel.DefaultSolver(P, c, A, np.concatenate(right), cones, settings).solve().x)
    return [found[place] for place in places], float(found[-1])


@contextmanager
def elastic_by_clarabel(monkeypatch) -> Iterator[list[Array]]:
    """Within the block, let Clarabel solve every elastic programme beside the library.

    The list receives two arrays, cost and v, of the library and of Clarabel.
    """
    compared: list[Array] = []

    def both(blocks, e, price, iterations):
        ours = elastic_programme.solve(blocks, e, price, iterations)
        x, v = solved(blocks, e, price)
        compared.append(np.array([cost(blocks, ours.x, ours.v, price), ours.v]))
        compared.append(np.array([cost(blocks, x, v, price), v]))
        return ours

    with monkeypatch.context() as patched:
        patched.setattr(elastic_distribution, "solve", both)
        yield compared
