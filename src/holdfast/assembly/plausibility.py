"""Notes on numbers that are possible but unlikely, each with its likely cause: units, signs, orders of quaternions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from holdfast import outer
from holdfast.model.closed_chain import ClosedChain, holding_arm
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_rows import row_name
from holdfast.model.held_object import HeldObject
from holdfast.model.visuals import Cylinder, Mesh, Sphere
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

DENSEST = 3e4  # [kg/m^3]; osmium has 2.3e4
HEAVIEST_LOAD = 30.0  # mass of an object, relative to that of the arms that hold it; robots lift their own
LONGEST_OBJECT = 30.0  # length of an object, relative to that of the longest arm
HAND_JOINTS = 5  # joints of an arm with a hand; cranks of mechanisms are pinned to an object with any attitude
SAME_DIRECTION = 0.99  # least cosine between directions that are meant to be the same
ON_FACE = 1e-6  # distance from a face, relative to the size, below which a place lies on it


def plausibility_notes(chain: ClosedChain, poses: Sequence[Pose] = ()) -> tuple[str, ...]:
    """Return notes on a chain's gravity, objects, grasps and bases, and on the poses of its objects. O(arms)."""
    g = chain.gravity
    notes = []
    if g[2] > 0.5 * float(np.linalg.norm(g)):
        notes.append(f"gravity: [{_few(g)}] points upward, along +z; it is the acceleration of a falling body, try -z")
    for name, held in chain.free_objects.items():
        notes += _of_object(name, held, chain)
    for key, grasp in chain.grasps.items():
        jointed = len(chain.arms[holding_arm(key)].joints) >= HAND_JOINTS
        presses = grasp.contact is not None or (grasp.of_kind.oriented and jointed)
        notes += _of_grasp(row_name(key), grasp, chain.free_objects[chain.held_by(grasp, key)]) if presses else ()
    places = {f"arm '{name}': base": arm.base for name, arm in chain.arms.items() if name not in chain.mounts}
    for what, pose in places.items():
        notes += _of_order(what, pose)
    for name, pose in zip(chain.free_objects, poses, strict=False):
        notes += _of_order(f"{name}: pose", pose)
        if np.allclose(pose.R, np.diag([-1.0, -1.0, 1.0]), rtol=0, atol=1e-9):
            notes.append(
                f"{name}: pose: the quaternion [0, 0, 0, 1] is half a turn about z; if none was meant: [1, 0, 0, 0]"
            )
    return tuple(notes)


def _of_object(name: str, held: HeldObject, chain: ClosedChain) -> Iterator[str]:
    """Yield notes on the size and mass of an object."""
    edges = outer.equivalent_box(held)[0]
    holding = [holding_arm(key) for key, grasp in chain.grasps.items() if chain.held_by(grasp, key) == name]
    arms = [chain.arms[arm] for arm in dict.fromkeys(holding)]
    moved, longest = sum(link.mass for arm in arms for link in arm.links), max((arm.length for arm in arms), default=0)
    box = f"a box of {_few(edges, ' x ')} m with its inertia"
    if isinstance(held.shape, Mesh) and (found := outer.size_notes(held)):
        yield from (f"{name}: {note}" for note in found)
    elif edges.max() > LONGEST_OBJECT * longest > 0.0:
        yield f"{name}: {box} is {edges.max() / longest:.0f} times as long as the longest arm: mm instead of m?"
    if (density := held.mass / float(edges.prod())) > DENSEST:
        yield f"{name}: {held.mass:g} kg in {box} are {density:.2g} kg/m^3, more than any metal: g instead of kg?"
    elif moved and all(arm.joints for arm in arms) and chain.gravity.any() and held.mass > HEAVIEST_LOAD * moved:
        yield f"{name}: {held.mass:g} kg are {held.mass / moved:.0f} times the mass of its arms: g instead of kg?"


def _of_grasp(name: str, grasp: Grasp, held: HeldObject) -> Iterator[str]:
    """Yield a note on a contact frame on the object's surface whose z axis does not point inward, as it should."""
    normal = outward_normal(held, grasp.frame.p)
    if normal is None:
        return
    outward, other = float(grasp.frame.R[:, 2] @ normal), _reordered(grasp.frame)
    if other is not None and outward > -0.5 and float(other.R[:, 2] @ normal) < -SAME_DIRECTION:
        yield f"grasp '{name}': {_meant(grasp.frame)}; then z would point into the object, as it should"
    elif outward > 0.5:
        yield (
            f"grasp '{name}': the contact frame's z axis points out of the object, but should point into it; try the"
            " frame after half a turn about its x axis, frame @ Pose.from_rpy(pi, 0, 0)"
        )


def _of_order(what: str, pose: Pose) -> Iterator[str]:
    """Yield a note on a pose that lies on its side, but would be upright if its quaternion's order was x, y, z, w."""
    other = _reordered(pose)
    if other is not None and other.R[2, 2] > SAME_DIRECTION > abs(pose.R[2, 2]):
        yield f"{what}: {_meant(pose)}; then z would point upward"


def _reordered(pose: Pose) -> Pose | None:
    """Return a pose with its quaternion read as x, y, z, w; None if that is the same, or if it has no rotation."""
    w, x, y, z = rotation.to_quaternion(pose.R)
    other = Pose(rotation.from_quaternion(np.array([z, w, x, y])), pose.p)
    return None if np.allclose(other.R, pose.R, atol=1e-6) or abs(w) > 1 - 1e-12 else other


def _meant(pose: Pose) -> str:
    w, x, y, z = (given := rotation.to_quaternion(pose.R)) * (-1.0 if given[3] < 0 else 1.0)
    return f"was the quaternion [{_few([w, x, y, z])}] meant as x, y, z, w? As w, x, y, z it is [{_few([z, w, x, y])}]"


def _few(numbers: Array | list[float], between: str = ", ") -> str:
    return between.join(f"{x + 0.0:.4g}" for x in numbers)


def outward_normal(held: HeldObject, place: Array) -> Array | None:
    """Return the outward normal (3,) of the object's surface at a place on it, None elsewhere and on edges.

    The surface is that of the object's sphere or cylinder or, without a shape, of the box with its inertia.
    """
    if isinstance(held.shape, Sphere):
        distance = float(np.linalg.norm(place))
        return place / distance if abs(distance - held.shape.radius) < ON_FACE * held.shape.radius else None
    if isinstance(held.shape, Cylinder):
        sizes, axes = np.array([2 * held.shape.radius, held.shape.length]), np.eye(3)
        across = np.array([place[0], place[1], 0.0])
        radius = float(np.linalg.norm(across))
        local, axes = np.array([radius, place[2]]), np.column_stack([across / (radius or 1.0), axes[:, 2]])
    elif held.shape is None:
        sizes, at = outer.equivalent_box(held)
        local, axes = at.R.T @ (place - at.p), at.R
    else:
        return None
    off = np.abs(local) - 0.5 * sizes
    face = int(np.argmax(off))
    inside = np.delete(off, face) < -ON_FACE * sizes.max()
    return np.sign(local[face]) * axes[:, face] if abs(off[face]) < ON_FACE * sizes.max() and inside.all() else None
