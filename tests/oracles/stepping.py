"""Judge an answer by moving the system: steps, kinetic energy and power.

A right answer keeps the grasps closed after a small step, and the kinetic energy
changes at the rate of the power put in.  Neither uses the KKT system, so both check
the oracle itself, external wrenches and base wrenches included.
"""

import copy
from collections.abc import Callable

import numpy as np

from tests.oracles.arithmetic import arithmetic
from tests.oracles.arm_kinematics import MovingFrame, cross, link_frames, rotation_about

FLOATS = arithmetic(None)


def stepped(case: dict, answer: dict, dt: float) -> dict:
    """Return the case a step dt [s] later (or earlier), exact to the second order."""
    later = copy.deepcopy(case)
    _move_body(later["object"], answer["alpha_C"], dt)
    for i, arm in enumerate(later["arms"]):
        qd, qdd = np.array(arm["qd"]), answer["qdd"][i]
        arm["q"] = np.array(arm["q"]) + qd * dt + qdd * dt**2 / 2.0
        arm["qd"] = qd + qdd * dt
        base = arm["base"]
        _move_body(base, np.concatenate([base["omega_dot"], base["v_dot"]]), dt)
        if arm["grasp"] is not None:
            arm["grasp"]["W"] = np.array(arm["grasp"]["W"]) + answer["W_dot"][i] * dt
    return later


def runge_kutta(slope: Callable[[np.ndarray], np.ndarray], y: np.ndarray, duration: float, steps: int) -> np.ndarray:
    """Return y after a time by steps of the classical Runge-Kutta scheme."""
    h = duration / steps
    for _ in range(steps):
        k1 = slope(y)
        k2 = slope(y + h / 2 * k1)
        k3 = slope(y + h / 2 * k2)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(y + h * k3))
    return y


def constrained(M: np.ndarray, f: np.ndarray, J: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Return a of M a + J^T lambda = f, J a = -bias; the forces lambda need not be unique."""
    whole = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
    return np.linalg.lstsq(whole, np.concatenate([f, -bias]), rcond=1e-13)[0][: len(M)]


def random_rates(random: np.random.Generator, J: np.ndarray) -> np.ndarray:
    """Return random rates with J rates = 0, none of them above 1."""
    _, sizes, Vt = np.linalg.svd(J)
    free = Vt[int((sizes > 1e-9).sum()) :]
    rates = random.normal(size=len(free)) @ free
    return rates / max(1.0, float(np.abs(rates).max()))


def _move_body(body: dict, alpha: np.ndarray, dt: float) -> None:
    """Advance pose and twist of a body with acceleration [omega_dot; v_dot]."""
    omega, v = np.array(body["omega"]), np.array(body["v"])
    turn = omega * dt + alpha[:3] * dt**2 / 2.0
    angle = float(np.linalg.norm(turn))
    if angle > 0.0:
        body["R"] = rotation_about(turn / angle, angle, FLOATS) @ np.array(body["R"])
    body["p"] = np.array(body["p"]) + v * dt + alpha[3:] * dt**2 / 2.0
    body["omega"], body["v"] = omega + alpha[:3] * dt, v + alpha[3:] * dt


def kinetic_energy(case: dict) -> float:
    """Return the kinetic energy of links, rotors and object [J]."""
    energy = _body_energy(case["object"], _object_frame(case))
    for arm in case["arms"]:
        for link, frame in zip(arm["links"], link_frames(arm, FLOATS), strict=True):
            energy += _body_energy(link, frame)
        for joint, rate in zip(arm["joints"], arm["qd"], strict=True):
            energy += 0.5 * joint.get("armature", 0.0) * rate**2
    return float(energy)


def power(case: dict, answer: dict) -> float:
    """Return the power put in by joints, weights, bases and external wrenches [W]."""
    gravity = np.array(case["gravity"])
    body, held = case["object"], _object_frame(case)
    total = _weight_power(body, held, gravity)
    total += _wrench_power(body.get("wrench", np.zeros(6)), held)
    for i, arm in enumerate(case["arms"]):
        base = arm["base"]
        total += answer["base_wrench"][i] @ np.concatenate([base["omega"], base["v"]])
        for joint, rate, tau in zip(arm["joints"], arm["qd"], arm["tau"], strict=True):
            total += (tau - joint.get("damping", 0.0) * rate) * rate
        wrenches = arm.get("link_wrench", np.zeros((len(arm["q"]), 6)))
        parts = zip(arm["links"], link_frames(arm, FLOATS), wrenches, strict=True)
        for link, frame, wrench in parts:
            total += _weight_power(link, frame, gravity) + _wrench_power(wrench, frame)
    return float(total)


def _object_frame(case: dict) -> MovingFrame:
    """Return the object's frame; its accelerations are not used here."""
    keys = ("R", "p", "omega", "v", "omega", "v")
    return MovingFrame(*(np.array(case["object"][key]) for key in keys))


def _body_energy(body: dict, frame: MovingFrame) -> float:
    """Return one body's kinetic energy [J]."""
    velocity = frame.point_velocity(np.array(body["com"]))
    local = frame.R.T @ frame.omega
    return 0.5 * (body["mass"] * velocity @ velocity + local @ np.array(body["inertia"]) @ local)


def _weight_power(body: dict, frame: MovingFrame, gravity: np.ndarray) -> float:
    """Return the power of one body's weight [W]."""
    return body["mass"] * gravity @ frame.point_velocity(np.array(body["com"]))


def _wrench_power(wrench, frame: MovingFrame) -> float:
    """Return the power of a wrench [moment; force] about the frame's origin [W]."""
    return np.asarray(wrench) @ np.concatenate([frame.omega, frame.v])


def wrench_about_C(case: dict, f: list[np.ndarray]) -> np.ndarray:
    """Return the sum of all grasp wrenches [moment; force] about the object's C."""
    total = np.zeros(6)
    for arm, wrench in zip(case["arms"], f, strict=True):
        if arm["grasp"] is not None:
            wrench = np.asarray(wrench)
            lever = np.array(case["object"]["R"]) @ np.array(arm["grasp"]["point_object"])
            total += np.concatenate([wrench[:3] + cross(lever, wrench[3:]), wrench[3:]])
    return total
