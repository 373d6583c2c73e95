"""Spherical mechanisms, in space and, apart from the library, as bodies that turn about one point.

Every axis of every arm passes through the world's origin, so the object turns about it too. In space the grasps also
say that it keeps its distance, again and again. Here a link has an attitude and nothing else: its angular velocity is
a sum of axes times rates, and what closes a loop are three components of it, or two beside a hinge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State
from tests.oracles.stepping import constrained, random_rates, runge_kutta

GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class SphericalArm:
    """Axes and links in the frame of the link before, at zero angles; the contact in object axes.

    Attributes:
        axes: (k, 3) unit vectors.
        masses: (k,).
        centres: (k, 3) mass centres from the origin, link axes.
        inertias: (k, 3, 3) about the mass centre, link axes.
        hinge: whether the arm holds by a hinge through the origin, or rigidly.
        contact: (3,) in object axes, from the origin; the hinge's axis is along it.
    """

    axes: np.ndarray
    masses: np.ndarray
    centres: np.ndarray
    inertias: np.ndarray
    hinge: bool
    contact: np.ndarray


@dataclass(frozen=True)
class SphericalMechanism:
    """Arms and an object, where and how fast it starts.

    Attributes:
        arms: the arms.
        mass, centre, inertia: of the object, about its mass centre, which is `centre` from the origin; object axes.
        q: joint angles; the object's axes are the world's at the start.
        rates: of the joint angles, then the object's angular velocity.
    """

    arms: list[SphericalArm]
    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    q: np.ndarray
    rates: np.ndarray

    def after(self, duration: float) -> np.ndarray:
        """Return the joint angles after a time, by SciPy's order 8."""
        found = solve_ivp(self.slope, (0.0, duration), self.at_start(), "DOP853", rtol=1e-12, atol=1e-13)
        return found.y[: len(self.q), -1]

    def stepped(self, duration: float, steps: int) -> np.ndarray:
        """Return the joint angles after a time, by steps of the classical Runge-Kutta scheme."""
        return runge_kutta(lambda y: self.slope(0.0, y), self.at_start(), duration, steps)[: len(self.q)]

    def at_start(self) -> np.ndarray:
        """Return joint angles, the object's attitude as nine numbers, and rates."""
        return np.concatenate([self.q, np.eye(3).ravel(), self.rates])

    def slope(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return d/dt of joint angles, attitude and rates."""
        n = len(self.q)
        R, u = y[n : n + 9].reshape(3, 3), y[n + 9 :]
        found = constrained(*self.equations(y[:n], R, u))
        return np.concatenate([u[:n], (np.cross(np.eye(3), u[n:]) @ R).ravel(), found])

    def equations(self, q: np.ndarray, R: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return M, f, J and J' u of rates (joints, object's angular velocity)."""
        n = len(q)
        M, f, rows, biases, at = np.zeros((n + 3, n + 3)), np.zeros(n + 3), [], [], 0

        def add(mass, centre, inertia, turn, J, drift):
            """Add a body: attitude, angular velocity J u, angular acceleration J a + drift."""
            I = turn @ (inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))) @ turn.T
            w = J @ u
            M[...] += J.T @ I @ J
            f[...] -= J.T @ (I @ drift + np.cross(w, I @ w) - np.cross(turn @ centre, mass * GRAVITY))

        whole = np.zeros((3, n + 3))
        whole[:, n:] = np.eye(3)
        add(self.mass, self.centre, self.inertia, R, whole, np.zeros(3))
        for arm in self.arms:
            turn, J, w, drift = np.eye(3), np.zeros((3, n + 3)), np.zeros(3), np.zeros(3)
            for k, axis in enumerate(arm.axes):
                z = turn @ axis
                J[:, at + k] = z
                drift = drift + np.cross(w, z) * u[at + k]
                w = w + z * u[at + k]
                turn = turn @ Rotation.from_rotvec(q[at + k] * axis).as_matrix()
                add(arm.masses[k], arm.centres[k], arm.inertias[k], turn, J.copy(), drift)
            at += len(arm.axes)
            gap, bias = J - whole, drift
            if arm.hinge:
                h = R @ arm.contact / np.linalg.norm(arm.contact)
                across = np.linalg.svd(h[None])[2][1:]
                turning = np.cross(u[n:], across)  # the rows turn with the object
                rows += list(across @ gap)
                biases += list(across @ bias + turning @ (gap @ u))
            else:
                rows += list(gap)
                biases += list(bias)
        return M, f, np.array(rows), np.array(biases)

    def chain(self) -> tuple[ClosedChain, State]:
        """Return the mechanism in space."""
        arms, grasps, at = {}, {}, 0
        for i, arm in enumerate(self.arms):
            joints = [Joint("revolute", axis) for axis in arm.axes]
            parts = zip(arm.masses, arm.centres, arm.inertias, strict=True)
            links = [Link(mass, centre, inertia) for mass, centre, inertia in parts]
            turn = np.eye(3)
            for axis, angle in zip(arm.axes, self.q[at : at + len(joints)], strict=True):
                turn = turn @ Rotation.from_rotvec(angle * axis).as_matrix()
            at += len(joints)
            across = np.linalg.svd(arm.contact[None])[2]
            across = across if np.linalg.det(across) > 0 else across * [[1], [1], [-1]]
            frame = across.T  # its x axis is the hinge's
            arms[f"arm{i}"] = Arm(joints, links, tip=Pose(turn.T @ frame, turn.T @ arm.contact))
            kind = "hinge" if arm.hinge else "rigid"
            grasps[f"arm{i}"] = Grasp(kind, Pose(frame, arm.contact - self.centre))
        chain = ClosedChain(arms, HeldObject(self.mass, self.inertia), grasps, gravity=GRAVITY)
        n, w = len(self.q), self.rates[-3:]
        twist = [*w, *np.cross(w, self.centre)]
        return chain, State(self.q, self.rates[:n], [1, 0, 0, 0, *self.centre], twist)


def random_spherical(seed: int) -> SphericalMechanism:
    """Return two or three arms of two to four joints about the origin, with a freedom left, in motion."""
    random = np.random.default_rng(seed)
    while True:
        counts = random.integers(2, 5, size=random.integers(2, 4))
        hinges = random.random(len(counts)) < 0.5
        freedoms = counts.sum() + 3 - sum(2 if hinge else 3 for hinge in hinges)
        if 1 <= freedoms <= 5:
            break

    def inertia() -> np.ndarray:
        R = Rotation.random(random_state=random).as_matrix()
        return R @ np.diag(random.uniform(0.02, 0.03, size=3)) @ R.T

    arms, angles = [], []
    for count, hinge in zip(counts, hinges, strict=True):
        axes = random.normal(size=(count, 3))
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        centres = random.uniform(-0.3, 0.3, size=(count, 3))
        inertias = np.array([inertia() for _ in range(count)])
        contact = random.normal(size=3)
        contact *= 0.4 / np.linalg.norm(contact)
        arms.append(SphericalArm(axes, random.uniform(0.5, 2.0, size=count), centres, inertias, bool(hinge), contact))
        angles.append(random.uniform(-2.0, 2.0, size=count))
    q, n = np.concatenate(angles), int(counts.sum())
    centre = random.uniform(-0.2, 0.2, size=3)
    still = SphericalMechanism(arms, random.uniform(0.5, 4.0), centre, inertia(), q, np.zeros(n + 3))
    J = still.equations(q, np.eye(3), np.zeros(n + 3))[2]
    return SphericalMechanism(arms, still.mass, centre, still.inertia, q, 1.5 * random_rates(random, J))
