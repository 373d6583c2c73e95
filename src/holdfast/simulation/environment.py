"""The environment of a simulated chain: the motions of its bases, and the external wrenches on it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.simulation.external_inputs import GivenInputs, inputs_at, take_state
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.state import Inputs, State

# function of t [s] that returns the pose of the base (a Pose or wxyz_xyz), its twist (6,) and acceleration (6,), in
# world axes
BaseMotion = Callable[[Any], tuple[Any, ArrayLike, ArrayLike]]


@dataclass(frozen=True, eq=False)
class Environment:
    """A chain with the motions of its bases and the external wrenches on it.

    Attributes:
        chain: arms, object and grasps. Bases without a motion stay at the poses given in the chain.
        base_motion: motions of the moving bases, by arm name, or "trunk" for the base of a trunk.
        inputs: external wrenches, either constant or a function of t or of (t, state), see `take_state`. If they
            contain base motions, `base_motion` replaces those of the bases that it names.
    """

    chain: ClosedChain
    base_motion: Mapping[str, BaseMotion] = field(default_factory=dict)
    inputs: GivenInputs = field(default_factory=Inputs)

    def __post_init__(self) -> None:
        take_state(self.inputs)
        if not isinstance(self.base_motion, Mapping):
            raise ModelError(
                "base motion: expected a mapping from an arm's name to a function of time, got"
                f" {type(self.base_motion).__name__}"
            )
        for name in self.base_motion:
            self._require_base(name)
            if not callable(self.base_motion[name]):
                raise ModelError(
                    f"base motion '{name}': expected a function t -> (pose, twist, acceleration), got"
                    f" {type(self.base_motion[name]).__name__}"
                )

    def _require_base(self, name: str) -> None:
        """Refuse a motion for a name that has no base in the world."""
        chain = self.chain
        if name == TRUNK and chain.trunk is not None:
            if chain.floats:
                raise ModelError(
                    f"base motion '{TRUNK}': expected none, as the base floats: its motion is in the state"
                )
            return
        if name not in chain.arms:
            raise ModelError(f"base motion '{name}': no such arm.{checks.did_you_mean(name, chain.arms)}")
        if name in chain.mounts:
            raise ModelError(
                f"base motion '{name}': the arm stands on the trunk and moves with it; try the motion of '{TRUNK}'"
            )

    @cached_property
    def of_state(self) -> bool:
        """Whether the inputs depend on the state."""
        return take_state(self.inputs)

    def chain_at(self, t: Scalar) -> ClosedChain:
        """Return the chain with its bases at their poses at time t [s]."""
        if not self.base_motion:
            return self.chain
        return mounted(self.chain, {name: pose for name, (pose, *_) in self._motions(t).items()})

    def at(self, t: Scalar, state: State) -> tuple[ClosedChain, Inputs]:
        """Return the chain with its bases at their poses at time t [s], and the inputs at that time and state."""
        inputs = inputs_at(self.inputs, self.of_state, t, state)
        if not self.base_motion:
            return self.chain, inputs
        shaped = inputs.shaped(self.chain)
        assert shaped.base_twists is not None and shaped.base_accelerations is not None
        twists, accelerations = list(shaped.base_twists), list(shaped.base_accelerations)
        motions = self._motions(t)
        for i, name in enumerate(self.chain.names):
            if name in motions:
                _, twists[i], accelerations[i] = motions[name]
        moving = replace(shaped, base_twists=array(twists), base_accelerations=array(accelerations))
        if TRUNK in motions:
            _, twist, acceleration = motions[TRUNK]
            moving = replace(moving, trunk_base_twist=twist, trunk_base_acceleration=acceleration)
        return mounted(self.chain, {name: pose for name, (pose, *_) in motions.items()}), moving

    def _motions(self, t: Scalar) -> dict[str, tuple[Any, Array, Array]]:
        """Return the poses, twists and accelerations of the moving bases."""
        return {name: motion_of(name, motion(t)) for name, motion in self.base_motion.items()}


def motion_of(name: str, found: Any) -> tuple[Any, Array, Array]:
    """Return the pose, twist and acceleration that a base motion has returned; the pose is checked by `mounted`.

    Raises:
        StateError: the function has returned something else.
    """
    what = f"base motion of '{name}'"
    if not isinstance(found, tuple | list) or len(found) != 3:
        raise StateError(f"{what}: expected (pose, twist, acceleration), got {type(found).__name__}")
    pose, *rates = found
    twist, acceleration = (checks.numbers(x, (6,), what, StateError) for x in rates)
    return pose, twist, acceleration


def mounted(chain: ClosedChain, bases: Mapping[str, Any]) -> ClosedChain:
    """Return the chain with some bases at new poses; only these are checked, because this is called at every stage."""
    moved, put = copy.copy(chain), object.__setattr__
    arms = dict(chain.arms)
    for name, base in bases.items():
        pose = checks.pose(base, f"base motion of '{name}'")
        if name == TRUNK and chain.trunk is not None:
            put(moved, "trunk", copy.copy(chain.trunk))
            put(moved.trunk, "base", pose)
            continue
        arms[name] = copy.copy(arms[name])
        put(arms[name], "base", pose)
    put(moved, "arms", FrozenDict(arms))
    return moved
