"""A control law with the sensors, the actuators and the limits of a robot, evaluated once per sample.

measurements: resolution * rint((x + noise) / resolution)
torques: those of the law -> rounded -> clipped to the limits -> change since the last sample clipped

The noise of the torques is added to the result; it is not part of the command that the next sample compares with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.control.clipped import within
from holdfast.control.controller import ControlLaw, Torque, torques_and_memory
from holdfast.control.random_streams import STATE_SIZE, normals
from holdfast.control.traced_law import comparable
from holdfast.dynamics.projection import turned_and_shifted
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.spatial.differentiation import bare
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, clip, concatenate, rint, where
from holdfast.state import State


def evaluated(
    law: ControlLaw, joint_count: int, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return the torques (n,) and the memory of a law, as arrays.

    Raises:
        StateError: the law does not return torques and memory of the right shapes.
    """
    tau, kept = torques_and_memory(law.torque(t, state, memory, given), "control law")
    none = kept is None and not len(law.memory)
    tau = checks.numbers(tau, (joint_count,), "controller: torques", StateError)
    return tau, np.zeros(0) if none else checks.numbers(kept, law.memory.shape, "control law: memory", StateError)


@dataclass(frozen=True, eq=False)
class DigitalTorque(Frozen):
    """The torques of a law with imperfect measurements and actuators.

    The memory consists of that of the law, the last command (n,) with the number 1 if changes are limited, and the
    state of the random numbers if there is noise.

    Attributes:
        law: the law.
        joint_count: n.
        noise: standard deviations by name, in the order in which they are drawn.
        resolution: resolutions (n,) by name.
        limits: (n,) largest |tau|; infinite for no limit.
        change: (n,) largest change of a torque from one sample to the next; infinite for no limit.
    """

    law: ControlLaw
    joint_count: int
    noise: Mapping[str, Array]
    resolution: Mapping[str, Array]
    limits: Array
    change: Array

    @property
    def compares(self) -> bool:
        """Whether commands are compared with those of the last sample."""
        return bool(np.isfinite(self.change).any())

    def memory(self, source: Array) -> Array:
        """Return the initial memory, for the initial state of the random numbers (6,)."""
        last = np.zeros(self.joint_count + 1 if self.compares else 0)
        return np.concatenate([self.law.memory, last, source if self.noise else np.zeros(0)])

    def for_chain(self, chain: Any) -> Torque:
        """Return the torques for a chain whose grasps have changed."""
        return replace(self, law=self.law.for_chain(chain))

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques that are to act (n,) and the memory."""
        size = len(self.law.memory)
        kept, last, source = memory[:size], memory[size:], np.zeros(0)
        if self.noise:
            last, source = last[:-STATE_SIZE], bare(last[-STATE_SIZE:])
        drawn, source = normals(source, sum(map(len, self.noise.values())))
        noise = {name: deviation * drawn[k : k + len(deviation)] for (name, deviation), k in self._noisy()}
        command, kept = evaluated(self.law, self.joint_count, t, self._measured(state, noise), kept, given)
        command = within(self._rounded("tau", command), self.limits)
        if self.compares:
            before, begun = last[:-1], last[-1] > 0.5
            command = where(begun, clip(command, before - self.change, before + self.change), command)
            last = concatenate([command, [1.0]])
        return command + noise.get("tau", 0.0), concatenate([kept, last, source])

    def _noisy(self) -> list[tuple[tuple[str, Array], int]]:
        """Return names and deviations of noise, each with the number of its first random number."""
        sizes = [len(x) for x in self.noise.values()]
        return list(zip(self.noise.items(), [0, *np.cumsum(sizes).tolist()], strict=False))

    def _measured(self, state: State, noise: Mapping[str, Array]) -> State:
        """Return what is measured of a state."""
        found = {name: getattr(state, name) for name in {**self.noise, **self.resolution} if name != "tau"}
        for name, x in found.items():
            if name in noise:
                x = turned_and_shifted(x, noise[name]) if name == "object_pose" else x + noise[name]
            found[name] = self._rounded(name, x)
        return comparable(replace(state, **found)) if found else state

    def _rounded(self, name: str, x: Array) -> Array:
        """Return numbers rounded to the resolution of this name, if there is one."""
        step = self.resolution.get(name)
        return x if step is None else step * rint(x / step)
