"""Random controllers of every kind, torques that hold a chain, and random wrenches on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.control import GravityCompensation, ObjectTracking, PoseSpline, RestToRest, TorqueSchedule, holding_law
from holdfast.spatial.scalar import array, concatenate, cos, sin

Random = np.random.Generator
LawAndParameters = tuple[Any, dict[str, Any]]


def hold(chain: hf.ClosedChain, state: hf.State, push: float = 0.0) -> np.ndarray:
    """Return torques that hold the chain at rest (n,), or zeros if none do [N m or N].

    Args:
        chain: the chain.
        state: its state, whose velocities do not count.
        push: of every arm along its contact normal [N].
    """
    try:
        return hf.holding_torques(chain, state.at_rest(), internal_force=push)
    except hf.HoldfastError:
        return np.zeros(chain.joint_count)


def _no_torques(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    return hf.ControlLaw(lambda t, now, memory, given: (0.0 * now.qd, memory))


def _constant(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    tau = hold(chain, state, push) + random.normal(size=chain.joint_count)
    return lambda t, now, memory: (tau, memory)


def _constant_law(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    tau = hold(chain, state, push) + random.normal(size=chain.joint_count)
    return hf.ControlLaw(lambda t, now, memory, given: (memory, memory), tau)


def _joint_springs(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    """A law with parameters: springs and dampers in all joints."""
    n = chain.joint_count

    def torque(t: Any, now: hf.State, memory: Any, given: Any) -> tuple[Any, Any]:
        return memory[:n] + given["stiffness"] * (memory[n:] - now.q) - given["damping"] * now.qd, memory

    law = hf.ControlLaw(torque, np.concatenate([hold(chain, state, push), state.q]), {"stiffness": (n,), "damping": ()})
    return law, {"stiffness": random.uniform(0.0, 50.0, n), "damping": np.array(random.uniform(0.0, 1.0))}


def _integral(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    """A law with a memory that grows."""
    n = chain.joint_count

    def torque(t: Any, now: hf.State, memory: Any, given: Any) -> tuple[Any, Any]:
        error = memory[n : 2 * n] - now.q
        drive = memory[:n] + 10.0 * error + 20.0 * memory[2 * n :] + sin(20.0 * t) * now.object_twist[3]
        return drive, concatenate([memory[: 2 * n], memory[2 * n :] + 1e-3 * error])

    return hf.ControlLaw(torque, np.concatenate([hold(chain, state, push), state.q, np.zeros(n)]))


def _function(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    """A Python function of time and state."""
    tau, n = hold(chain, state, push), chain.joint_count
    stiffness, drive, rate = random.uniform(0.0, 50.0, n), random.normal(size=n), random.uniform(5.0, 40.0)

    def controller(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        return tau + stiffness * (state.q - now.q) - 0.5 * now.qd + drive * np.sin(rate * t), memory

    return controller


def _counting(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    """A Python function that branches and counts in its memory, which holds from step to step."""
    tau, drive = hold(chain, state, push), random.normal(size=chain.joint_count)

    def controller(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        count = 0 if memory is None else memory
        return tau - 0.3 * now.qd + (drive if count % 3 else -0.5 * drive), count + 1

    return controller


def _linear_schedule(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    knots = np.sort(random.uniform(-0.1, 1.1, int(random.integers(2, 6)))) * duration
    tau = hold(chain, state, push) + 2.0 * random.normal(size=(len(knots), chain.joint_count))
    return TorqueSchedule.linear(knots, tau)


def _polynomials(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    """Pieces of cubics beside a function."""
    knots = np.array([0.0, random.uniform(0.2, 0.8)]) * duration
    pieces = random.normal(size=(2, chain.joint_count, 4)) / duration ** np.arange(4)
    tau = hold(chain, state, push)
    return TorqueSchedule(knots, list(pieces), beside=lambda t, now, memory: (tau - 0.1 * now.qd, memory))


def _gravity(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    return GravityCompensation(chain, push, random.uniform(0.0, 1.0))


def _tracking(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    shift, turn = 0.02 * random.normal(size=(2, 3))
    path = RestToRest(state.object_frame, shift, turn, begin=0.2 * duration, duration=random.uniform(0.5, 2) * duration)
    return ObjectTracking(chain, path, internal_force=push)


def _along_spline(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    poses = [state.object_frame]
    for _ in range(2):
        shift = hf.Pose.translation(*(0.01 * random.normal(size=3)))
        poses.append(shift @ poses[-1])
    return ObjectTracking(chain, PoseSpline(poses, duration * np.array([0.1, 0.5, 1.0])), push, damping=15.0)


def _holding_law(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float) -> Any:
    return holding_law(chain), {"acceleration": 0.2 * random.normal(size=6), "internal_force": np.array(push)}


LAWS: dict[str, Callable[..., Any]] = {
    "no torques": _no_torques,
    "constant": _constant,
    "constant law": _constant_law,
    "joint springs": _joint_springs,
    "integral": _integral,
    "function": _function,
    "counting": _counting,
    "linear schedule": _linear_schedule,
    "polynomials": _polynomials,
    "gravity compensation": _gravity,
    "object tracking": _tracking,
    "spline tracking": _along_spline,
    "holding law": _holding_law,
}
MODELS = ("gravity compensation", "object tracking", "spline tracking", "holding law")  # need arms that can hold


def random_law(random: Random, chain: hf.ClosedChain, state: hf.State, push: float, duration: float, among: Any) -> Any:
    """Return the name of a law, the law, and values of its parameters.

    Args:
        random: source of the random numbers.
        chain: the chain.
        state: its state at the start.
        push: of every arm along its contact normal [N].
        duration: of the run [s].
        among: names of `LAWS`.
    """
    name = str(random.choice(list(among)))
    made = LAWS[name](random, chain, state, push, duration)
    law, parameters = made if isinstance(made, tuple) else (made, None)
    return name, law, parameters


def random_inputs(random: Random, chain: hf.ClosedChain) -> tuple[str, Any]:
    """Return what kind of external wrenches act, and these: none, constant, or a function of time or of the state."""
    kind = str(random.choice(["none", "constant", "of time", "of state"], p=[0.55, 0.15, 0.15, 0.15]))
    on_object, links = 3.0 * random.normal(size=6), sum(arm.joint_count for arm in chain.arms.values())
    on_links, rate = random.normal(size=(links, 6)), random.uniform(5.0, 60.0)
    given: dict[str, Any] = {
        "none": None,
        "constant": hf.Inputs(object_wrench=on_object, link_wrenches=on_links if random.random() < 0.5 else None),
        "of time": lambda t: hf.Inputs(object_wrench=on_object * cos(rate * t)),
        "of state": lambda t, state: hf.Inputs(
            object_wrench=array(-on_object * state.object_twist), link_wrenches=on_links * state.qd[0]
        ),
    }
    return kind, given[kind]
