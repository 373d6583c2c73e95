"""The environment of a simulated chain: the motions of its bases, and the external wrenches on it.

The wrenches are constant, a function of time, or a function of time and state.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.spatial.frozen import FrozenDict, changed
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.state import Inputs, State

# function of t [s] that returns the pose of the base (a Pose or wxyz_xyz), its twist (6,) and acceleration (6,), in
# world axes
BaseMotion = Callable[[Any], tuple[Any, ArrayLike, ArrayLike]]
# functions receive the time t [s] and the state at that time
GivenInputs = Inputs | Callable[[Any], Inputs] | Callable[[Any, State], Inputs]
MOVING_BASES = ("base_twists", "base_accelerations", "trunk_base_twist", "trunk_base_acceleration")


@dataclass(frozen=True, eq=False)
class Environment:
    """A chain with the motions of its bases and the external wrenches on it.

    Attributes:
        chain: arms, object and grasps. Bases without a motion stay at the poses given in the chain.
        base_motion: motions of the moving bases, by arm name, or "trunk" for the base of a trunk, and of shapes of the
            world that the object may touch, by their names.
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
        for name, shape in () if self.chain.touching is None else self.chain.touching.world.items():
            if (shape.twist.any() or shape.acceleration.any()) and name not in self.base_motion:
                raise ModelError(
                    f"shape '{name}': its twist is that of an instant, expected a motion for a run; try base_motion="
                    f"{{'{name}': t -> (pose, twist, acceleration)}}, or surface_twist for a belt"
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
        shapes = () if chain.touching is None else chain.touching.world
        if name in shapes:
            if name in chain.arms:
                raise ModelError(f"base motion '{name}': an arm and a shape have this name; expected different names")
            return
        if name not in chain.arms:
            known = [*chain.arms, *shapes]
            what = "arm or shape of the world" if shapes else "arm"
            raise ModelError(f"base motion '{name}': no such {what}.{checks.did_you_mean(name, known)}")
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
        return mounted(self.chain, self._motions(t))

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
        moving = shaped
        if any(name in motions for name in self.chain.arms):
            moving = replace(shaped, base_twists=array(twists), base_accelerations=array(accelerations))
        if TRUNK in motions:
            _, twist, acceleration = motions[TRUNK]
            moving = replace(moving, trunk_base_twist=twist, trunk_base_acceleration=acceleration)
        return mounted(self.chain, motions), moving

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


def mounted(chain: ClosedChain, motions: Mapping[str, tuple[Any, Array, Array]]) -> ClosedChain:
    """Return the chain with some bases and shapes of the world at new poses, shapes with twist and acceleration.

    Only the poses are checked, because this is called at every stage.
    """
    arms, trunk, shapes = dict(chain.arms), chain.trunk, {}
    for name, (base, twist, acceleration) in motions.items():
        pose = checks.pose(base, f"base motion of '{name}'")
        if name == TRUNK and trunk is not None:
            trunk = changed(trunk, base=pose)
        elif name in arms:
            arms[name] = arms[name].standing_at(pose)
        else:
            shapes[name] = (pose, twist, acceleration)
    made = changed(chain, arms=FrozenDict(arms), trunk=trunk)
    return changed(made, touching=made.touching.moved(shapes)) if shapes and made.touching is not None else made


def take_state(given: GivenInputs) -> bool:
    """Return whether the inputs are a function of (t, state), which is one that cannot be called with t alone.

    For example, `lambda t, gain=2.0: ...` is a function of time. So is a function whose signature Python cannot tell.

    Raises:
        ModelError: the inputs are neither Inputs nor a function that can be called as f(t) or f(t, state).
    """
    if isinstance(given, Inputs):
        return False
    if not callable(given):
        raise ModelError(
            "inputs: expected Inputs, or a function (t) -> Inputs or (t, state) -> Inputs, got"
            f" {type(given).__name__}; try Inputs(object_wrench=...)"
        )
    try:
        signature = inspect.signature(given)
    except (TypeError, ValueError):
        return False
    for arguments in ((0.0,), (0.0, None)):
        try:
            signature.bind(*arguments)
        except TypeError:
            continue
        return len(arguments) == 2
    raise ModelError(
        f"inputs: expected a function (t) -> Inputs or (t, state) -> Inputs, got one that is called with {signature};"
        " try lambda t, state: Inputs(object_wrench=...)"
    )


def inputs_at(given: GivenInputs, of_state: bool, t: Scalar, state: State) -> Inputs:
    """Return the inputs at one instant.

    Args:
        given: the inputs, or the function that returns them.
        of_state: the result of `take_state(given)`.
        t: time [s].
        state: positions and velocities at that time.

    Raises:
        StateError: a function has not returned Inputs, or a function of the state has returned a base motion. Base
            motions must be functions of time alone, because the velocity constraint of the grasps depends on them.
    """
    if isinstance(given, Inputs):
        return given
    arguments = (t, state) if of_state else (t,)
    found: Any = given(*arguments)
    if not isinstance(found, Inputs):
        raise StateError(
            f"inputs: expected the function to return Inputs, got {type(found).__name__}; try Inputs(object_wrench=...)"
        )
    if of_state:
        require_wrenches(found, "of a function of (t, state)")
    return found


def require_wrenches(found: Inputs, whose: str) -> None:
    """Refuse inputs that contain base motions where only wrenches are allowed.

    Raises:
        StateError: a base motion is given; the message names the first.
    """
    for name in MOVING_BASES:
        if getattr(found, name) is not None:
            raise StateError(
                f"inputs {whose}: {name}: expected none, as bases move with time alone; try base_motion="
                "{name: t -> (pose, twist, acceleration)}"
            )
