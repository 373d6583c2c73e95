"""A Stewart platform: six legs of three joints hold the object by balls, which leaves it its six freedoms."""

from __future__ import annotations

import numpy as np

from tests.systems.closing import contact_position, place_arm, set_velocities
from tests.systems.random_parts import GRAVITY, rotation_vector_matrix, still_base

X, Y, Z = np.eye(3)
BASE_RADIUS, PLATFORM_RADIUS, HEIGHT = 0.7, 0.35, 0.8  # [m]
CYLINDER = 0.3  # from a leg's foot to where its rod slides out [m]


def stewart_platform(seed: int = 0, joint_speed: float = 0.0) -> dict:
    """Return the platform a little away from its level pose: universal joint, slider and ball in each leg.

    Every leg alone can be pushed in three directions only, so the arms' and object's
    mobility as one matrix has nullity 12 of 36; the forces at the balls are unique all the
    same.

    Args:
        seed: of the pose and the velocities.
        joint_speed: typical rate of joints and object [rad/s, m/s].
    """
    rng = np.random.default_rng(seed)
    tilt = rotation_vector_matrix(0.1 * rng.normal(size=3))
    body = {
        "mass": 8.0,
        "com": [0.01, -0.02, 0.05],
        "inertia": np.diag([0.25, 0.28, 0.5]).tolist(),
        "R": tilt.tolist(),
        "p": (HEIGHT * Z + 0.03 * rng.normal(size=3)).tolist(),
        "omega": [0.0, 0.0, 0.0],
        "v": [0.0, 0.0, 0.0],
    }
    case = {
        "name": f"stewart_platform_{seed}",
        "tags": {"all_rigid": False, "moving_base": False, "seed": seed},
        "gravity": list(GRAVITY),
        "object": body,
        "arms": [],
    }
    for k in range(6):
        side = 1.0 if k % 2 else -1.0
        middle = 2.0 * np.pi * (k // 2) / 3.0
        ball = _on_circle(PLATFORM_RADIUS, middle + side * 0.85)
        grasp = {"type": "ball", "point_object": ball.tolist(), "W": []}
        leg = contact_position(case, grasp) - _on_circle(BASE_RADIUS, middle + side * 0.25)
        arm = _leg(float(np.linalg.norm(leg))) | {"grasp": grasp}
        place_arm(arm, _along(leg), contact_position(case, grasp))
        case["arms"].append(arm)
    set_velocities(case, rng, joint_speed)
    return case


def _leg(length: float) -> dict:
    """Return a leg at rest that stretches along its base's z axis: cross, cylinder, rod."""
    joints = [
        {"type": kind, "axis": axis.tolist(), "R0": np.eye(3).tolist(), "p0": p0.tolist()}
        for kind, axis, p0 in (
            ("revolute", X, 0.0 * Z),
            ("revolute", Y, 0.0 * Z),
            ("prismatic", Z, CYLINDER * Z),
        )
    ]
    links = [
        {"mass": mass, "com": (com * Z).tolist(), "inertia": np.diag(moments).tolist()}
        for mass, com, moments in (
            (0.2, 0.0, [2e-4, 2e-4, 2e-4]),
            (1.5, 0.2, [0.02, 0.02, 1e-3]),
            (0.7, 0.2, [0.01, 0.01, 2e-4]),
        )
    ]
    return {
        "base": still_base(),
        "joints": joints,
        "links": links,
        "tip": ((length - CYLINDER) * Z).tolist(),
        "q": [0.0] * 3,
        "qd": [0.0] * 3,
        "tau": [0.0] * 3,
        "grasp": None,
    }


def _on_circle(radius: float, angle: float) -> np.ndarray:
    """Return a point on a level circle about the origin [m]."""
    return radius * np.array([np.cos(angle), np.sin(angle), 0.0])


def _along(direction: np.ndarray) -> np.ndarray:
    """Return a rotation whose z axis is the direction."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(Y, z) / np.linalg.norm(np.cross(Y, z))
    return np.stack([x, np.cross(z, x), z], axis=1)
