"""A slider-crank whose slider has a clearance in its guide: one arm and an object, and equations in three angles.

Crank and rod turn by t1 and t2 from the x axis, and the slider, held at its centre, by t3; gravity is along -y. The
parameters are those of Flores, Leine and Glocker, "Modeling and analysis of planar rigid multibody systems with
translational clearance joints based on the non-smooth dynamics approach", 2010.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.world import HalfSpace, Touching

L1, L2, A, B, CLEARANCE = 0.153, 0.306, 0.05, 0.025, 1e-3
M1, M2, M3, J1, J2, J3 = 0.038, 0.038, 0.076, 7.4e-5, 5.9e-4, 2.7e-6
RATES, FRICTION, RESTITUTION, G = (150.0, -75.0), 0.01, 0.4, 9.81
ALONG_Z = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]  # the hinge's axis is the z axis of the plane
CORNERS = {name: (x, y) for name, x, y in (("--", -A, -B), ("+-", A, -B), ("-+", -A, B), ("++", A, B))}


def slider_chain(spin: float = 0.0) -> tuple[hf.ClosedChain, hf.State]:
    """Return the chain, and its state with all angles zero, in which the slider turns with a spin."""

    def link(mass: float, inertia: float, length: float) -> hf.Link:
        return hf.Link(mass, [length / 2, 0, 0], np.diag([inertia / 2, inertia, inertia]))

    joints = [hf.Joint("revolute", [0, 0, 1]), hf.Joint("revolute", [0, 0, 1], hf.Pose.translation(L1, 0, 0))]
    tip = hf.Pose(np.array(ALONG_Z), [L2, 0, 0])
    crank = hf.Arm(joints, [link(M1, J1, L1), link(M2, J2, L2)], tip=tip)
    guides = {
        "below": HalfSpace(normal=[0, 1, 0], offset=-B - CLEARANCE, friction=FRICTION, restitution=RESTITUTION),
        "above": HalfSpace(normal=[0, -1, 0], offset=-B - CLEARANCE, friction=FRICTION, restitution=RESTITUTION),
    }
    pairs = [(name, "below" if name[1] == "-" else "above") for name in CORNERS]
    touching = Touching({name: [x, y, 0.0] for name, (x, y) in CORNERS.items()}, guides, pairs)
    slider = hf.HeldObject(M3, np.diag([J3, J3, J3]))
    grasp = hf.Grasp("hinge", hf.Pose(np.array(ALONG_Z), [0, 0, 0]))
    chain = hf.ClosedChain({"crank": crank}, slider, {"crank": grasp}, [0, -G, 0], touching=touching)
    w1, w2 = RATES
    twist = [0, 0, spin, 0, L1 * w1 + L2 * w2, 0]
    return chain, hf.State([0, 0], [w1, w2 - w1], [1, 0, 0, 0, L1 + L2, 0, 0], twist)


def mass(t: np.ndarray) -> np.ndarray:
    """Return the mass matrix (3, 3) of the rates of t1, t2 and t3."""
    a, b = J1 + M1 * L1**2 / 4 + (M2 + M3) * L1**2, J2 + M2 * L2**2 / 4 + M3 * L2**2
    c = (M2 / 2 + M3) * L1 * L2 * np.cos(t[0] - t[1])
    return np.array([[a, c, 0.0], [c, b, 0.0], [0.0, 0.0, J3]])


def slopes(t: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the accelerations of the angles without contacts, by Lagrange's equations."""
    s = (M2 / 2 + M3) * L1 * L2 * np.sin(t[0] - t[1])
    pull = [(M1 / 2 + M2 + M3) * L1 * np.cos(t[0]), (M2 / 2 + M3) * L2 * np.cos(t[1]), 0.0]
    return np.linalg.solve(mass(t), np.array([-s * w[1] ** 2, s * w[0] ** 2, 0.0]) - G * np.array(pull))


def gap(name: str, t: np.ndarray) -> float:
    """Return the distance of a corner from its guide."""
    x, y = CORNERS[name]
    height = L1 * np.sin(t[0]) + L2 * np.sin(t[1]) + x * np.sin(t[2]) + y * np.cos(t[2])
    return float(B + CLEARANCE + (height if y < 0 else -height))


def rows(name: str, t: np.ndarray) -> np.ndarray:
    """Return the rows (2, 3) of a corner's velocities along x and into the object."""
    x, y = CORNERS[name]
    s, c = np.sin(t), np.cos(t)
    along = [-L1 * s[0], -L2 * s[1], -x * s[2] - y * c[2]]
    up = np.array([L1 * c[0], L2 * c[1], x * c[2] - y * s[2]])
    return np.array([along, up if y < 0 else -up])


def struck(names: list[str], t: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the rates after an impact of some corners: Coulomb's law by all modes, then e times the impulse again."""
    C, M = np.concatenate([rows(name, t) for name in names]), mass(t)
    P, b, k = C @ np.linalg.solve(M, C.T), C @ w, len(names)
    found = []
    for modes in product(("open", "sticks", 1.0, -1.0), repeat=k):  # a number is the sign of the slip
        push, keep = [], []
        for j, mode in enumerate(modes):
            x, n = np.eye(2 * k)[2 * j : 2 * j + 2]
            push += [] if mode == "open" else [x, n] if mode == "sticks" else [n - mode * FRICTION * x]
            keep += [] if mode == "open" else [x, n] if mode == "sticks" else [n]
        N, R = np.array(push).reshape(-1, 2 * k), np.array(keep).reshape(-1, 2 * k)
        impulse = N.T @ np.linalg.lstsq(R @ P @ N.T, -R @ b, rcond=1e-10)[0]
        u, p = (b + P @ impulse).reshape(k, 2), impulse.reshape(k, 2)
        holds = np.abs(R @ u.ravel()).max(initial=0.0) < 1e-9 and u[:, 1].min() > -1e-9 and p[:, 1].min() >= 0.0
        holds = holds and (np.abs(p[:, 0]) <= FRICTION * p[:, 1] + 1e-15).all()
        if holds and all(mode in ("open", "sticks") or mode * one[0] > 0.0 for mode, one in zip(modes, u, strict=True)):
            found.append(np.linalg.solve(M, C.T @ impulse))
    assert len(found) and all(np.abs(one - found[0]).max() < 1e-9 for one in found)
    return w + (1.0 + RESTITUTION) * found[0]


def true_impacts(count: int, spin: float = 0.0) -> list[tuple[float, list[str], np.ndarray, np.ndarray]]:
    """Return time, corners, angles and rates after each of the first impacts, by SciPy's order 8 to 1e-13."""
    found, t0, x = [], 0.0, np.array([0.0, 0.0, 0.0, *RATES, spin])

    def event(name: str):
        def value(_: float, x: np.ndarray) -> float:
            return gap(name, x[:3])

        value.terminal, value.direction = True, -1
        return value

    for _ in range(count):
        events = [event(name) for name in CORNERS]
        run = solve_ivp(
            lambda _, x: np.concatenate([x[3:], slopes(x[:3], x[3:])]),
            (t0, t0 + 1.0),
            x,
            method="DOP853",
            rtol=1e-13,
            atol=1e-15,
            events=events,
            max_step=1e-4,
        )
        hit = next(i for i, times in enumerate(run.t_events) if len(times))
        t0, x = float(run.t_events[hit][0]), run.y_events[hit][0]
        names = [name for name in CORNERS if gap(name, x[:3]) < 1e-12]
        x = np.concatenate([x[:3], struck(names, x[:3], x[3:])])
        found.append((t0, names, x[:3], x[3:]))
    return found
