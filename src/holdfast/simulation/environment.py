"""What a simulated chain lives in: base motions and external wrenches as functions of time."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from numpy.typing import ArrayLike

from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.state import Inputs

# t [s] -> pose of the base (a Pose or wxyz_xyz), its twist (6,) and acceleration (6,), world axes
BaseMotion = Callable[[Any], tuple[Any, ArrayLike, ArrayLike]]


@dataclass(frozen=True, eq=False)
class Environment:
    """A chain with everything that acts on it from outside.

    Attributes:
        chain: arms, object and grasps; bases that do not move stand where it has them.
        base_motion: motion of the bases that move, by arm name, or "trunk" for a trunk's.
        inputs: external wrenches, constant or a function of time; base motion in them is
            replaced for the bases that move.
    """

    chain: ClosedChain
    base_motion: Mapping[str, BaseMotion] = field(default_factory=dict)
    inputs: Inputs | Callable[[float], Inputs] = field(default_factory=Inputs)

    def __post_init__(self) -> None:
        if not (isinstance(self.inputs, Inputs) or callable(self.inputs)):
            raise ModelError(f"inputs: expected Inputs or a function t -> Inputs, got {type(self.inputs).__name__}")
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
        """Refuse a motion of what has no base in the world."""
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

    def at(self, t: Scalar) -> tuple[ClosedChain, Inputs]:
        """Return the chain with its bases where they are at time t [s], and the inputs then."""
        inputs = self.inputs(t) if callable(self.inputs) else self.inputs
        if not isinstance(inputs, Inputs):
            raise StateError(
                f"inputs({t:g}): expected Inputs, got {type(inputs).__name__}; try Inputs(object_wrench=...)"
            )
        if not self.base_motion:
            return self.chain, inputs
        shaped = inputs.shaped(self.chain)
        assert shaped.base_twists is not None and shaped.base_accelerations is not None
        twists, accelerations = list(shaped.base_twists), list(shaped.base_accelerations)
        poses = {}
        for i, name in enumerate(self.chain.names):
            if name in self.base_motion:
                poses[name], twists[i], accelerations[i] = motion_of(name, self.base_motion[name](t))
        moving = replace(shaped, base_twists=array(twists), base_accelerations=array(accelerations))
        if TRUNK in self.base_motion:
            poses[TRUNK], twist, acceleration = motion_of(TRUNK, self.base_motion[TRUNK](t))
            moving = replace(moving, trunk_base_twist=twist, trunk_base_acceleration=acceleration)
        return mounted(self.chain, poses), moving


def motion_of(name: str, found: Any) -> tuple[Any, Array, Array]:
    """Return what a base's motion returned: its pose as it is (see `mounted`), twist and acceleration.

    Raises:
        StateError: it returned something else.
    """
    what = f"base motion of '{name}'"
    if not isinstance(found, tuple | list) or len(found) != 3:
        raise StateError(f"{what}: expected (pose, twist, acceleration), got {type(found).__name__}")
    pose, *rates = found
    twist, acceleration = (checks.numbers(x, (6,), what, StateError) for x in rates)
    return pose, twist, acceleration


def mounted(chain: ClosedChain, bases: Mapping[str, Any]) -> ClosedChain:
    """Return the chain with some bases elsewhere; only they are checked, since this happens at every stage."""
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
