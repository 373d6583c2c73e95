"""Many systems between two steps, and what came of them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np

from holdfast.dynamics.margins import joint_limits, margins_of_joints
from holdfast.errors import FrozenError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.kernel import Systems
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array


class Fate(Enum):
    """Whether a system goes on, or why it stands still at its last good state."""

    RUNNING = "goes on"
    SLIPPED = "a grasp's margin falls below the least allowed within the next step"
    SINGULAR = "the grasp constraint is singular, or its condition passes 1e12"
    OPEN = "a grasp that closes is not there; or the next step, too long, leaves one open by more than 1e-2 (m or rad)"
    BROKEN = "its inputs are faulty, or the next step is not finite"
    TOO_LONG = "the next step ends in a slip, limit or singularity that shorter steps do not show: it is too long"
    LIMITED = "a joint passes a limit of its position, rate or effort within the next step"


_ATTRIBUTES = ("chain", "arrays", "begin", "pace", "told", "law")
_FATES = np.array(list(Fate))


class RolloutSystems:
    """Many systems of one chain, advanced in place by `Rollout.step`.

    Every array has the systems along its first axis; it follows the steps and cannot be written, as what goes with
    a state is found by `Rollout.start`. A system that cannot go on keeps its last good
    state; its `fate` says why.

    Attributes:
        chain: the chain.
        arrays: what the machine code carries on, by name.
        begin: (systems,) when the steps began that are counted now [s].
        pace: (systems,) their length [s].
        told: what they were told last, by the machine code's names, (1 or systems, ...) each; it acts until they are
            told otherwise.
        law: the law under which their slopes were found.
    """

    def __init__(self, chain: ClosedChain, arrays: Systems, begin: Array, pace: Array) -> None:
        self.chain, self.arrays, self.begin, self.pace = chain, arrays, begin, pace
        self.told: dict[str, Array] = {}
        self.law: object = None

    def __len__(self) -> int:
        return len(self.begin)

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse what would not act: arrays in the place of the machine code's, and names that nothing reads."""
        if isinstance(getattr(type(self), name, None), property):
            raise FrozenError(
                f"systems: {name}: expected what the last step found to stay, as the next one begins with it; try"
                " `start` for other states"
            )
        if name not in _ATTRIBUTES:
            known = [n for n, x in vars(type(self)).items() if isinstance(x, property)]
            raise FrozenError(f"systems: no attribute '{name}'.{checks.did_you_mean(name, known)}")
        object.__setattr__(self, name, value)

    @property
    def t(self) -> Array:
        """(systems,) time of each [s]: a whole number of steps, so that it does not drift."""
        return self.begin + self.arrays["count"] * self.pace

    def at_pace(self, step: Array) -> None:
        """Count steps of another length from now on; (systems,) [s]."""
        changed = self.pace != step
        if changed.any():
            self.begin = np.where(changed, self.t, self.begin)
            self.arrays["count"][changed] = 0.0
            self.pace = step

    @property
    def q(self) -> Array:
        """(systems, n) joint positions [rad or m]."""
        return read_only(self.arrays["q"])

    @property
    def qd(self) -> Array:
        """(systems, n) joint rates."""
        return read_only(self.arrays["qd"])

    @property
    def qdd(self) -> Array:
        """(systems, n) joint accelerations."""
        return read_only(self.arrays["qdd"])

    @property
    def tau(self) -> Array:
        """(systems, n) torques of the drives [N m or N]."""
        return read_only(self.arrays["drive"])

    @property
    def object_pose(self) -> Array:
        """(systems, 7) wxyz_xyz of the object frame."""
        return read_only(self.arrays["object_pose"])

    @property
    def object_twist(self) -> Array:
        """(systems, 6) [omega; v of C], world axes."""
        return read_only(self.arrays["object_twist"])

    @property
    def object_acceleration(self) -> Array:
        """(systems, 6) [omega_dot; v_dot of C], true, world axes."""
        return read_only(self.arrays["object_acceleration"])

    @property
    def grasp_wrench(self) -> Array:
        """(systems, arms, 6) [moment; force] of each arm on the object about the contact, world axes.

        Where the forces are not unique, one solution.
        """
        return read_only(self.arrays["grasp_wrench"])

    @property
    def memory(self) -> Array:
        """(systems, m) what the control law carries on."""
        return self._or_none("memory")

    @property
    def margin(self) -> Array:
        """(systems, grasps) margin of every grasp now [N], see `dynamics.margins`; infinite if nothing limits it."""
        return self._or_none("margin")

    @property
    def joint_margin(self) -> Array:
        """(systems, 3, n) of every joint's position, rate and effort, see `joint_margins`; infinite without a limit."""
        limits = joint_limits(self.chain)
        found = margins_of_joints(limits, *(self.arrays[name] for name in ("q", "qd", "drive")))
        return read_only(np.stack(found, axis=1))

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
        return read_only(self.arrays["work"])

    @property
    def gap(self) -> Array:
        """(systems, 2) the largest open gap of any grasp, in position [m or rad] and in velocity."""
        return read_only(self.arrays["gaps"][:, 2:])

    @property
    def drift(self) -> Array:
        """(systems, 2) the same as the last step left it, before projection."""
        return read_only(self.arrays["gaps"][:, :2])

    @property
    def fate(self) -> Array:
        """(systems,) of `Fate`."""
        return _FATES[self.arrays["code"].astype(int)]

    @property
    def running(self) -> Array:
        """(systems,) whether each goes on."""
        return self.arrays["code"] == 0.0

    def tell(self, said: Mapping[str, Array], law: object) -> bool:
        """Keep what a call says until it is said otherwise; return whether anything may act that did not before.

        Args:
            said: arrays by the machine code's names, (1 or systems, ...) each.
            law: the law that acts.
        """
        new = {name: np.array(x) for name, x in said.items() if not np.array_equal(x, self.told.get(name, ()))}
        changed = bool(new) or self.law is not law
        self.told, self.law = self.told | new, law
        return changed

    def copy(self, rows: Any = None) -> RolloutSystems:
        """Return the systems, or some of them by number or truth value, apart from these."""
        which = slice(None) if rows is None else rows
        arrays = {name: x[which].copy() for name, x in self.arrays.items()}
        made = RolloutSystems(self.chain, arrays, self.begin[which].copy(), self.pace[which].copy())
        made.told = {name: x if len(x) == 1 else x[which] for name, x in self.told.items()}
        made.law = self.law
        return made

    def put(self, rows: Array, other: RolloutSystems) -> None:
        """Set some systems, by number, to others."""
        for name, x in other.arrays.items():
            self.arrays[name][rows] = x
        self.begin[rows], self.pace[rows] = other.begin, other.pace

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: a law may be a function without a name, and slopes can be found anew."""
        return vars(self) | {"law": None}

    def _or_none(self, name: str) -> Array:
        return read_only(self.arrays.get(name, np.zeros((len(self), 0))))
