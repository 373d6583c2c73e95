"""Momentum observer: the external wrench on the object, and external torques on the arms, without a sensor there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from holdfast.control.balanced_torques import sum_at_object
from holdfast.control.controller import ControlLaw, Controller, GivenLaw, Torque, known_breakpoints
from holdfast.control.digital_law import evaluated
from holdfast.control.gains import require_stable
from holdfast.control.traced_law import law_key, law_of
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, needed_wrench
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.sequential import rest_response, sequential, tips_of, tips_under
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.inverse import torques
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.serial_chain import serial_chain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.linalg import ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, sqrt, where
from holdfast.spatial.vector import largest
from holdfast.state import Inputs, State


class Observation(NamedTuple):
    """What an observer has found.

    Attributes:
        object_wrench: (6,) external wrench on the object about C, world axes.
        joint_torques: (n,) external torques on the joints; None if grasp wrenches are not measured.
        touched: by name whether something pushes: `object`, and every arm if grasp wrenches are measured.
    """

    object_wrench: Array
    joint_torques: Array | None
    touched: dict[str, bool]


def observed(
    law: ControlLaw | Controller,
    chain: ClosedChain,
    *,
    gain: float,
    sample_time: float,
    measured: bool = False,
    threshold: float = 10.0,
    release: float = 0.5,
) -> ControlLaw:
    """Return the law with an observer of external wrenches in its memory, which `observation` reads.

    Without measured grasp wrenches, all is taken for a push on the object,
    r_k+1 = r_k + K_o L (V_k+1 - V_k - T alpha(x_k, tau_k, r_k)), with alpha from forward dynamics and the inertia L of
    the closed chain at C, for every grasp and for redundant arms. With measured grasp wrenches f, object and arms are
    apart, r_k+1 = r_k + K_o T (M a + b - u - r_k) with the differences a of velocities and the known loads u: pushes on
    the arms are found, too. In both, an error shrinks by 1 - K_o T per sample. If the law has a parameter
    `external_wrench`, it is given r.

    Args:
        law: a `ControlLaw` without sampling, or a controller of the library.
        chain: the controller's model of the chain.
        gain: K_o [1/s].
        sample_time: T [s], that of `sampled` around the result, or the step of a rollout.
        measured: whether grasp wrenches are measured; they are then the parameter `measured_wrenches` (arms, 6).
        threshold: size of r from which something is touched: forces, and moments divided by the distance of the grasps
            from C [N]; of an arm, its largest external torque [N m or N].
        release: part of the threshold below which nothing is touched any more.

    Raises:
        ModelError: K_o T >= 1, a number is out of range, or the law cannot be traced.
        MethodNotApplicable: no arm has a grasp, or a base floats and grasp wrenches are measured.

    Reference:
        De Luca and Haddadin, Sensorless robot collision detection and hybrid force/motion control, ICRA 2005.
    """
    serial_chain(chain, "observed: chain")
    own = law if isinstance(law, ControlLaw) else None if isinstance(law, GivenLaw) else law_of(law, chain)
    if own is None:
        raise ModelError(
            f"observed: expected a ControlLaw or a built-in controller, got {type(law).__name__}; try"
            " ControlLaw(torque), with values of its parameters given to the run"
        )
    rate = checks.number(gain, "observed: gain", above=0.0)
    period = checks.number(sample_time, "observed: sample_time", above=0.0)
    require_stable("observed: gain", "gain * sample_time", rate * period, 1.0, "without overshoot")
    most = checks.number(threshold, "observed: threshold", above=0.0)
    least = checks.number(release, "observed: release", at_least=0.0)
    if least > 1.0:
        raise ModelError(f"observed: release: expected at most 1, got {least:g}")
    by_arm = checks.flag(measured, "observed: measured", ModelError)
    if not chain.grasps or (by_arm and chain.floats):
        what = "a floating base" if chain.grasps else "no grasp"
        raise MethodNotApplicable(f"observed: expected arms on fixed bases that hold the object, got {what}")
    torque = ObservedTorques(own, chain, rate, period, by_arm, most, least)
    parameters = {name: shape for name, shape in own.parameters.items() if name != "external_wrench"}
    parameters |= {"measured_wrenches": (len(chain.arms), 6)} if by_arm else {}
    inner = law_key(own, chain)
    key = f"observed/{exact_fingerprint([chain, rate, period, by_arm, most, least])}/{inner}" if inner else ""
    return ControlLaw(torque, torque.memory(), parameters, key)


def observation(law: ControlLaw, memory: Array) -> Observation:
    """Return what the observer of a law has found.

    Args:
        law: the law that `observed` returned.
        memory: (m,) its memory after some step, such as `systems.memory[k]` of a rollout.

    Raises:
        ModelError: the law has no observer.
        StateError: the memory has another shape.
    """
    checks.instance(law, ControlLaw, "observation: law")
    torque = law.torque
    if not isinstance(torque, ObservedTorques):
        raise ModelError("observation: law: expected one that observed(...) returned, got another")
    _, r, flags, _ = torque.parts(checks.numbers(memory, law.memory.shape, "observation: memory", StateError))
    names = ["object", *(torque.chain.names if torque.measured else [])]
    touched = {name: bool(flag > 0.5) for name, flag in zip(names, flags, strict=True)}
    return Observation(r[:6], r[6:] if torque.measured else None, touched)


@dataclass(frozen=True, eq=False)
class ObservedTorques(Frozen):
    """The torques of a law with an observer; the attributes are the arguments of `observed`.

    The memory consists of that of the law, r, the flags, and of the last sample: the velocities expected for the next
    one or, with measured wrenches, velocities and torques; and whether there was a sample.
    """

    law: ControlLaw
    chain: ClosedChain
    gain: float
    sample_time: float
    measured: bool
    threshold: float
    release: float

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """The sizes of the memory's parts."""
        n, arms = self.chain.joint_count, len(self.chain.arms)
        r, flags, last = (6 + n, 1 + arms, 6 + 2 * n + 1) if self.measured else (6, 1, 6 + 1)
        return len(self.law.memory), r, flags, last

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its torques jump [s], as far as they are known in advance."""
        return known_breakpoints(self.law)

    def memory(self) -> Array:
        """Return the initial memory."""
        return np.concatenate([self.law.memory, np.zeros(sum(self.sizes[1:]))])

    def parts(self, memory: Array) -> list[Array]:
        """Return the memory of the law, r, the flags, and the last sample."""
        return np.split(memory, np.cumsum(self.sizes)[:-1])

    def for_chain(self, chain: ClosedChain) -> Torque:
        """Return the torques for a chain whose grasps have changed."""
        return replace(self, chain=chain, law=self.law.for_chain(chain))

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory."""
        own, r, flags, last = self.parts(memory)
        still = chain_motion(self.chain, state, np.zeros(self.chain.joint_count), Inputs().shaped(self.chain))
        tips: Mapping[str, TipResponse] = {}
        if self.measured:
            change = self._by_bodies(still, state, r, last, given)
        else:
            tips = tips_of(still)
            P = rest_response(still, tips).mobility
            change = ldl_solve(ldl(P, np.diag(P)), state.object_twist - last[:6])
        r = where(last[-1] > 0.5, r + self.gain * change, r)
        known = {name: given[name] for name in self.law.parameters if name != "external_wrench"}
        tau, kept = evaluated(self.law, self.chain.joint_count, t, state, own, known | {"external_wrench": r[:6]})
        if self.measured:
            last = [state.object_twist, state.qd, tau]
        else:
            motion = chain_motion(self.chain, state, tau, Inputs(object_wrench=r).shaped(self.chain), still)
            found = sequential(motion, tips=tips_under(motion, tips))
            alpha = chain_solution(motion, found, "auto").object_acceleration
            last = [state.object_twist + self.sample_time * alpha]
        return tau, checks.finite(concatenate([kept, r, self._flags(r, flags), *last, [1.0]]), "observed: memory")

    def _by_bodies(self, motion: ChainMotion, state: State, r: Array, last: Array, given: Mapping[str, Array]) -> Array:
        """Return T (M a + b - u - r) of object and joints, (6 + n,)."""
        chain, f = self.chain, given["measured_wrenches"]
        before, rates, tau = np.split(last[:-1], [6, 6 + chain.joint_count])
        alpha, qdd = (state.object_twist - before) / self.sample_time, (state.qd - rates) / self.sample_time
        on_object = needed_wrench(motion, alpha) - sum_at_object(motion, f)
        return self.sample_time * (concatenate([on_object, torques(motion, qdd, f) - tau]) - r)

    def _flags(self, r: Array, flags: Array) -> Array:
        """Return the flags, which rise above the threshold and fall below a part of it."""
        length = length_scale([grasp.frame.p for grasp in self.chain.grasps.values()])
        scaled = r[:6] * np.r_[np.full(3, 1 / length), np.ones(3)]
        sizes = [sqrt(scaled @ scaled)]
        if self.measured:
            for part in self.chain.arm_joints:
                own = r[6:][part]
                sizes.append(largest(own) if len(own) else 0.0)
        needed = [where(flag > 0.5, self.release, 1.0) * self.threshold for flag in flags]
        return array([where(size > most, 1.0, 0.0) for size, most in zip(sizes, needed, strict=True)])
