"""Clipping of a controller's torques to the effort limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.controller import (
    ControlLaw,
    Controller,
    Torque,
    known_breakpoints,
    require_controller,
    torques_and_memory,
)
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum
from holdfast.state import State


def clipped(controller: Controller | ControlLaw, chain: ClosedChain) -> Controller | ControlLaw:
    """Return the controller with its torques clipped to the joints' effort limits, |tau| <= effort_limit.

    The result is a control law if `controller` is one, and traceable if it is traceable. The slopes of the torques jump
    when clipping begins and ends; steps that contain such a time are of lower order.

    Args:
        controller: any controller.
        chain: the chain that it controls.

    Raises:
        ModelError: the controller is not a function, or `chain` is not a ClosedChain.
    """
    require_controller(controller)
    checks.instance(chain, ClosedChain, "clipped: chain")
    limits = np.array([joint.effort_limit for joint in chain.freedoms])
    if not isinstance(controller, ControlLaw):
        return Clipped(controller, limits)
    key = f"{controller.key}, clipped to {limits.tolist()}" if controller.key else ""
    return replace(controller, torque=ClippedTorque(controller.torque, limits), key=key)


@dataclass(frozen=True, eq=False)
class Clipped(Frozen):
    """A controller with clipped torques.

    Attributes:
        controller: the controller whose torques are clipped.
        limits: (n,) largest |tau| [N m or N]; infinite for no limit.
    """

    controller: Controller
    limits: Array

    @property
    def traceable(self) -> bool:
        """Whether it can be compiled to machine code."""
        return bool(getattr(self.controller, "traceable", False))

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its torques jump [s], as far as they are known in advance."""
        return known_breakpoints(self.controller)

    def for_chain(self, chain: ClosedChain) -> Controller:
        """Return the controller for a chain whose grasps have changed."""
        for_chain = getattr(self.controller, "for_chain", None)
        return self if for_chain is None else Clipped(for_chain(chain), self.limits)

    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) [N m or N] and the memory."""
        tau, kept = torques_and_memory(self.controller(t, state, memory))
        return within(tau, self.limits), kept


@dataclass(frozen=True, eq=False)
class ClippedTorque(Frozen):
    """The clipped torques of a law; the attributes are those of `Clipped`."""

    torque: Torque
    limits: Array

    def for_chain(self, chain: ClosedChain) -> Torque:
        """Return the clipped torques for a chain whose grasps have changed."""
        for_chain = getattr(self.torque, "for_chain", None)
        return self if for_chain is None else ClippedTorque(for_chain(chain), self.limits)

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, ArrayLike]:
        """Return the torques (n,) and the memory."""
        tau, kept = self.torque(t, state, memory, given)
        return within(tau, self.limits), kept


def within(tau: Any, limits: Array) -> Array:
    """Return torques clipped to their limits, (n,)."""
    given = checks.numbers(tau, limits.shape, "controller: torques", StateError)
    return array(
        [x if math.isinf(most) else maximum(-most, minimum(most, x)) for x, most in zip(given, limits, strict=True)]
    )
