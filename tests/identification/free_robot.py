"""An arm in a plane on a body that nothing holds, by Newton and Euler alone: what its sensors and a camera record.

Its joints move as prescribed. Momentum is zero, so that the mass centre stays where it is, the body's velocity follows
from the joints' rates, and its attitude from that by integration.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.identification import Recording

Y = np.array([0.0, 1.0, 0.0])
AT = np.array([[0.1, 0.0, 0.1], [0.0, 0.0, 0.4]])  # joints in the body before, m
TIP = np.array([0.0, 0.0, 0.35])
LINKS = [(1.5, np.array([0.01, 0.0, 0.2]), 0.02), (1.0, np.array([0.0, 0.0, 0.15]), 0.01)]  # mass, com, inertia about y
BASE = (np.array([0.02, 0.0, 0.03]), 0.1)  # com, and inertia for each kilogram
BOX = (2.0, np.array([0.03, 0.0, 0.12]), 0.03)  # in axes of the tip
TURNS, SWINGS, PHASES = (
    2.0 * np.pi * np.array([[0.9, 0.5], [1.1, 0.7]]),
    np.array([[0.5, 0.5], [0.5, 0.4]]),
    np.array([[0.3, 1.0], [1.7, 0.2]]),
)


def swing(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return prescribed positions, rates and accelerations of the joints."""
    x = TURNS * t + PHASES
    q = np.array([0.4, 0.9]) + (SWINGS * np.sin(x)).sum(axis=1)
    return q, (SWINGS * TURNS * np.cos(x)).sum(axis=1), -(SWINGS * TURNS**2 * np.sin(x)).sum(axis=1)


def recorded(base_mass: float, duration: float, samples: int) -> tuple[hf.ClosedChain, Recording]:
    """Return the chain, and what is recorded without noise."""
    bodies = [(base_mass, BASE[0], base_mass * BASE[1]), *LINKS, (BOX[0], TIP + BOX[1], BOX[2])]
    of = [0, 1, 2, 2]  # the frame of each body; the box is fixed to the last link
    m, I = (np.array([one[i] for one in bodies]) for i in (0, 2))

    def frames(angle: float, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return levers from frame to frame, and mass centres and joints about the base's origin."""
        angles = angle + np.r_[0.0, np.cumsum(q)]
        turned = [np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) for a in angles]
        levers = np.array([turned[j] @ AT[j] for j in range(2)])
        origins = np.concatenate([np.zeros((1, 3)), np.cumsum(levers, axis=0)])
        return levers, np.array([origins[k] + turned[k] @ one[1] for k, one in zip(of, bodies, strict=True)]), origins

    def accelerated(angle: float, q: np.ndarray, w: np.ndarray, e: np.ndarray) -> np.ndarray:
        """Return accelerations of mass centres beside the base's, for rates w and accelerations e of all frames."""
        levers, centres, origins = frames(angle, q)
        steps = [np.cross(e[j] * Y, levers[j]) - w[j] ** 2 * levers[j] for j in range(2)]
        at = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        arms = [c - origins[k] for k, c in zip(of, centres, strict=True)]
        return np.array([at[k] + np.cross(e[k] * Y, r) - w[k] ** 2 * r for k, r in zip(of, arms, strict=True)])

    def total(angle: float, q: np.ndarray, w: np.ndarray, e: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the moment about the base's origin and the force that these accelerations need, in the plane."""
        a, centres = accelerated(angle, q, w, e) + v, frames(angle, q)[1]
        moment = (m[:, None] * np.cross(centres, a)).sum(axis=0) + (I * e[of]).sum() * Y
        return np.r_[moment[1], (m[:, None] * a).sum(axis=0)[[0, 2]]]

    def base(angle: float, q: np.ndarray, w: np.ndarray, e: np.ndarray) -> np.ndarray:
        """Return [turn, x, z] of the base for which the total is zero, for joints' rates w and accelerations e."""
        none = np.zeros(3)
        units = [(np.ones(3), none), (none, np.eye(3)[0]), (none, np.eye(3)[2])]
        A = np.array([total(angle, q, none, ones, v) for ones, v in units]).T
        return -np.linalg.solve(A, total(angle, q, w, e, none))

    def rates(angle: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return base(angle, q, np.zeros(3), np.r_[0.0, np.cumsum(qd)])  # momentum is linear in rates alike

    t = np.linspace(0.0, duration, samples)

    def turning(s: float, y: np.ndarray) -> np.ndarray:
        q, qd, _ = swing(s)
        return rates(y[0], q, qd)[:1]

    angles = solve_ivp(turning, (0.0, duration), [0.0], t_eval=t, rtol=1e-11, atol=1e-12).y[0]
    rows: dict[str, list] = {n: [] for n in ("q", "qd", "qdd", "tau", "base_pose", "base_twist", "base_acceleration")}
    for s, angle in zip(t, angles, strict=True):
        q, qd, qdd = swing(s)
        turn, *v = rates(angle, q, qd)
        w = turn + np.r_[0.0, np.cumsum(qd)]
        alone = np.r_[0.0, np.cumsum(qdd)]
        spin, *a = base(angle, q, w, alone)
        e, a = spin + alone, np.array([a[0], 0.0, a[1]])
        _, centres, origins = frames(angle, q)
        forces = m[:, None] * (accelerated(angle, q, w, e) + a)
        moments = [np.cross(centres - o, forces)[:, 1] + I * e[of] for o in origins]
        tau = [moments[j][j:].sum() for j in (1, 2)]
        p = -(m[:, None] * centres).sum(axis=0) / m.sum()
        pose = [np.cos(angle / 2), 0, np.sin(angle / 2), 0, *p]
        found = (q, qd, qdd, tau, pose, [0, turn, 0, v[0], 0, v[1]], [0, spin, 0, a[0], 0, a[2]])
        for column, entry in zip(rows.values(), found, strict=True):
            column.append(np.array(entry))
    joints = [hf.Joint(axis=Y, placement=hf.Pose(np.eye(3), one)) for one in AT]
    links = [hf.Link(mass, com, np.diag([i, i, 0.5 * i])) for mass, com, i in LINKS]
    arm = hf.Arm(joints, links, hf.Pose(np.eye(3), TIP))
    trunk = hf.Trunk(floating=hf.Link(base_mass, BASE[0], base_mass * BASE[1] * np.eye(3)))
    box = hf.HeldObject(BOX[0], BOX[2] * np.eye(3), BOX[1])
    chain = hf.ClosedChain(
        {"arm": arm}, box, {"arm": hf.Grasp("rigid", hf.Pose.identity())}, [0, 0, 0], trunk, {"arm": "base"}
    )
    return chain, Recording(t, **{name: np.array(column) for name, column in rows.items()})
