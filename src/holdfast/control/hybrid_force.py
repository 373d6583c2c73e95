"""Internal force with an integral: what wrist sensors measure is brought to what is wished."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from holdfast.compiler.program import Shape
from holdfast.control.balanced_torques import internal_part
from holdfast.control.gains import require_stable
from holdfast.control.internal_force import InternalForce
from holdfast.control.law_parts import GraspForces, LawInput
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.constraint import length_scale
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, making
from holdfast.spatial.scalar import Array, array, concatenate, maximum, sqrt, where
from holdfast.spatial.spatial_vector import rotate, unrotate
from holdfast.state import Inputs


@called
@dataclass(frozen=True, eq=False)
class HybridForce(GraspForces):
    """The integral of the internal force's error on top of wished forces, f_wish = f_d + I, for a sampled law.

    At sample k, I_k = I_k-1 + K_i T (f_d - f)_internal with the measured wrenches f; internal forces do not change the
    object's motion. In rigid chains they follow the torques at once, and the loop is the integral alone: an error
    shrinks by 1 - K_i T per sample, or as z^2 - z + K_i T = 0 if measurements are a sample late. For the next sample,
    I is what was achieved: the internal part of the wrenches that act, less that of f_d, so that it does not wind up
    where forces are limited.

    The law has the parameter `measured_wrenches` (arms, 6), as in `ForwardResult`, from sensors at the wrists; or
    `sensor` stands for them: the forward dynamics of that chain at the measured state, under the last torques.

    Attributes:
        gain: K_i [1/s].
        sample_time: T [s], that of `sampled` or the step of a rollout.
        around: f_d, grasp forces without memory; by default none beyond the smallest.
        limit: largest |I|, moments divided by the distance of the grasps from C [N].
        late: whether measurements are a sample late.
        sensor: the chain whose forces are measured; None for the parameter.

    Raises:
        ModelError: the loop is not stable, K_i T >= 2, or >= 1 if measurements are late; or a number is out of range.

    Reference:
        Uchiyama and Dauchez 1988; Wen and Kreutz-Delgado, Motion and force control of multiple robotic manipulators,
        Automatica 1992.
    """

    gain: float = REQUIRED
    sample_time: float = REQUIRED
    around: GraspForces = field(default_factory=making(InternalForce))
    limit: float = np.inf
    late: bool = False
    sensor: ClosedChain | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("gain", "sample_time"):
            put(self, name, checks.number(getattr(self, name), f"hybrid force: {name}", above=0.0))
        put(self, "limit", checks.limit(self.limit, "hybrid force: limit"))
        put(self, "late", checks.flag(self.late, "hybrid force: late", ModelError))
        checks.instance(self.around, GraspForces, "hybrid force: around")
        checks.instance(self.sensor, (ClosedChain, type(None)), "hybrid force: sensor")
        if self.sensor is not None:
            serial_chain(self.sensor, "hybrid force: sensor")
        most, why = (1.0, "with measurements a sample late") if self.late else (2.0, "of an integral")
        require_stable("hybrid force: gain", "gain * sample_time", self.gain * self.sample_time, most, why)

    def parameters(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return those of f_d, and the measured wrenches without a sensor."""
        measured = {} if self.sensor is not None else {"measured_wrenches": (len(chain.arms), 6)}
        return self.around.parameters(chain) | measured

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain that f_d or the sensor does not fit, and an f_d with memory."""
        self.around.require(chain)
        if len(self.around.memory(chain)):
            got = type(self.around).__name__
            raise ModelError(f"hybrid force: around: expected grasp forces without memory, got {got}")
        if self.sensor is not None and self.sensor.joint_names() != chain.joint_names():
            raise ModelError("hybrid force: sensor: expected a chain with the joints of the law's chain, got others")

    def for_chain(self, chain: ClosedChain) -> HybridForce:
        """Return the part whose sensor has the grasps that the chain has."""
        if self.sensor is None:
            return self
        grasps = {name: self.sensor.grasps.get(name, grasp) for name, grasp in chain.grasps.items()}
        return replace(self, sensor=replace(self.sensor, grasps=grasps))

    def memory(self, chain: ClosedChain) -> Array:
        """Return zeros for I in the object's axes, and with a sensor for the last torques and whether there are any."""
        return np.zeros(6 * len(chain.arms) + (0 if self.sensor is None else chain.joint_count + 1))

    def wished(self, x: LawInput, acceleration: Array) -> Array:
        """Return f_d + I, (arms, 6)."""
        chain, R, wish = x.motion.chain, x.state.object_frame.R, self.around.wished(x, acceleration)
        size = 6 * len(chain.arms)
        before = array([rotate(R, f) for f in x.memory[:size].reshape(-1, 6)])
        error = internal_part(x.motion, wish - self._measured(x))
        if self.sensor is not None:
            error = where(x.memory[-1] > 0.5, error, 0.0 * error)
        integral = before + self.gain * self.sample_time * error
        if self.limit < np.inf:
            length = length_scale([grasp.frame.p for grasp in chain.grasps.values()])
            scaled = (integral * np.r_[np.full(3, 1 / length), np.ones(3)]).ravel()
            integral = integral * (self.limit / maximum(sqrt(scaled @ scaled), self.limit))
        return wish + integral

    def commanded(self, x: LawInput, acceleration: Array) -> Array:
        """Return f_d, (arms, 6)."""
        return self.around.commanded(x, acceleration)

    def kept(self, x: LawInput, acceleration: Array, wrenches: Array, tau: Array) -> Array:
        """Return what was achieved beyond f_d, and the torques if they are needed."""
        R, achieved = x.state.object_frame.R, internal_part(x.motion, wrenches - self.around.wished(x, acceleration))
        own = [unrotate(R, f) for f in achieved]
        return concatenate(own if self.sensor is None else [*own, tau, [1.0]])

    def _measured(self, x: LawInput) -> Array:
        """Return the measured wrenches, (arms, 6)."""
        if self.sensor is None:
            return x.given["measured_wrenches"]
        last = x.memory[6 * len(self.sensor.arms) : -1]
        motion = chain_motion(self.sensor, x.state, last, Inputs().shaped(self.sensor))
        return chain_solution(motion, sequential(motion), "auto").grasp_wrench
