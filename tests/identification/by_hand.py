"""Random arms that carry random payloads along sums of sines, by textbook equations in world axes.

Nothing of the library computes anything here: positions are sums of sines, whose derivatives are known, and links and
payload move and load each other by the recursive equations of Newton and Euler. The library's classes only hold the
numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import holdfast as hf
from holdfast.identification import Recording

DOWN = np.array([0.0, 0.0, -9.81])
NOISES = ("exact", "white", "quantised", "coloured", "white positions", "quantised positions")


@dataclass(frozen=True)
class Case:
    """A payload, the chain with a wrong guess of it, and what was recorded."""

    chain: hf.ClosedChain
    payload: hf.HeldObject
    recording: Recording
    by: str
    noise: str

    @property
    def truth(self) -> np.ndarray:
        """Mass, mass centre, inertia about it, (10,)."""
        body = self.payload
        return np.r_[body.mass, body.com, body.inertia[np.triu_indices(3)]]

    @property
    def sizes(self) -> np.ndarray:
        """Their sizes, (10,)."""
        m = self.payload.mass
        r = np.sqrt(np.trace(self.payload.inertia) / 2 / m)
        return np.r_[m, [r] * 3, [m * r * r] * 6]


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation about an axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return about(axis / np.linalg.norm(axis), rng.uniform(-np.pi, np.pi))


def random_body(rng: np.random.Generator, mass: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mass centre and inertia about it of twelve random points of equal mass."""
    points = rng.normal(size=(12, 3)) * size * rng.uniform(0.3, 1.0, 3) @ random_rotation(rng)
    c = points.mean(axis=0)
    x = points - c
    return rng.normal(size=3) * size, mass / 12 * (np.sum(x * x) * np.eye(3) - x.T @ x)


def random_arm(rng: np.random.Generator, joints: int) -> hf.Arm:
    """Return an arm, mostly of revolute joints, with drives and friction."""
    made, links = [], []
    for _ in range(joints):
        axis = random_rotation(rng)[0]
        placement = hf.Pose(random_rotation(rng), 0.25 * rng.normal(size=3))
        kind = "prismatic" if rng.random() < 0.15 else "revolute"
        drive = {"armature": rng.uniform(0, 0.2), "damping": rng.uniform(0, 1), "friction": rng.uniform(0, 0.5)}
        made.append(hf.Joint(kind, axis, placement, **drive))
        m = rng.uniform(0.5, 4.0)
        links.append(hf.Link(m, *random_body(rng, m, 0.08)))
    return hf.Arm(made, links, hf.Pose(random_rotation(rng), 0.1 * rng.normal(size=3)), hf.Pose.identity())


def swings(rng: np.random.Generator, t: np.ndarray, joints: int) -> list[np.ndarray]:
    """Return positions, rates and accelerations, (samples, joints) each: three sines a joint."""
    f = 2 * np.pi * rng.uniform(0.15, 0.9, (3, joints))
    size, phase = rng.uniform(0.05, 0.35, (3, joints)), rng.uniform(0, 2 * np.pi, (3, joints))
    x = t[:, None, None] * f + phase
    parts = size * np.sin(x), size * f * np.cos(x), -size * f**2 * np.sin(x)
    return [part.sum(axis=1) for part in parts]


def loads(
    arm: hf.Arm, payload: hf.HeldObject, grasp: hf.Pose, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the wrench on the payload, [moment; force] about the tip in its axes, and the joint torques."""
    R, p, w, dw, a = np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    frames = []
    for joint, x, v, dv in zip(arm.joints, q, qd, qdd, strict=True):
        R0 = R @ joint.placement.R
        z = R0 @ joint.axis
        slides = joint.kind == "prismatic"
        d = R @ joint.placement.p + (z * x if slides else 0)
        a = a + np.cross(dw, d) + np.cross(w, np.cross(w, d))
        p = p + d
        if slides:
            a, R = a + 2 * np.cross(w, z) * v + z * dv, R0
        else:
            R, dw, w = R0 @ about(joint.axis, x), dw + np.cross(w, z) * v + z * dv, w + z * v
        frames.append((R, p, z, w, dw, a, slides))

    def load(body, R: np.ndarray, w: np.ndarray, dw: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return moment about the frame's origin, and force, that move a body."""
        c, I = R @ body.com, R @ body.inertia @ R.T
        force = body.mass * (a + np.cross(dw, c) + np.cross(w, np.cross(w, c)) - DOWN)
        return I @ dw + np.cross(w, I @ w) + np.cross(c, force), force

    R, p, _, w, dw, a, _ = frames[-1]
    tip, lever = R @ arm.tip.R, R @ arm.tip.p
    C_R = tip @ grasp.R.T
    to_C = lever - C_R @ grasp.p
    at_C = a + np.cross(dw, to_C) + np.cross(w, np.cross(w, to_C))
    moment, force = load(payload, C_R, w, dw, at_C)
    wrench = np.r_[tip.T @ (moment + np.cross(to_C - lever, force)), tip.T @ force]
    n, f, beyond = moment + np.cross(to_C, force), force, p
    tau = np.zeros(len(q))
    for k in range(len(q) - 1, -1, -1):
        R, p, z, w, dw, a, slides = frames[k]
        n = n + np.cross(beyond - p, f)
        own_n, own_f = load(arm.links[k], R, w, dw, a)
        n, f, beyond = n + own_n, f + own_f, p
        joint = arm.joints[k]
        rubbing = joint.friction * qd[k] / np.sqrt(qd[k] ** 2 + 0.05**2)  # as the model's friction is defined
        tau[k] = z @ (f if slides else n) + joint.armature * qdd[k] + joint.damping * qd[k] + rubbing
    return wrench, tau


def random_case(seed: int, noise: str, by: str, samples: int = 0) -> Case:
    """Return a random case; the guess is within a factor of ten of mass and inertia."""
    rng = np.random.default_rng([seed, NOISES.index(noise)])
    joints = int(rng.integers(2 if by == "wrist_wrench" else 4, 8))
    arm = random_arm(rng, joints)
    mass = 10 ** rng.uniform(-0.3, 1.0)
    com, inertia = random_body(rng, mass, rng.uniform(0.05, 0.15))
    payload = hf.HeldObject(mass, inertia, com)
    m, r = mass * 10 ** rng.uniform(-1, 1), np.sqrt(np.trace(inertia) / 2 / mass)
    edges = r * 10 ** rng.uniform(-0.5, 0.5) * np.sqrt(2) * rng.uniform(0.8, 1.2, 3)
    guess = hf.HeldObject.box(m, *edges)
    grasp = hf.Pose(random_rotation(rng), rng.normal(size=3) * r)
    chain = hf.ClosedChain({"arm": arm}, guess, {"arm": hf.Grasp("rigid", grasp)})
    from_positions = noise.endswith("positions")
    t = np.arange(samples or (200 if from_positions else 100)) * (0.02 if from_positions else 0.05)
    q, qd, qdd = swings(rng, t, joints)
    found = [loads(arm, payload, grasp, *one) for one in zip(q, qd, qdd, strict=True)]
    measured = np.array([one[by == "tau"] for one in found])
    measured = disturbed(rng, measured, noise if not from_positions else rng.choice(["exact", "white"]))
    if from_positions:
        level = 10 ** rng.uniform(-5, -3.5)
        q = q + level * rng.normal(size=q.shape) if noise[0] == "w" else 3 * level * np.round(q / level / 3)
    given = {"tau": measured} if by == "tau" else {"wrist_wrench": measured[:, None]}
    rates = {} if from_positions else {"qd": qd, "qdd": qdd}
    return Case(chain, payload, Recording(t, q, **rates, **given), by, noise)


def disturbed(rng: np.random.Generator, measured: np.ndarray, noise: str) -> np.ndarray:
    """Return measurements with noise of up to five per cent of each half's or joint's size."""
    halves = (
        [slice(0, 3), slice(3, 6)] if measured.shape[1] == 6 else [slice(k, k + 1) for k in range(measured.shape[1])]
    )
    sizes = np.concatenate([[np.sqrt((measured[:, h] ** 2).mean())] * (h.stop - h.start) for h in halves])
    sizes = np.maximum(sizes, 0.01 * sizes.max()) * 10 ** rng.uniform(-3.0, -1.3)
    white = rng.normal(size=measured.shape)
    if noise == "white":
        return measured + sizes * white
    if noise == "quantised":
        step = sizes * np.sqrt(12.0)
        return step * np.round(measured / step)
    if noise == "coloured":
        for k in range(1, len(white)):
            white[k] = 0.9 * white[k - 1] + np.sqrt(1 - 0.81) * white[k]
        return measured + sizes * white
    return measured
