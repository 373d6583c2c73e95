"""The split of the grasp forces into motion and internal parts, with load shares (docs/theory/simulation.md)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.contact_places import ContactPlace, contact_places
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.force_element import HELD_OBJECT
from holdfast.model.grasp import Grasp
from holdfast.model.serial_chain import answered_as_forest
from holdfast.spatial.frozen import read_only
from holdfast.spatial.linalg import least_solution
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, sqrt, where
from holdfast.spatial.spatial_vector import rotate, shift_wrench, twist_shift, unrotate
from holdfast.spatial.vector import dot
from holdfast.state import State, require_fit, require_state

SMALLEST_FORCE = 1e-9  # net forces below this, relative to the sum of the grasp forces, have no load shares


class Split(NamedTuple):
    """The two parts of the wrenches on an object, with one row per arm, in world axes about the contacts.

    Those of a chain with branches, loops, couplings or several objects have one row per grasp and per loop, zero for
    what does not touch the object.

    Attributes:
        motion: (arms, 6) the smallest wrenches with the same effect on the object, in the
            metric sum |moment / length|^2 + |force|^2.
        internal: (arms, 6) the remainder, A^T f_internal = 0.
        load_share: (arms,) part of the net force that each arm's motion force carries; the parts add up to 1. None if
            the net force vanishes.
        length: L of the metric [m].
    """

    motion: Array
    internal: Array
    load_share: Array | None
    length: float


@np.errstate(all="ignore")  # what overflows is refused below
def split(
    chain: ClosedChain, state: State, grasp_wrench: ArrayLike, length: float | None = None, *, of: str | None = None
) -> Split:
    """Return the motion and internal parts of the wrenches on an object, both of which are transmissible. O(l^3).

    A bushing is treated as a grasp that transmits all components. Of a chain with branches, loops, couplings or several
    objects, grasps and loops that touch the object count, those between two objects for each of them. O(bodies) more.

    Args:
        chain: the chain.
        state: state with the object's pose.
        grasp_wrench: (arms, 6) as in `ForwardResult`; of a chain with branches, (grasps and loops, 6), as in
            `MechanismResult`.
        length: L of the metric [m]; by default the rms distance of the contacts from their centroid.
        of: the name of the object; by default the held one, or the only one.

    Raises:
        StateError: a shape is wrong.
        ModelError: there is no such object.
    """
    checks.instance(chain, ClosedChain, "split: chain")
    name, forest = _object(chain, of), answered_as_forest(chain)
    (require_state if forest else require_fit)(chain, state)
    count = len(chain.as_forest.closures) if forest else len(chain.arms)
    given = checks.numbers(grasp_wrench, (count, 6), "grasp_wrench", StateError)
    touching = _touching(chain, state, name) if forest else _held(chain, state)
    f, rows, places = np.zeros_like(given), [*touching], [_as_rigid(place) for place, _ in touching.values()]
    for i, (_, sign) in touching.items():
        f[i] = sign * given[i]
    offsets = [place.offset for place in places]
    L = length_scale(offsets) if length is None else checks.number(length, "length", above=0.0)
    motion, internal = np.zeros_like(f), np.zeros_like(f)
    if rows:
        net = sum((shift_wrench(o, f[i]) for i, o in zip(rows, offsets, strict=True)), start=np.zeros(6))
        motion[rows] = motion_wrenches(places, net, L)
        internal[rows] = f[rows] - motion[rows]
    share = _load_share(motion[:, 3:])
    checks.finite(np.concatenate([*motion, *internal, [] if share is None else share]), "split")
    return Split(motion, internal, share, L)


@lru_cache(maxsize=16)
def constant_split(chain: ClosedChain) -> Array | None:
    """Return what all states of a chain have in common when grasp wrenches are split; None if that is nothing.

    If the axes and points of all grasps are fixed in the object, this is the matrix (6l, 6l) that gives the motion part
    of stacked grasp wrenches, both in object axes. If only the points are fixed, it is L of the metric, () [m].
    """
    grasps = chain.grasps.values()
    if not chain.grasps or any(grasp.of_kind.slides for grasp in grasps):
        return None
    places = [ContactPlace(grasp, grasp.frame.R, grasp.frame.p) for grasp in grasps]
    length = length_scale([place.offset for place in places])
    if any(grasp.of_kind.follows_tip for grasp in grasps):
        return read_only(np.array(length))
    by_net = [motion_wrenches(places, unit, length).ravel() for unit in np.eye(6)]
    return read_only(np.array(by_net).T @ np.concatenate([twist_shift(place.offset) for place in places]).T)


def parts_by(common: Array, chain: ClosedChain, state: State, grasp_wrench: Array) -> tuple[Array, Array]:
    """Return the internal part and the load shares of grasp wrenches (arms, 6), for floats or traced numbers.

    They are those of `split`, with shares of 0 where the net force vanishes.

    Args:
        common: the result of `constant_split`.
        chain: the chain.
        state: state with the object's pose.
        grasp_wrench: (arms, 6) as in `ForwardResult`.
    """
    R, rows = state.object_frame.R, [chain.names.index(name) for name in chain.grasps]
    if common.ndim:
        by_grasp = (common @ concatenate([unrotate(R, grasp_wrench[row]) for row in rows])).reshape(-1, 6)
        by_grasp = [rotate(R, f) for f in by_grasp]
    else:
        places = contact_places(chain, state)
        at_C = [shift_wrench(place.offset, grasp_wrench[row]) for row, place in zip(rows, places, strict=True)]
        by_grasp = list(motion_wrenches(places, sum(at_C, start=np.zeros(6)), common[()]))
    none, motion = array([0.0] * 6), dict(zip(rows, by_grasp, strict=True))
    internal = [grasp_wrench[row] - motion[row] if row in motion else none for row in range(len(chain.arms))]
    forces = [motion.get(row, none)[3:] for row in range(len(chain.arms))]
    net = sum(forces, start=np.zeros(3))
    square, total = dot(net, net), sum(sum(abs(x) for x in force) for force in forces)
    vanishes = sqrt(square) <= SMALLEST_FORCE * maximum(total, 1.0)
    size = where(vanishes, 1.0, square)
    return array(internal), array([where(vanishes, 0.0, dot(force, net) / size) for force in forces])


def _object(chain: ClosedChain, of: str | None) -> str:
    """Return the name of an object: a given one, the held one, or the only one."""
    known = chain.free_objects
    name = next(iter(known), None) if of is None and (len(known) == 1 or HELD_OBJECT in known) else of
    if name is not None and name in known:
        return name
    hint = checks.did_you_mean(name, known) if name is not None else ""
    raise ModelError(f"split: of: expected one of the objects {', '.join(known) or '(none)'}, got {name!r}.{hint}")


def _held(chain: ClosedChain, state: State) -> dict[int, tuple[ContactPlace, float]]:
    """Return the grasps of serial arms by row, and 1, the sign of their wrenches on the object."""
    rows = [chain.names.index(name) for name in chain.grasps]
    return {row: (place, 1.0) for row, place in zip(rows, contact_places(chain, state), strict=True)}


def _touching(chain: ClosedChain, state: State, name: str) -> dict[int, tuple[ContactPlace, float]]:
    """Return the grasps and loops at an object by row, and the sign of their wrenches, of body a on b, on it."""
    found = chain.as_forest
    body, motion = found.objects[name], mechanism_arguments(chain, state).motion({})
    places = {}
    for i, (own, at) in enumerate(zip(found.forest.closures, motion.closures, strict=True)):
        for other, offset, sign in ((own.b, at.l_b, 1.0), (own.a, at.l_a, -1.0)):
            if other == body:
                places[i] = ContactPlace(own.grasp, at.contact.R, offset), sign
    return places


def _as_rigid(place: ContactPlace) -> ContactPlace:
    """Return the contact place with a bushing replaced by a rigid grasp."""
    compliant = place.grasp.of_kind.compliant
    return place._replace(grasp=Grasp("rigid", place.grasp.frame)) if compliant else place


def motion_wrenches(places: list[ContactPlace], net: Array, length: Scalar) -> Array:
    """Return the smallest transmissible wrenches with a given sum at C, (grasps, 6).

    min sum |moment / L|^2 + |force|^2 over f = K^T lambda with A^T f = net: lambda =
    W^-1 K A y, where W is diagonal because no two rows of K share a component.

    Args:
        places: axes and contact points of the grasps.
        net: (6,) wrench on the object about C, world axes.
        length: L [m].
    """
    columns, scales = [], []
    for grasp, axes, offset in places:
        K = array([rotate(axes, row) for row in grasp.transmission]).reshape(-1, 6)
        columns.append((K, array([shift_wrench(offset, row) for row in K]).reshape(-1, 6)))
        scales.extend(grasp.of_kind.row_scales(length))
    to_C = np.concatenate([at_C for _, at_C in columns]).T  # A^T K^T, (6, rows)
    unit = np.r_[np.full(3, 1 / length), np.ones(3)]  # moments in newtons
    root = array(scales)  # of the diagonal of W^-1
    lam = root * least_solution(unit[:, None] * to_C * root, unit * net)
    ends = np.cumsum([len(K) for K, _ in columns])[:-1]
    return array([K.T @ part for (K, _), part in zip(columns, np.split(lam, ends), strict=True)])


def _load_share(forces: Array) -> Array | None:
    """Return s_i = F_i . F / |F|^2 of the motion forces."""
    net = forces.sum(axis=0)
    square = float(net @ net)
    if math.sqrt(square) <= SMALLEST_FORCE * max(float(np.abs(forces).sum()), 1.0):
        return None
    return forces @ net / square
