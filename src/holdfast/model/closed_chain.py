"""The whole system: arms, the object they hold, and the grasps between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.spatial.converted import ArrayField, making
from holdfast.spatial.frozen import Frozen, FrozenDict, frozen_property

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True, eq=False)
class ClosedChain(Frozen):
    """Named arms that hold one object, in a fixed order.

    Attributes:
        arms: arm by name; their order is the order of every flat array.
        held_object: the object.
        grasps: grasp by arm name; an arm without one moves freely.
        gravity: (3,) world axes [m/s^2].
    """

    arms: Mapping[str, Arm]
    held_object: HeldObject
    grasps: Mapping[str, Grasp]
    gravity: ArrayField = field(default_factory=making(np.array, STANDARD_GRAVITY))

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.arms, Mapping) or not isinstance(self.grasps, Mapping):
            raise ModelError("chain: expected arms and grasps as mappings from a name, e.g. {'left': arm}")
        if not self.arms:
            raise ModelError("chain: expected at least one arm, got none")
        for name, arm in self.arms.items():
            checks.instance(name, str, f"chain: name of arm {name!r}")
            if not isinstance(arm, Arm):
                raise ModelError(f"arm '{name}': expected an Arm, got {type(arm).__name__}")
        if not isinstance(self.held_object, HeldObject):
            raise ModelError(f"object: expected a HeldObject, got {type(self.held_object).__name__}")
        for name, grasp in self.grasps.items():
            if name not in self.arms:
                raise ModelError(f"grasp '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
            if not isinstance(grasp, Grasp):
                raise ModelError(f"grasp '{name}': expected a Grasp, got {type(grasp).__name__}")
        put(self, "arms", FrozenDict({name: replace(arm, name=name) for name, arm in self.arms.items()}))
        put(self, "grasps", FrozenDict({name: self.grasps[name] for name in self.arms if name in self.grasps}))
        put(self, "gravity", checks.numbers(self.gravity, (3,), "chain: gravity"))

    @property
    def names(self) -> tuple[str, ...]:
        """The arms' names, in order."""
        return tuple(self.arms)

    @frozen_property
    def joints(self) -> Mapping[str, slice]:
        """Where each arm's joints lie in the flat arrays q, qd, tau."""
        ends = np.cumsum([arm.joint_count for arm in self.arms.values()])
        return {
            name: slice(int(end) - arm.joint_count, int(end))
            for (name, arm), end in zip(self.arms.items(), ends, strict=True)
        }

    @frozen_property
    def contact_freedoms(self) -> Mapping[str, slice]:
        """Where each grasp's relative rates lie in the flat arrays W and W_dot."""
        ends = np.cumsum([len(grasp.free) for grasp in self.grasps.values()], dtype=int)
        return {
            name: slice(int(end) - len(grasp.free), int(end))
            for (name, grasp), end in zip(self.grasps.items(), ends, strict=True)
        }

    @frozen_property
    def joint_count(self) -> int:
        """n, over all arms."""
        return sum(arm.joint_count for arm in self.arms.values())

    @frozen_property
    def contact_freedom_count(self) -> int:
        """Sum of n_g over all grasps: the length of W."""
        return sum(len(grasp.free) for grasp in self.grasps.values())

    @property
    def constraint_row_count(self) -> int:
        """Six velocity rows a grasp; the relative rates W are unknowns among the velocities."""
        return 6 * len(self.grasps)

    def joint_names(self) -> list[str]:
        """Return 'arm/joint' names in the order of q."""
        return [
            f"{name}/{joint.name or f'joint{k + 1}'}"
            for name, arm in self.arms.items()
            for k, joint in enumerate(arm.joints)
        ]

    def with_bases(self, bases: Mapping[str, object]) -> ClosedChain:
        """Return the chain with the named arms mounted elsewhere (Pose or wxyz_xyz)."""
        checks.instance(bases, Mapping, "bases")
        for name in bases:
            if name not in self.arms:
                raise ModelError(f"base of '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
        return replace(self, arms={n: a.at(bases[n]) if n in bases else a for n, a in self.arms.items()})

    def with_grasp(self, name: str, grasp: Grasp) -> ClosedChain:
        """Return the chain with one more grasp, of an arm that has none."""
        checks.instance(name, str, "grasp: name of the arm")
        if name not in self.arms:
            raise ModelError(f"grasp '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
        if name in self.grasps:
            raise ModelError(
                f"grasp '{name}': expected an arm without a grasp, got one that has a {self.grasps[name].kind} grasp;"
                f" try without_grasp('{name}') first"
            )
        return replace(self, grasps={**self.grasps, name: grasp})

    def without_grasp(self, name: str) -> ClosedChain:
        """Return the chain with one grasp opened; the arm goes on alone."""
        checks.instance(name, str, "grasp: name of the arm")
        if name not in self.grasps:
            raise ModelError(f"grasp '{name}': no such grasp.{checks.did_you_mean(name, self.grasps)}")
        return replace(self, grasps={n: g for n, g in self.grasps.items() if n != name})
