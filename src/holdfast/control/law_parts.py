"""What the parts of a cooperative law are: motion of the object, grasp forces, and motion that moves no grasp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.compiler.program import Shape
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State


class LawInput(NamedTuple):
    """What a part of a law computes from.

    Attributes:
        t: time [s].
        state: positions and velocities.
        motion: the chain's motion, without torques.
        memory: the memory of the grasp forces.
        given: parameters of the law by name.
    """

    t: Scalar
    state: State
    motion: ChainMotion
    memory: Array
    given: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class LawPart(Frozen):
    """A part of a law; by default it has no parameters and fits every chain."""

    def parameters(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return names and shapes of what the law must be given for this part."""
        return {}

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain that the part does not fit."""


@dataclass(frozen=True, eq=False)
class CommandedMotion(LawPart):
    """A part that commands the object's acceleration."""

    def acceleration(self, x: LawInput) -> Array:
        """Return the true acceleration [omega_dot; v_dot] of C, (6,) world axes."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class GraspForces(LawPart):
    """A part that wishes for grasp wrenches; those that move the object as commanded and are nearest to them act."""

    def for_chain(self, chain: ClosedChain) -> GraspForces:
        """Return the part for a chain whose grasps have changed."""
        return self

    def wished(self, x: LawInput, acceleration: Array) -> Array:
        """Return wrenches of the arms on the object about the contacts, (arms, 6) world axes."""
        raise NotImplementedError

    def commanded(self, x: LawInput, acceleration: Array) -> Array:
        """Return what a part that corrects forces is to achieve, (arms, 6); of any other part what it wishes for."""
        return self.wished(x, acceleration)

    def memory(self, chain: ClosedChain) -> Array:
        """Return the initial memory, (m,)."""
        return np.zeros(0)

    def kept(self, x: LawInput, acceleration: Array, wrenches: Array, tau: Array) -> Array:
        """Return the memory for the next step, (m,), given the wrenches (arms, 6) and torques (n,) that act."""
        return x.memory


@dataclass(frozen=True, eq=False)
class NullMotion(LawPart):
    """A part that wishes for joint accelerations; what they would move of the object is taken out."""

    def joint_acceleration(self, x: LawInput) -> Array:
        """Return joint accelerations, (n,) [rad/s^2 or m/s^2]."""
        raise NotImplementedError
