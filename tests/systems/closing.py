"""Close a system: place arms on their contacts, make velocities agree, judge it.

Everything here edits or reads plain case dictionaries; world axes, SI units.
"""

import numpy as np

from tests.oracles.arithmetic import arithmetic
from tests.oracles.arm_kinematics import MovingFrame, link_frames, point_jacobian
from tests.oracles.maximal_kkt import KktSystem, contact_axes
from tests.systems.random_parts import still_base

FLOATS = arithmetic(None)


def place_arm(arm: dict, R_base: np.ndarray, tip_position: np.ndarray) -> None:
    """Set the arm's base pose so that the tip lies at a world position [m]."""
    moved = arm | {"base": still_base() | {"R": np.asarray(R_base).tolist()}}
    reach = link_frames(moved, FLOATS)[-1].point(np.array(arm["tip"]))
    arm["base"] = arm["base"] | {
        "R": np.asarray(R_base).tolist(),
        "p": (np.asarray(tip_position) - reach).tolist(),
    }


def contact_position(case: dict, grasp: dict) -> np.ndarray:
    """Return the world position [m] of a grasp's contact point on the object."""
    body = case["object"]
    return np.array(body["p"]) + np.array(body["R"]) @ np.array(grasp["point_object"])


def set_velocities(case: dict, rng: np.random.Generator, joint_speed: float = 1.0, base_speed: float = 0.0) -> None:
    """Give the case random velocities that every grasp and moving base agrees with.

    A random vector of joint rates [rad/s, m/s], object twist, contact rates and base
    twists is projected on the null space of the velocity constraint.  Base twists are
    among the unknowns because a locked chain cannot follow just any base motion.

    Args:
        case: changed in place; bases marked ``"moves": True`` get a twist.
        rng: source of randomness.
        joint_speed: typical rate of joints, object and contacts [rad/s, m/s].
        base_speed: typical base rate [rad/s, m/s]; zero leaves all bases still.
    """
    matrix, columns = velocity_constraint(case)
    x = rng.normal(size=matrix.shape[1])
    speeds = np.full(len(x), joint_speed)
    for base in columns["base"]:
        speeds[base] = base_speed
    x = x * speeds
    # Two passes: the second takes off the rounding the first one left.
    for _ in range(2):
        x = x - np.linalg.lstsq(matrix, matrix @ x, rcond=1e-11)[0]
    case["object"]["omega"] = x[columns["object"]][:3].tolist()
    case["object"]["v"] = x[columns["object"]][3:].tolist()
    for i, arm in enumerate(case["arms"]):
        arm["qd"] = x[columns["qd"][i]].tolist()
        twist = x[columns["base"][i]]
        if len(twist):
            arm["base"] |= {"omega": twist[:3].tolist(), "v": twist[3:].tolist()}
        if arm["grasp"] is not None:
            arm["grasp"]["W"] = x[columns["W"][i]].tolist()


def velocity_constraint(case: dict) -> tuple[np.ndarray, dict]:
    """Return the matrix whose null space holds the consistent velocities.

    Rows per grasp: object side less tip side less contact motion, [angular; linear].

    Returns:
        The matrix and the columns of ``object`` (one slice) and of ``qd``, ``W``,
        ``base`` (a slice per arm; empty where there is nothing to move).
    """
    columns, width = _velocity_columns(case)
    rows = []
    R = np.array(case["object"]["R"])
    for i, arm in enumerate(case["arms"]):
        grasp = arm["grasp"]
        if grasp is None:
            continue
        frames = link_frames(arm, FLOATS)
        tip = frames[-1].point(np.array(arm["tip"]))
        row = np.zeros((6, width))
        row[:, columns["object"]] = _lever_matrix(R @ np.array(grasp["point_object"]))
        row[:, columns["qd"][i]] = -point_jacobian(frames, len(frames) - 1, tip)
        row[:3, columns["W"][i]] = -contact_axes(grasp, R, FLOATS)
        if columns["base"][i].stop > columns["base"][i].start:
            row[:, columns["base"][i]] = -_lever_matrix(tip - np.array(arm["base"]["p"]))
        rows.append(row)
    return np.concatenate(rows) if rows else np.zeros((0, width)), columns


def _velocity_columns(case: dict) -> tuple[dict, int]:
    """Return which columns of the velocity constraint belong to what, and their number."""
    columns, end = {"object": slice(0, 6), "qd": [], "W": [], "base": []}, 6
    for arm in case["arms"]:
        rates = {"rigid": 0, "hinge": 1, "softfinger": 2, "ball": 3}
        contact = rates[arm["grasp"]["type"]] if arm["grasp"] else 0
        sizes = (len(arm["q"]), contact, 6 if arm["base"].get("moves") else 0)
        for name, size in zip(("qd", "W", "base"), sizes, strict=True):
            columns[name].append(slice(end, end + size))
            end += size
    return columns, end


def _lever_matrix(lever: np.ndarray) -> np.ndarray:
    """Return the map of a body's twist at one point to the twist at point + lever."""
    x, y, z = lever
    matrix = np.eye(6)
    matrix[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return matrix


def closure_gaps(case: dict) -> tuple[float, float, float]:
    """Return the largest position [m], velocity and stored-W gap of all grasps.

    The velocity gap [rad/s or m/s] is what the twists of object and tip differ by once
    the motion along the contact's free axes is taken off.
    """
    body = case["object"]
    keys = ("R", "p", "omega", "v", "omega", "v")
    held = MovingFrame(*(np.array(body[key]) for key in keys))
    gaps = [(0.0, 0.0, 0.0)]
    for arm in case["arms"]:
        grasp = arm["grasp"]
        if grasp is None:
            continue
        tip, last = np.array(arm["tip"]), link_frames(arm, FLOATS)[-1]
        point = np.array(grasp["point_object"])
        h = contact_axes(grasp, held.R, FLOATS)
        turning = held.omega - last.omega
        W = h.T @ turning
        slip = held.point_velocity(point) - last.point_velocity(tip)
        gaps.append(
            (
                _largest(held.point(point) - last.point(tip)),
                max(_largest(slip), _largest(turning - h @ W)),
                _largest(W - np.array(grasp["W"])),
            )
        )
    return tuple(max(column) for column in zip(*gaps, strict=True))


def _largest(values: np.ndarray) -> float:
    """Return the largest magnitude, 0 for nothing."""
    return float(np.max(np.abs(values), initial=0.0))


def scaled_condition(case: dict) -> float:
    """Return the unit-free condition number of the grasp forces' equation.

    That is cond(D^-1/2 K Omega K^T D^-1/2) with D the diagonal of K Omega K^T, Omega =
    blockdiag(J M^-1 J^T) + A M(C)^-1 A^T over the holding arms and K orthonormal rows of
    the wrench directions that the grasps transmit.  Returns inf if the forces are not
    unique, 1 if nobody holds the object.
    """
    system = KktSystem(case, FLOATS)
    held = [i for i, grasp in enumerate(system.grasps) if grasp is not None]
    if not held:
        return 1.0
    K = [transmitted(system.grasps[i].H) for i in held]
    KA = np.concatenate([k @ system.grasps[i].A for k, i in zip(K, held, strict=True)])
    omega = KA @ np.linalg.solve(system.body.M, KA.T)
    end = 0
    for k, i in zip(K, held, strict=True):
        KJ = k @ system.arms[i].J
        block = slice(end, end + len(k))
        omega[block, block] += KJ @ np.linalg.solve(system.arms[i].M, KJ.T)
        end += len(k)
    scale = 1.0 / np.sqrt(np.diag(omega))
    values = np.linalg.eigvalsh(omega * np.outer(scale, scale))
    return float(values[-1] / values[0]) if values[0] > 1e-13 * values[-1] else np.inf


def transmitted(H: np.ndarray) -> np.ndarray:
    """Return orthonormal rows K (6 - n_g, 6) of the wrenches a grasp transmits, K H^T = 0."""
    _, _, rows = np.linalg.svd(H)
    return rows[len(H) :]
