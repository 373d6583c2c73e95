"""Many systems between two steps, and what came of them."""

from __future__ import annotations

from enum import Enum

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.kernel import Systems
from holdfast.spatial.scalar import Array


class Fate(Enum):
    """Whether a system goes on, or why it stands still at its last good state."""

    RUNNING = "goes on"
    SLIPPED = "a grasp's margin falls below the least allowed within the next step"
    SINGULAR = "the grasp constraint is singular, or its condition passes 1e12"
    OPEN = "the next step leaves a grasp open by more than 1e-2 (m or rad): it is too long"
    BROKEN = "the next step is not finite"


_FATES = np.array(list(Fate))


class RolloutSystems:
    """Many systems of one chain, advanced in place by `Rollout.step`.

    Every array has the systems along its first axis. A system that cannot go on keeps its last good
    state; its `fate` says why.

    Attributes:
        chain: the chain.
        t: (systems,) time of each [s].
        arrays: what the machine code carries on, by name.
    """

    def __init__(self, chain: ClosedChain, t: Array, arrays: Systems) -> None:
        self.chain, self.t, self.arrays = chain, t, arrays

    def __len__(self) -> int:
        return len(self.t)

    @property
    def q(self) -> Array:
        """(systems, n) joint positions [rad or m]."""
        return self.arrays["q"]

    @property
    def qd(self) -> Array:
        """(systems, n) joint rates."""
        return self.arrays["qd"]

    @property
    def qdd(self) -> Array:
        """(systems, n) joint accelerations."""
        return self.arrays["qdd"]

    @property
    def tau(self) -> Array:
        """(systems, n) torques of the drives [N m or N]."""
        return self.arrays["drive"]

    @property
    def object_pose(self) -> Array:
        """(systems, 7) wxyz_xyz of the object frame."""
        return self.arrays["object_pose"]

    @property
    def object_twist(self) -> Array:
        """(systems, 6) [omega; v of C], world axes."""
        return self.arrays["object_twist"]

    @property
    def object_acceleration(self) -> Array:
        """(systems, 6) [omega_dot; v_dot of C], true, world axes."""
        return self.arrays["object_acceleration"]

    @property
    def grasp_wrench(self) -> Array:
        """(systems, arms, 6) [moment; force] of each arm on the object about the contact, world axes."""
        return self.arrays["grasp_wrench"]

    @property
    def memory(self) -> Array:
        """(systems, m) what the control law carries on."""
        return self._or_none("memory")

    @property
    def margin(self) -> Array:
        """(systems, grasps) margin of every one-sided contact now [N]; infinite where there is none."""
        return self._or_none("margin")

    @property
    def worst_margin(self) -> Array:
        """(systems, grasps) the least margin at the end of any step so far [N]."""
        return self._or_none("worst_margin")

    @property
    def worst_time(self) -> Array:
        """(systems, grasps) when that was [s]."""
        return self._or_none("worst_time")

    @property
    def work(self) -> Array:
        """(systems, 4) work so far of drives, damping and friction, bases, external wrenches [J]."""
        return self.arrays["work"]

    @property
    def gap(self) -> Array:
        """(systems, 2) the largest open gap of any grasp, in position [m or rad] and in velocity."""
        return self.arrays["gaps"][:, 2:]

    @property
    def drift(self) -> Array:
        """(systems, 2) the same as the last step left it, before projection."""
        return self.arrays["gaps"][:, :2]

    @property
    def fate(self) -> Array:
        """(systems,) of `Fate`."""
        return _FATES[self.arrays["code"].astype(int)]

    @property
    def running(self) -> Array:
        """(systems,) whether each goes on."""
        return self.arrays["code"] == 0.0

    def copy(self, rows: Array | None = None) -> RolloutSystems:
        """Return the systems, or some of them by number or truth value, apart from these."""
        which = slice(None) if rows is None else rows
        return RolloutSystems(self.chain, self.t[which].copy(), {k: x[which].copy() for k, x in self.arrays.items()})

    def _or_none(self, name: str) -> Array:
        return self.arrays.get(name, np.zeros((len(self), 0)))
