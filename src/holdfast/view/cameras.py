"""Places to look at a chain from."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.posture import posture
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross
from holdfast.state import State
from holdfast.view.film import Film
from holdfast.view.scene_writer import FIELD_OF_VIEW, Camera

SEEN_OF = 5  # moments that are to fit into the picture


def upward(chain: ClosedChain) -> Array:
    """Return the unit vector against gravity, (3,); world z where there is none."""
    g = float(np.linalg.norm(chain.gravity))
    return -chain.gravity / g if g > 0 else np.array([0.0, 0.0, 1.0])


def cameras(film: Film) -> list[Camera]:
    """Return views from which the whole chain is in the picture, and one near the object; the first is the best."""
    up = upward(film.chain)
    along = _spread(film.chain, up)
    front = cross(along, up)  # from the chain towards who looks at it
    chosen = np.unique(np.linspace(0, len(film) - 1, SEEN_OF).astype(int))
    points = np.concatenate([outline(film.chain, film.q[k], film.object_pose[k]) for k in chosen])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    held = film.object_pose[chosen, 4:].mean(axis=0)
    distance = 0.9 * radius / np.sin(FIELD_OF_VIEW / 2)
    directions = {
        "overview": front + 0.45 * along + 0.4 * up,
        "front": front,
        "side": along + 0.1 * up,
        "top": up + 0.02 * front,
    }
    views = [Camera(name, middle + distance * d / np.linalg.norm(d), middle) for name, d in directions.items()]
    near = 0.4 * distance * (front + 0.3 * along + 0.5 * up) / np.linalg.norm(front + 0.3 * along + 0.5 * up)
    return [*views, Camera("object", held + near, held)]


def outline(chain: ClosedChain, q: Array, object_pose: Array) -> Array:
    """Return bases, link origins, tips and contacts in the world, (points, 3) [m]."""
    points = []
    for name, arm in chain.arms.items():
        at = posture(arm, q[chain.joints[name]])
        points += [arm.base.p, at.tip.p, *(at.tip.p - reach for reach in at.reach)]
    frame = State(q, np.zeros_like(q), object_pose).object_frame
    points += [frame.p, *((frame @ grasp.frame).p for grasp in chain.grasps.values())]
    return np.array(points)


def _spread(chain: ClosedChain, up: Array) -> Array:
    """Return the horizontal direction in which the bases lie side by side, a unit vector (3,)."""
    bases = np.array([arm.base.p for arm in chain.arms.values()])
    level = bases - bases.mean(axis=0)
    level = level - np.outer(level @ up, up)
    sizes, directions = np.linalg.eigh(level.T @ level)
    along = directions[:, -1]
    if sizes[-1] < 1e-6:  # one base, or all in one place
        along = cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    along = along - (along @ up) * up
    along = along / np.linalg.norm(along)
    return along if along.sum() >= 0 else -along
