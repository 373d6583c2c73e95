"""Recordings of arms that carry an object along smooth paths, by formulas: no simulation, exact at every sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import holdfast as hf
from holdfast.identification import Recording
from holdfast.robots import HOME, panda

BOX = hf.HeldObject(
    3.0, [[0.045, 0.004, -0.002], [0.004, 0.03, 0.003], [-0.002, 0.003, 0.035]], com=[0.03, -0.02, 0.04]
)
SQUEEZE = 20.0  # N


def two_pandas(box: hf.HeldObject = BOX) -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms that hold a box, and a state."""
    arms = {"left": panda().at(hf.Pose.translation(0, 0.35, 0)), "right": panda().at(hf.Pose.translation(0, -0.35, 0))}
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([0, 0.15, 0], into=[0, -1, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0, -0.15, 0], into=[0, 1, 0])),
    }
    return hf.assemble(arms, box, grasps, q=dict.fromkeys(arms, HOME["panda"]))


def swung(t: np.ndarray, turn: float, shift: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return [roll, pitch, yaw; displacement] along sums of sines, with two derivatives, (samples, 6) each."""
    f = 2 * np.pi * np.array([0.51, 0.37, 0.63, 0.47, 0.59, 0.31])
    size = np.array([turn] * 3 + [shift] * 3)
    phase = np.array([0.0, 1.0, 2.0, 0.5, 1.5, 2.5])
    x = f * t[:, None] + phase
    return size * np.sin(x), size * f * np.cos(x), -size * f**2 * np.sin(x)


def turned(
    angles: np.ndarray, rates: np.ndarray, accelerations: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return R, omega and its derivative of roll, pitch, yaw with their derivatives, world axes."""
    _, b, c = angles
    E = np.array([[np.cos(b) * np.cos(c), -np.sin(c), 0], [np.cos(b) * np.sin(c), np.cos(c), 0], [-np.sin(b), 0, 1]])
    by_b = np.array([[-np.sin(b) * np.cos(c), 0, 0], [-np.sin(b) * np.sin(c), 0, 0], [-np.cos(b), 0, 0]])
    by_c = np.array([[-np.cos(b) * np.sin(c), -np.cos(c), 0], [np.cos(b) * np.cos(c), -np.sin(c), 0], [0, 0, 0]])
    E_dot = by_b * rates[1] + by_c * rates[2]
    return hf.Pose.from_rpy(*angles).R, E @ rates, E @ accelerations + E_dot @ rates


def recorded(
    chain: hf.ClosedChain, state: hf.State, *, duration=10.0, rate=25.0, turn=0.35, shift=0.06, tau=True, motion=None
) -> Recording:
    """Return what two arms do and feel while their object is swung.

    Args:
        chain: two arms that hold rigidly.
        state: where the motion is about.
        duration: [s].
        rate: samples a second.
        turn: amplitude of the turns [rad].
        shift: amplitude of the displacements [m].
        tau: whether torques are found.
        motion: x, v and a of times, as `swung` returns them; None for `swung` with these amplitudes.
    """
    t = np.arange(0.0, duration, 1.0 / rate)
    start, q = state.object_frame, np.array(state.q)
    object_motion = ("object_pose", "object_twist", "object_acceleration")
    rows: dict[str, list] = {name: [] for name in ("q", "qd", "qdd", "tau", "wrist_wrench", *object_motion)}
    for x, v, a in zip(*(motion(t) if motion else swung(t, turn, shift)), strict=True):
        R, omega, alpha = turned(x[:3], v[:3], a[:3])
        pose = hf.Pose(R @ start.R, start.p + x[3:])
        V, acceleration = np.r_[omega, v[3:]], np.r_[alpha, a[3:]]
        qd, qdd = np.zeros_like(q), np.zeros_like(q)
        tips = {}
        for name, arm in chain.arms.items():
            part, grasp = chain.joints[name], chain.grasps[name].frame
            wanted = pose @ grasp
            for _ in range(20):
                at = hf.dynamics.tip_pose(arm, q[part])
                S = at.R.T @ wanted.R - wanted.R.T @ at.R
                off = np.r_[at.R @ [S[2, 1], S[0, 2], S[1, 0]] / 2, wanted.p - at.p]
                if np.abs(off).max() < 1e-13:
                    break
                q[part] += np.linalg.pinv(hf.dynamics.tip_jacobian(arm, q[part])) @ off
            lever = pose.R @ grasp.p
            J = hf.dynamics.tip_jacobian(arm, q[part])
            twist = np.r_[omega, v[3:] + np.cross(omega, lever)]
            qd[part] = np.linalg.pinv(J) @ twist
            h = 1e-3  # J is smooth: its derivative along qd, of fourth order
            J_at = [hf.dynamics.tip_jacobian(arm, q[part] + k * h * qd[part]) for k in (-2, -1, 1, 2)]
            J_dot = (J_at[0] - 8 * J_at[1] + 8 * J_at[2] - J_at[3]) / (12 * h)
            tip = np.r_[alpha, a[3:] + np.cross(alpha, lever) + np.cross(omega, np.cross(omega, lever))]
            qdd[part] = np.linalg.pinv(J) @ (tip - J_dot @ qd[part])
            tips[name] = (at.R, lever)
        f = shared(chain, pose, omega, acceleration, tips)
        now = hf.State(q, qd, pose, V)
        torques = hf.inverse_dynamics(chain, now, qdd, f) if tau else 0 * q
        wrist = [np.r_[R.T @ w[:3], R.T @ w[3:]] for (R, _), w in zip(tips.values(), f, strict=True)]
        found = (q.copy(), qd, qdd, torques, wrist, pose.wxyz_xyz, V, acceleration)
        for column, entry in zip(rows.values(), found, strict=True):
            column.append(entry)
    recording = Recording(t, **{name: np.array(column) for name, column in rows.items()})
    return recording if tau else replace(recording, tau=None)


def shared(chain, pose, omega, acceleration, tips) -> np.ndarray:
    """Return wrenches of two arms on the object that give it its acceleration, by Newton and Euler, and squeeze it."""
    body, R = chain.held_object, pose.R
    c, I = R @ body.com, R @ body.inertia @ R.T
    alpha = acceleration[:3]
    force = body.mass * (acceleration[3:] + np.cross(alpha, c) + np.cross(omega, np.cross(omega, c)) - chain.gravity)
    moment = I @ alpha + np.cross(omega, I @ omega) + np.cross(c, force)
    levers = [lever for _, lever in tips.values()]
    between = (levers[1] - levers[0]) / np.linalg.norm(levers[1] - levers[0])
    forces = [force / 2 + SQUEEZE * between, force / 2 - SQUEEZE * between]
    left = moment - sum(np.cross(lever, one) for lever, one in zip(levers, forces, strict=True))
    return np.array([np.r_[left / 2, one] for one in forces])


def noisy(recording: Recording, seed: int, part: float = 0.05) -> Recording:
    """Return a recording whose torques and wrenches have noise, normal, of a part of each kind's root mean square.

    Kinds are every joint's torque, and moments and forces of the wrists.
    """
    rng, made = np.random.default_rng(seed), {}
    if recording.tau is not None:
        sizes = np.sqrt((recording.tau**2).mean(axis=0))
        made["tau"] = recording.tau + part * sizes * rng.normal(size=recording.tau.shape)
    if recording.wrist_wrench is not None:
        w = recording.wrist_wrench
        sizes = np.repeat([np.sqrt((w[..., half] ** 2).mean()) for half in (slice(0, 3), slice(3, 6))], 3)
        made["wrist_wrench"] = w + part * sizes * rng.normal(size=w.shape)
    return replace(recording, **made)
