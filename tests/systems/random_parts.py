"""Draw random but physically valid parts of a system: bodies, joints, arms, grasps."""

import numpy as np

KINDS = ("rigid", "hinge", "softfinger", "ball")
GRAVITY = (0.0, 0.0, -9.81)


def unit_vector(rng: np.random.Generator) -> np.ndarray:
    """Return a random direction, (3,)."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def rotation_vector_matrix(vector) -> np.ndarray:
    """Return the rotation matrix of a rotation vector [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


def rotation(rng: np.random.Generator) -> np.ndarray:
    """Return a uniformly random rotation matrix."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def inertia_about_com(rng: np.random.Generator, mass: float, size: float) -> np.ndarray:
    """Return a random inertia [kg m^2] of a body about ``size`` metres large.

    Built from three positive second moments of mass, so the triangle inequality holds
    strictly: no principal moment reaches the sum of the other two.
    """
    moments = mass * size**2 * rng.uniform(0.05, 0.3, size=3)
    R = rotation(rng)
    inertia = R @ np.diag(np.sum(moments) - moments) @ R.T
    return (inertia + inertia.T) / 2.0


def random_link(rng: np.random.Generator) -> dict:
    """Return a link of 0.5 to 4 kg whose mass centre lies within 0.15 m or so."""
    mass = float(rng.uniform(0.5, 4.0))
    return {
        "mass": mass,
        "com": (0.1 * rng.normal(size=3)).tolist(),
        "inertia": inertia_about_com(rng, mass, 0.25).tolist(),
    }


def random_joint(rng: np.random.Generator, kind: str) -> dict:
    """Return a joint of random axis and placement, about 0.3 m from its parent."""
    return {
        "type": kind,
        "axis": unit_vector(rng).tolist(),
        "R0": rotation(rng).tolist(),
        "p0": (unit_vector(rng) * rng.uniform(0.15, 0.4)).tolist(),
    }


def joint_kinds(rng: np.random.Generator, count: int) -> list[str]:
    """Return joint types, about one in five prismatic, never more than three."""
    kinds = ["prismatic" if rng.random() < 0.2 else "revolute" for _ in range(count)]
    sliding = [j for j, kind in enumerate(kinds) if kind == "prismatic"]
    for j in sliding[3:]:  # a fourth one could only repeat the directions of three
        kinds[j] = "revolute"
    return kinds


def random_positions(rng: np.random.Generator, kinds: list[str], angle_scale: float) -> list[float]:
    """Return joint positions: angles up to ``angle_scale`` [rad], strokes up to 0.3 m."""
    limits = [angle_scale if kind == "revolute" else 0.3 for kind in kinds]
    return [float(rng.uniform(-limit, limit)) for limit in limits]


def random_arm(rng: np.random.Generator, kinds: list[str], angle_scale: float = np.pi) -> dict:
    """Return an arm at rest with joints of these types; base pose and rates come later."""
    count = len(kinds)
    return {
        "base": still_base(),
        "joints": [random_joint(rng, kind) for kind in kinds],
        "links": [random_link(rng) for _ in kinds],
        "tip": (unit_vector(rng) * rng.uniform(0.1, 0.3)).tolist(),
        "q": random_positions(rng, kinds, angle_scale),
        "qd": [0.0] * count,
        "tau": (5.0 * rng.normal(size=count)).tolist(),
        "grasp": None,
    }


def still_base() -> dict:
    """Return a base at the world origin, at rest."""
    motion = {key: [0.0, 0.0, 0.0] for key in ("p", "omega", "v", "omega_dot", "v_dot")}
    return {"R": np.eye(3).tolist()} | motion


def random_grasp(rng: np.random.Generator, kind: str, contact) -> dict:
    """Return a grasp of one kind at a contact point given in object axes [m].

    Contact axes are random: one unit axis for a hinge, two orthonormal tangents for a
    soft finger.  W is filled in with the velocities.
    """
    grasp = {"type": kind, "point_object": np.asarray(contact).tolist(), "W": []}
    axes = rotation(rng).T
    if kind == "hinge":
        grasp["h_object"] = axes[:1].tolist()
    if kind == "softfinger":
        grasp["h_object"] = axes[:2].tolist()
    return grasp


def random_object(rng: np.random.Generator, scale: float, com_offset: float) -> dict:
    """Return an object of a few kilograms (times ``scale``) at a random pose, at rest.

    Args:
        rng: source of randomness.
        scale: factor on mass and inertia.
        com_offset: distance of the mass centre from the origin C [m].
    """
    mass = float(rng.uniform(2.0, 10.0))
    return {
        "mass": mass * scale,
        "com": (com_offset * unit_vector(rng)).tolist(),
        "inertia": (scale * inertia_about_com(rng, mass, 0.5)).tolist(),
        "R": rotation(rng).tolist(),
        "p": (0.5 * rng.normal(size=3)).tolist(),
        "omega": [0.0, 0.0, 0.0],
        "v": [0.0, 0.0, 0.0],
    }


def random_contact(rng: np.random.Generator, body: dict) -> np.ndarray:
    """Return a contact 0.15 to 0.4 m from the mass centre, object axes [m]."""
    return np.array(body["com"]) + unit_vector(rng) * rng.uniform(0.15, 0.4)
