"""Systems at or near a singularity: planar, flat, collinear, with straight arms.

All grasps are rigid, all bases still, all velocities consistent; no extras.
"""

import numpy as np

from tests.oracles.arithmetic import arithmetic
from tests.oracles.maximal_kkt import KktSystem
from tests.systems.closing import contact_position, place_arm, scaled_condition, set_velocities
from tests.systems.random_parts import (
    GRAVITY,
    random_arm,
    random_contact,
    random_object,
    rotation,
    rotation_vector_matrix,
    still_base,
    unit_vector,
)

X, Z = np.eye(3)[0], np.eye(3)[2]


def planar_parallelogram(angle: float, crank_rate: float = 0.7, seed: int = 0) -> dict:
    """Return a four-bar parallelogram: two cranks carry the object without turning it.

    Two planar 2R arms hold the object rigidly; crank joints first, then a joint that
    keeps the object level.  One motion is left.  Three forces (out of the plane) are
    never unique; at ``angle`` 0 the four joints lie on one line and a further rank is
    lost, with the grasp forces growing like 1 / angle on the way.  No gravity.

    Args:
        angle: of the cranks from the line through both base pivots [rad].
        crank_rate: of the cranks [rad/s].
        seed: of masses, torques and the object's attitude.
    """
    rng = np.random.default_rng(seed)
    crank, span = 0.5, 0.8  # [m]
    body = random_object(rng, 1.0, 0.1)
    tilt = rotation_vector_matrix(rng.uniform(-1.0, 1.0) * Z)
    reach = crank * np.array([np.cos(angle), np.sin(angle), 0.0])
    speed = crank_rate * np.cross(Z, reach)
    center = reach + np.array([span / 2.0, 0.1, 0.0])
    body |= {"R": tilt.tolist(), "p": center.tolist(), "v": speed.tolist()}
    case = _case("planar_parallelogram", seed, body, [0.0, 0.0, 0.0])
    for pivot, hand in ((0.0, [0.15, 0.1, 0.0]), (span, [-0.15, 0.1, 0.0])):
        arm = _line_arm(rng, 2, crank) | {"tip": hand}
        for joint in arm["joints"]:
            joint["axis"] = Z.tolist()
        arm |= {"q": [angle, -angle], "qd": [crank_rate, -crank_rate]}
        tip = np.array([pivot, 0.0, 0.0]) + reach + hand
        arm["grasp"] = _rigid(tilt.T @ (tip - center))
        place_arm(arm, np.eye(3), contact_position(case, arm["grasp"]))
        case["arms"].append(arm)
    return case


def planar_three_arms(seed: int, joints=(6, 7, 6), tilted: bool = False) -> dict:
    """Return three planar arms whose constraint rank is 12 of 18 in every state.

    Args:
        seed: of everything.
        joints: revolute joints per arm, all axes normal to one plane.
        tilted: whether to turn the plane away from world xy, so that its zeros are only
            zeros up to rounding.
    """
    rng = np.random.default_rng(seed)
    world = rotation(rng) if tilted else np.eye(3)
    body = random_object(rng, 1.0, 0.1)
    body["R"] = (world @ rotation_vector_matrix(rng.normal() * Z)).tolist()
    case = _case("planar_three_arms", seed, body, (world @ [1.0, -9.0, 0.0]).tolist())
    for count in joints:
        arm = random_arm(rng, ["revolute"] * count)
        for joint in arm["joints"]:
            joint["axis"] = Z.tolist()
            joint["R0"] = rotation_vector_matrix(rng.normal() * Z).tolist()
            joint["p0"] = _in_plane(joint["p0"])
        arm["tip"] = _in_plane(arm["tip"])
        arm["grasp"] = _rigid(_in_plane(rng.uniform(-0.4, 0.4, size=3)))
        R_base = world @ rotation_vector_matrix(rng.normal() * Z)
        place_arm(arm, R_base, contact_position(case, arm["grasp"]))
        case["arms"].append(arm)
    set_velocities(case, rng)
    return case


def two_collinear_stretched_6r(seed: int, opposed: bool = True) -> dict:
    """Return two 6R arms stretched along one line that runs through both contacts.

    Every joint axis meets that line, so a force along it moves no joint: the constraint
    rank is 11 of 12, and no acceleration keeps the constraints for most velocities.

    Args:
        seed: of everything.
        opposed: whether the arms come from both ends (otherwise from the same one).
    """
    rng = np.random.default_rng(seed)
    case = _case("two_collinear_stretched_6r", seed, random_object(rng, 1.0, 0.1))
    middle, line = 0.1 * rng.normal(size=3), unit_vector(rng)  # object axes
    ahead = np.array(case["object"]["R"]) @ line
    for end in (-1.0, 1.0):
        arm = _line_arm(rng, 6, 0.25)
        arm["grasp"] = _rigid(middle + end * 0.3 * line)
        direction = -end * ahead if opposed else ahead
        place_arm(arm, _turned_to(rng, direction), contact_position(case, arm["grasp"]))
        case["arms"].append(arm)
    set_velocities(case, rng)
    return case


def one_straight_arm_of_three(bend: float, which=(0,), seed: int = 0, joints=(6, 6, 6), limit: float = 3e3) -> dict:
    """Return three rigid arms, some of them nearly straight and so nearly singular.

    At ``bend`` 0 each listed arm cannot yield to a force along its own line, yet the
    grasp forces are unique, because the lines differ.  The geometry but for the bent
    elbows (and the bases that follow them) does not depend on ``bend``.

    Args:
        bend: elbow angle of the listed arms away from straight [rad].
        which: indices of the straight arms, at most three.
        seed: of everything.
        joints: revolute joints per arm, 6 or 7.
        limit: largest scaled condition accepted at ``bend`` 0; each arm by itself must
            also be sound at 0.1, so that the straight elbow is its only singularity.

    Raises:
        ValueError: no draw was well conditioned.
    """
    for attempt in range(200):
        stream = (seed, attempt)
        straight, bent = (_three_arms(angle, which, stream, joints) for angle in (0.0, 0.1))
        if scaled_condition(straight) < limit and max(tip_conditions(bent)) < 1e5:
            return _three_arms(bend, which, stream, joints)
    raise ValueError(f"no system of condition below {limit:g} with {which=}, {seed=}")


def tip_conditions(case: dict) -> list[float]:
    """Return cond(J M^-1 J^T) of every arm (units mixed; inf or 1e16 where singular)."""
    arms = KktSystem(case, arithmetic(None)).arms
    return [float(np.linalg.cond(arm.J @ np.linalg.solve(arm.M, arm.J.T))) for arm in arms]


def _three_arms(bend: float, which, stream: tuple, joints) -> dict:
    """Return one draw of three arms, the listed ones straight but for the elbow."""
    rng = np.random.default_rng(stream)
    case = _case("one_straight_arm_of_three", stream[0], random_object(rng, 1.0, 0.1))
    for i, count in enumerate(joints):
        arm = _line_arm(rng, count, 0.25) if i in which else random_arm(rng, ["revolute"] * count)
        if i in which:
            elbow = count // 2
            arm["joints"][elbow]["axis"] = Z.tolist()
            arm["q"][elbow] = bend
        arm["grasp"] = _rigid(random_contact(rng, case["object"]))
        place_arm(arm, rotation(rng), contact_position(case, arm["grasp"]))
        case["arms"].append(arm)
    set_velocities(case, rng)
    return case


def _line_arm(rng: np.random.Generator, count: int, length: float) -> dict:
    """Return a revolute arm stretched along its base's x axis, every axis meeting it.

    The first joint sits at the base, each link is ``length`` metres long.
    """
    arm = random_arm(rng, ["revolute"] * count)
    for j, joint in enumerate(arm["joints"]):
        joint |= {"R0": np.eye(3).tolist(), "p0": (length * X * (j > 0)).tolist()}
    return arm | {"q": [0.0] * count, "tip": (length * X).tolist(), "base": still_base()}


def _turned_to(rng: np.random.Generator, direction: np.ndarray) -> np.ndarray:
    """Return a random rotation whose x axis is the given direction."""
    y = np.cross(direction, unit_vector(rng))
    y = y / np.linalg.norm(y)
    return np.stack([direction, y, np.cross(direction, y)], axis=1)


def _in_plane(point) -> list[float]:
    """Return the point with its z component removed."""
    return [float(point[0]), float(point[1]), 0.0]


def _rigid(point) -> dict:
    """Return a rigid grasp at a point in object axes [m]."""
    return {"type": "rigid", "point_object": np.asarray(point).tolist(), "W": []}


def _case(name: str, seed: int, body: dict, gravity=GRAVITY) -> dict:
    """Return a case without arms."""
    return {
        "name": f"{name}_{seed}",
        "tags": {"all_rigid": True, "moving_base": False, "seed": seed},
        "gravity": list(gravity),
        "object": body,
        "arms": [],
    }
