"""A closed chain through time by SUNDIALS' IDA: implicit, of index 1, never projected.

The unknowns are positions, velocities and grasp wrenches together; what must vanish are the
rows of the oracle's KKT system at the derivatives that IDA proposes. Nothing is solved for
here, and nothing of the library's equations or steps is used.
"""

from __future__ import annotations

import copy

import numpy as np
from sksundae.ida import IDA

from tests.oracles.arithmetic import arithmetic
from tests.oracles.arm_kinematics import cross
from tests.oracles.maximal_kkt import KktSystem

FLOATS = arithmetic(None)
WRENCH_TOLERANCE = 1e-3  # N m and N


def integrated(case: dict, pose: np.ndarray, duration: float, tolerance: float) -> dict[str, np.ndarray]:
    """Return q, qd, object_pose (wxyz_xyz, not normalised) and object_twist after a time.

    Args:
        case: every arm holds the object; the forces are unique.
        pose: (7,) wxyz_xyz of the object, as the case has it.
        duration: [s].
        tolerance: rtol and atol of positions and velocities.
    """
    at = copy.deepcopy(case)
    n = sum(len(arm["q"]) for arm in at["arms"])
    system = KktSystem(at, FLOATS)
    x = np.linalg.solve(system.matrix, system.rhs)
    velocities = np.concatenate([*(arm["qd"] for arm in at["arms"]), at["object"]["omega"], at["object"]["v"]])
    y = np.concatenate([*(arm["q"] for arm in at["arms"]), pose, velocities, x[n + 6 :]])
    rates = np.concatenate([_position_rates(y, n), x[: n + 6], np.zeros(len(x) - n - 6)])

    def residual(t: float, y: np.ndarray, rates: np.ndarray, found: np.ndarray) -> None:
        _move(at, y, n)
        system = KktSystem(at, FLOATS)
        found[: n + 7] = rates[: n + 7] - _position_rates(y, n)
        unknowns = np.concatenate([rates[n + 7 : 2 * n + 13], y[2 * n + 13 :]])
        found[n + 7 :] = system.matrix @ unknowns - system.rhs

    algebraic = np.arange(2 * n + 13, len(y))
    # wrenches are not carried from step to step: their last digits are noise that would stall the steps
    atol = np.where(np.arange(len(y)) < algebraic[0], tolerance, WRENCH_TOLERANCE)
    solver = IDA(residual, algebraic_idx=algebraic, rtol=tolerance, atol=atol, max_num_steps=10**5)
    # an output between, because two times alone ask for every step
    result = solver.solve(np.array([0.0, 0.5 * duration, duration]), y, rates)
    assert result.success, result.message
    q, pose, velocities = np.split(result.y[-1][: 2 * n + 13], [n, n + 7])
    return {"q": q, "object_pose": pose, "qd": velocities[:n], "object_twist": velocities[n:]}


def _move(case: dict, y: np.ndarray, n: int) -> None:
    """Put the case's state to that of the unknowns."""
    begin = 0
    for arm in case["arms"]:
        end = begin + len(arm["q"])
        arm["q"], arm["qd"] = y[begin:end], y[n + 7 + begin : n + 7 + end]
        begin = end
    twist = y[2 * n + 7 : 2 * n + 13]
    case["object"] |= {"R": _matrix(y[n : n + 4]), "p": y[n + 4 : n + 7], "omega": twist[:3], "v": twist[3:]}


def _position_rates(y: np.ndarray, n: int) -> np.ndarray:
    """Return the rates of q, quaternion and position that the velocities imply."""
    w, v = y[2 * n + 7 : 2 * n + 10], y[2 * n + 10 : 2 * n + 13]
    scalar, vector = y[n], y[n + 1 : n + 4]
    turning = 0.5 * np.concatenate([[-w @ vector], scalar * w + cross(w, vector)])
    return np.concatenate([y[n + 7 : 2 * n + 7], turning, v])


def _matrix(wxyz: np.ndarray) -> np.ndarray:
    """Return the rotation of a quaternion of any length, columns turned one by one."""
    scalar, vector = wxyz[0], wxyz[1:]
    columns = [e + 2 * cross(vector, cross(vector, e) + scalar * e) / (wxyz @ wxyz) for e in np.eye(3)]
    return np.stack(columns, axis=1)
