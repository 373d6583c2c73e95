"""Derivatives as matrices, in blocks: one row an output, one column a direction; and products with them.

Outputs and directions are flat, in the order of `tests.oracles.chain_derivatives`: an inertia has six.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast import State
from tests.derivatives.stored import gaps
from tests.oracles.chain_derivatives import INERTIAS, OUTPUTS, SYMMETRIC, Derivatives, names_of, symmetric_basis
from tests.systems.as_chain import Problem
from tests.systems.problems import relative_gap

STATE = ("q", "qd", "tau", "object_pose", "object_twist")
NAMES = (
    *("q", "qd", "tau", "object_pose", "object_twist", "object_wrench", "gravity", "object_mass", "object_com"),
    *("object_inertia", "grasp_pose", "base_pose", "base_twist", "base_acceleration", "link_mass", "link_com"),
    *("link_inertia", "link_wrench", "armature", "damping"),
)


def names_for(p: Problem) -> tuple[str, ...]:
    """Return what a problem's derivatives are taken by: all that its oracle knows."""
    return names_of(p.chain)


def compiled(p: Problem) -> Any:
    """Return a problem's chain as machine code, with every parameter."""
    return hf.compile(p.chain, parameters=("link_inertia", "link_wrench"))


def given(p: Problem) -> dict[str, np.ndarray]:
    """Return a problem's numbers by the names of arguments and parameters; those of the chain itself are left out."""
    s, i = p.state, p.inputs.shaped(p.chain)
    numbers = {"q": s.q, "qd": s.qd, "tau": p.tau, "object_pose": s.object_pose, "object_twist": s.object_twist}
    acting: dict[str, np.ndarray | None] = {
        "object_wrench": i.object_wrench,
        "link_wrench": i.link_wrenches,
        "base_twist": i.base_twists,
        "base_acceleration": i.base_accelerations,
        "trunk_link_wrench": i.trunk_link_wrenches,
        "trunk_base_twist": i.trunk_base_twist,
        "trunk_base_acceleration": i.trunk_base_acceleration,
        "floating_pose": s.base_pose,
        "floating_twist": s.base_twist,
    }
    return numbers | {name: x for name, x in acting.items() if x is not None}


def shapes(p: Problem) -> dict[str, tuple[int, ...]]:
    """Return the shapes of outputs."""
    l = len(p.chain.arms)
    sizes = [(p.chain.joint_count,), (l, 6), (6,), (p.chain.contact_freedom_count,), (l, 6)]
    return dict(zip(OUTPUTS, sizes, strict=True))


def shape_of(p: Problem, by: str) -> tuple[int, ...]:
    """Return the shape of a gradient, and of a direction."""
    chain = p.chain
    l, n = len(chain.arms), chain.joint_count
    links = sum(arm.joint_count for arm in chain.arms.values())
    of_all = {"q": (n,), "qd": (n,), "tau": (n,), "armature": (n,), "damping": (n,), "gravity": (3,)}
    of_all |= {"object_mass": (), "object_com": (3,), "object_inertia": (3, 3), "link_mass": (links,)}
    of_all |= {"link_com": (links, 3), "link_inertia": (links, 3, 3), "link_wrench": (links, 6)}
    of_all |= {"grasp_pose": (len(chain.grasps), 6)}
    of_all |= dict.fromkeys(("base_pose", "base_twist", "base_acceleration"), (l, 6))
    if chain.trunk is not None:
        of_body = {"mass": (), "com": (3,), "inertia": (3, 3), "wrench": (6,)}
        of_all |= {f"trunk_link_{name}": (len(chain.trunk.bodies), *shape) for name, shape in of_body.items()}
    return of_all.get(by, (6,))


def as_direction(p: Problem, by: str, flat: np.ndarray) -> np.ndarray:
    """Return directions (..., k) in the shape that they are given in; symmetric inertias of six numbers."""
    shape = shape_of(p, by)
    if by in INERTIAS:
        return np.tensordot(flat.reshape(*flat.shape[:-1], *shape[:-2], 6), symmetric_basis(), 1)
    return flat.reshape((*flat.shape[:-1], *shape))


def flat_gradient(p: Problem, by: str, gradient: np.ndarray) -> np.ndarray:
    """Return gradients (..., shape) as (..., k): by the six numbers of an inertia, mixed ones moving both entries."""
    gradient, shape = np.asarray(gradient), shape_of(p, by)
    before = gradient.shape[: gradient.ndim - len(shape)]
    assert gradient.shape == (*before, *shape), f"{by}: {gradient.shape} does not end with {shape}"
    if by in INERTIAS:
        assert np.array_equal(gradient, np.swapaxes(gradient, -1, -2)), f"{by}: not symmetric"
        gradient = np.tensordot(gradient, symmetric_basis(), ((-2, -1), (1, 2)))
    return gradient.reshape(*before, size_of(p, by))


def size_of(p: Problem, by: str) -> int:
    """Return how many directions a name has."""
    size = int(np.prod(shape_of(p, by), dtype=int))
    return size * 6 // 9 if by in INERTIAS else size


Blocks = Mapping[tuple[str, str], np.ndarray]


def by_vjp(fast: Any, p: Problem, of: Sequence[str] = OUTPUTS, by: Iterable[str] = NAMES) -> Blocks:
    """Return every block, row by row: a batch of unit cotangents."""
    by, sizes = tuple(by), {name: int(np.prod(shapes(p)[name], dtype=int)) for name in of}
    total, start, cotangents = sum(sizes.values()), 0, {}
    rows = {}
    for name, size in sizes.items():
        rows[name] = slice(start, start + size)
        cotangents[name] = np.eye(total)[:, rows[name]].reshape(total, *shapes(p)[name])
        start += size
    found = fast.forward_dynamics_vjp(**given(p), **cotangents, by=by)
    gradients = {name: flat_gradient(p, name, getattr(found, name)) for name in by}
    return {(o, b): gradients[b][rows[o]] for o in of for b in by}


def by_jvp(fast: Any, p: Problem, of: Sequence[str] = OUTPUTS, by: Iterable[str] = NAMES) -> Blocks:
    """Return every block, column by column: one call with all unit directions."""
    by = tuple(by)
    sizes = {name: size_of(p, name) for name in by}
    total, start, along, columns = sum(sizes.values()), 0, {}, {}
    for name, size in sizes.items():
        columns[name] = slice(start, start + size)
        along[name] = as_direction(p, name, np.eye(total)[:, columns[name]])
        start += size
    found = fast.forward_dynamics_jvp(**given(p), along=along)
    slopes = {o: getattr(found, o).reshape(total, -1).T for o in of}
    return {(o, b): slopes[o][:, columns[b]] for o in of for b in by}


def by_jacobian(fast: Any, p: Problem, of: Sequence[str] = OUTPUTS, by: Iterable[str] = NAMES) -> Blocks:
    """Return every block of the matrix."""
    by = tuple(by)
    found = fast.forward_dynamics_jacobian(**given(p), of=tuple(of), by=by)
    blocks = {}
    for o in of:
        size = int(np.prod(shapes(p)[o], dtype=int))
        for b in by:
            matrix = np.reshape(found[o, b], (size, *shape_of(p, b)))
            if b in INERTIAS:
                matrix = (matrix + np.swapaxes(matrix, -1, -2)) / 2
            blocks[o, b] = flat_gradient(p, b, matrix)
    return blocks


class Reference:
    """The reference forms, called as machine code is: the problem's own chain, of any state."""

    def __init__(self, p: Problem) -> None:
        """Keep the problem."""
        self.at = (p.chain, p.state, p.tau)
        self.options: dict[str, Any] = {"inputs": p.inputs, "check": False}

    def forward_dynamics_vjp(self, **options: Any) -> Any:
        """Return gradients."""
        return hf.forward_dynamics_vjp(*self.at, **self._own(options))

    def forward_dynamics_jvp(self, **options: Any) -> Any:
        """Return rates."""
        return hf.forward_dynamics_jvp(*self.at, **self._own(options))

    def forward_dynamics_jacobian(self, **options: Any) -> Any:
        """Return the matrix."""
        return hf.forward_dynamics_jacobian(*self.at, **self._own(options))

    def _own(self, options: Mapping[str, Any]) -> dict[str, Any]:
        return self.options | {name: x for name, x in options.items() if name in ("along", "of", "by", *OUTPUTS)}


WAYS = {"vjp": by_vjp, "jvp": by_jvp, "jacobian": by_jacobian}


RANDOM = 1e-10
ROUNDING = 1e-13  # of a group's largest entry: blocks that are zero


def worst_gap(found, expected: Derivatives, names, nothing: float = ROUNDING) -> float:
    """Return the worst gap of all blocks from the oracle's."""
    worst = 0.0
    for by in names:
        wanted = {of: expected.block(of, by) for of in OUTPUTS}
        off = dict(gaps({of: found[of, by] for of in OUTPUTS}, wanted, nothing))
        assert max(off.values()) < RANDOM, (by, off)
        worst = max(worst, *off.values())
    return worst


def random_cotangents(p: Problem, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a cotangent of every output."""
    return {name: random.normal(size=shape) for name, shape in shapes(p).items()}


def random_directions(p: Problem, random: np.random.Generator, by=NAMES) -> dict[str, np.ndarray]:
    """Return a direction of every argument and parameter."""
    return {name: as_direction(p, name, random.normal(size=size_of(p, name))) for name in by}


def worst_of_products(way: Any, p: Problem, expected: Derivatives, random: np.random.Generator, by=NAMES) -> float:
    """Return how far a gradient of random cotangents and rates along random directions are from the oracle's.

    Args:
        way: machine code, or the reference.
        p: the problem.
        expected: the oracle's matrices.
        random: where cotangents and directions come from.
        by: the arguments.
    """
    cotangents, along = random_cotangents(p, random), random_directions(p, random, by)
    pulled = way.forward_dynamics_vjp(**given(p), **cotangents, by=by)
    pushed = way.forward_dynamics_jvp(**given(p), along=along)
    worst = 0.0
    for name in by:
        parts = [np.ravel(cotangents[of]) @ expected.block(of, name) for of in OUTPUTS]
        size = max(np.abs(x).max(initial=0.0) for x in parts)
        off = np.abs(flat_gradient(p, name, getattr(pulled, name)) - sum(parts)).max(initial=0.0)
        worst = max(worst, off / (size or 1.0))
    flat = {name: flat_direction(p, name, along[name]) for name in by}
    for of in OUTPUTS:
        parts = [expected.block(of, name) @ flat[name] for name in by]
        worst = max(worst, relative_gap(np.ravel(getattr(pushed, of)), sum(parts)))
    return worst


def state_of(system: dict[str, np.ndarray]) -> State:
    """Return the state of a system."""
    return State(*(system[name] for name in ("q", "qd", "object_pose", "object_twist")))


def flat_direction(p: Problem, by: str, direction: np.ndarray) -> np.ndarray:
    """Return a direction as `as_direction` takes it; inertias as six numbers."""
    if by in INERTIAS:
        entries = np.reshape(direction, (-1, 3, 3))
        return np.array([x[i, j] for x in entries for i, j in SYMMETRIC])
    return np.ravel(direction)


def assert_compiled_is_reference(
    p: Problem, by: Sequence[str], few: Sequence[str], seed: int, floor: float = 0.0
) -> Any:
    """Compare gradients, directions and the matrix of machine code with the reference's; return the gradients."""
    random, fast, options, of = np.random.default_rng(seed), compiled(p), {"inputs": p.inputs}, ("qdd", "grasp_wrench")
    cotangents, along = random_cotangents(p, random), random_directions(p, random, by)
    pulled = fast.forward_dynamics_vjp(**given(p), **cotangents, by=by)
    pushed = fast.forward_dynamics_jvp(**given(p), along=along)
    matrix = fast.forward_dynamics_jacobian(**given(p), of=of, by=few)
    for found, expected, names in (
        (pulled, hf.forward_dynamics_vjp(p.chain, p.state, p.tau, **cotangents, by=by, **options), by),
        (pushed, hf.forward_dynamics_jvp(p.chain, p.state, p.tau, along=along, **options), cotangents),
        (matrix, hf.forward_dynamics_jacobian(p.chain, p.state, p.tau, of=of, by=few, **options), product(of, few)),
    ):
        for name in names:
            assert relative_gap(found[name], expected[name], floor=floor) < 1e-11, name
    parts = [float(np.sum(pulled[name] * x)) for name, x in along.items()]
    other = sum(float(np.sum(cotangent * pushed[name])) for name, cotangent in cotangents.items())
    assert sum(parts) == pytest.approx(other, abs=1e-13 * np.abs(parts).sum())
    return pulled
