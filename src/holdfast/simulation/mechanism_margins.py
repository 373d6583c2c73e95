"""The margins of a chain that is answered as a forest: of grasps, loops and joints, in the layout of `Signals`.

A row's margin is that of its contact or wrench limits under the wrench of body a on body b, in the axes of the contact
frame, which body b carries. If forces are not unique, they are the smallest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.dynamics.tree.mechanism_terms import flat_state
from holdfast.forces.margins import conditions, contact_margin, limited, margins_of_joints
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_rows import GraspRow, grasp_rows
from holdfast.questions.arrays import contact_of
from holdfast.simulation.margins import JOINT_QUANTITIES, Quantity, Signals, giving_way
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import State


@dataclass(frozen=True, eq=False)
class MechanismInstant:
    """What the margins depend on at one time.

    Attributes:
        state: positions and velocities.
        tau: (n,) torques of the drives.
        wrench: (rows, 6) wrenches of the run's grasps and loops, zero where none is closed.
    """

    state: State
    tau: Array
    wrench: Array


@dataclass(frozen=True, eq=False)
class MechanismSignals(Signals):
    """The layout and evaluation of the margins of a chain that is answered as a forest.

    Attributes:
        rows: the rows of the run, whatever is closed now.
    """

    rows: Sequence[GraspRow] = ()

    def __len__(self) -> int:
        return len(self.rows) + 3 * self.chain.joint_count

    @cached_property
    def closed(self) -> dict[int, GraspRow]:
        """The rows of the grasps and loops that are closed now, by their place."""
        now = {row.name: row for row in grasp_rows(self.chain)}
        return {i: now[row.name] for i, row in enumerate(self.rows) if row.name in now}

    @cached_property
    def names(self) -> list[str]:
        """Name of each signal: the rows, then three times the joints as 'arm/joint'."""
        joints = [
            name
            for name, joint in zip(self.chain.joint_names(), self.chain.all_joints, strict=True)
            for _ in range(joint.type.freedoms)
        ]
        return [*(row.name for row in self.rows), *3 * joints]

    @cached_property
    def quantities(self) -> list[Quantity]:
        """The quantity that each signal limits."""
        n = self.chain.joint_count
        grasps: list[Quantity] = ["grasp"] * len(self.rows)
        return grasps + [quantity for quantity in JOINT_QUANTITIES for _ in range(n)]

    @cached_property
    def limited_rows(self) -> dict[int, tuple[Grasp, GraspRow]]:
        """Grasp and row of the closed grasps and loops with limits, by their place."""
        grasps = {i: (row.grasp, row) for i, row in self.closed.items() if row.grasp is not None}
        return {i: (grasp, row) for i, (grasp, row) in grasps.items() if conditions(grasp)}

    @cached_property
    def limited(self) -> Array:
        """Indices of the signals that have a limit; only these have to be evaluated."""
        grasps = [i in self.limited_rows for i in range(len(self.rows))]
        return np.flatnonzero(np.array([*grasps, *self.joint_limits.limited.flat]))

    def margins(self, at: MechanismInstant) -> Array:
        """Return all margins at an instant, (rows + 3 n,). O(rows + n), and O(bodies) with limited loops."""
        found = np.full(len(self.rows), np.inf)
        for i, wrench in self._wrenches(at).items():
            grasp, _ = self.limited_rows[i]
            contact = contact_of(grasp)
            found[i] = contact_margin(grasp.kind, contact, wrench) if limited(contact) else np.inf
        q = joint_coordinates(self.chain, at.state.q)
        return np.concatenate([found, *margins_of_joints(self.joint_limits, q, at.state.qd, at.tau)])

    def _wrenches(self, at: MechanismInstant) -> dict[int, Array]:
        """Return the wrenches of the rows with limits in contact axes."""
        if not self.limited_rows:
            return {}
        R = attitudes(self.chain, at.state, [row.body for _, row in self.limited_rows.values()])
        turned = zip(self.limited_rows.items(), R, strict=True)
        return {i: unrotate(E @ grasp.frame.R, at.wrench[i]) for (i, (grasp, _)), E in turned}

    def description(self, at: Any, signal: int) -> str:
        """Return a sentence on what happens when the margin reaches zero."""
        name, quantity = self.names[signal], self.quantities[signal]
        if quantity != "grasp":
            return f"joint '{name}' reaches its {quantity} limit"
        grasp, row = self.limited_rows[signal]
        what = "grasp" if row.key in self.chain.grasps else "loop"
        return f"{what} '{name}' {giving_way(grasp, self._wrenches(at)[signal])}"


def attitudes(chain: ClosedChain, state: State, bodies: Sequence[int]) -> list[Array]:
    """Return the attitudes (3, 3) of bodies of a chain's forest; those of objects without the other bodies'."""
    first = len(chain.as_forest.forest.bodies) - len(chain.free_objects)
    if min(bodies, default=first) < first:
        poses = chain.as_forest.forest.poses(flat_state(chain, state)[0])
        return [poses[body].R for body in bodies]
    of_objects = np.reshape(state.object_pose, (-1, 7))
    return [rotation.from_quaternion(of_objects[body - first, :4]) for body in bodies]


def joint_coordinates(chain: ClosedChain, q: Array) -> Array:
    """Return the positions of joints with one degree of freedom in the order of qd, (n,); 0 for the others."""
    found, p, v = np.zeros(chain.joint_count), 0, 0
    for joint in chain.all_joints:
        if not joint.type.quaternion:
            found[v] = q[p]
        p, v = p + joint.type.position_count, v + joint.type.freedoms
    return found
