"""Forward dynamics of chains that are answered as forests, with results in the chain's own terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_closing import forest_close
from holdfast.dynamics.tree.forest_dynamics import FOREST_METHODS, ForestResult, solved_forest
from holdfast.dynamics.tree.mechanism_terms import (
    chain_results,
    chain_state,
    flat_rates,
    flat_state,
    joint_rows,
    mechanism_arguments,
)
from holdfast.errors import ClosureError, MethodNotApplicable
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, FrozenDict, frozen_property
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_state


@called
@dataclass(frozen=True, eq=False)
class MechanismResult(Frozen):
    """Accelerations and forces of a chain with branches, loops, couplings or several objects. SI units, world axes.

    Attributes:
        chain: the chain it belongs to.
        qdd: (n,) time derivatives of qd, a trunk's joints first, then those of the arms in order.
        object_acceleration: (6,) [omega_dot; v_dot of the origin] of the object, the true acceleration, or (k, 6) of k
            objects in order.
        grasp_wrench: (grasps and loops, 6) [moment; force] about the contact point: of each arm on its object, grasps
            in order, and then that of each loop's body a on its body b [N m, N].
        coupling_force: (couplings,) lambda, those of the arms in order and then the chain's own; a coupling acts on
            each of its joints with c lambda.
        rank: number of independent rows of the constraint on qd and on the twists of free bodies.
        mobility: dimension of the space of velocities that closures and couplings allow.
        status: whether the forces are unique; see `Status`.
        condition: dimensionless condition number of the constraint, the inverse of the smallest pivot; 1 by `kkt`,
            which does not determine it.
        method: name of the algorithm.
        bodies: the same result by bodies of `chain.forest`, with the accelerations of all of them.
        base_acceleration: (6,) [omega_dot; v_dot] of a floating base's origin; None without one.
    """

    chain: ClosedChain
    qdd: Array
    object_acceleration: Array
    grasp_wrench: Array
    coupling_force: Array
    rank: int
    mobility: int
    status: Status
    condition: float
    method: str
    bodies: ForestResult
    base_acceleration: Array | None = None

    def __repr__(self) -> str:
        """Return the method, rank, condition and status, and the wrench of each grasp and loop on a line."""
        if self.qdd.ndim > 1:
            return f"<{type(self).__name__} by {self.method}: {len(self.qdd)} systems of {', '.join(self.chain.names)}>"
        head = f"{type(self).__name__} by {self.method}: rank {self.rank}, mobility {self.mobility}, condition"
        lines = [f"{head} {self.condition:.4g}; {self.status.value}"]
        for name, wrench in self.wrenches.items():
            lines.append(f"  {name}: force {checks.place(wrench[3:])} N, moment {checks.place(wrench[:3])} N m")
        return f"<{chr(10).join(lines)}>"

    @frozen_property
    def wrenches(self) -> Mapping[Any, Array]:
        """The rows of `grasp_wrench` by the keys of the chain's grasps and loops."""
        return FrozenDict({key: self.grasp_wrench[..., i, :] for key, i in self.chain.as_forest.closures.items()})

    @frozen_property
    def accelerations(self) -> Mapping[str, Array]:
        """The accelerations of the objects by name, (6,)."""
        return FrozenDict({name: self.bodies.acceleration[k] for name, k in self.chain.as_forest.objects.items()})

    def __getitem__(self, name: Any) -> Array:
        """Return an arm's joint accelerations, an object's acceleration, or the wrench of a loop or a grasp by a frame.

        The wrench of a grasp that has only an arm's name is `wrenches[name]`.
        """
        parts = {**self.wrenches, **{arm: self.qdd[..., part] for arm, part in self.chain.joints.items()}}
        parts |= self.accelerations
        if name not in parts:
            raise KeyError(f"no {name!r}.{checks.did_you_mean(str(name), map(str, parts))}")
        return parts[name]


def mechanism_close(
    chain: ClosedChain, guess: State, *, hold_object: bool, hold_trunk: bool, hold_base: bool, limits: bool
) -> State:
    """Return the state near a guess that satisfies the chain's grasps, loops and couplings; see `forest_close`.

    Args:
        chain: the chain.
        guess: positions and velocities to start from.
        hold_object: keep poses and twists of all objects.
        hold_trunk: keep the joints of the trunk and a floating base.
        hold_base: keep a floating base.
        limits: whether joints must be within their position limits.

    Raises:
        ClosureError: it cannot be closed from there, or only beyond the limits of a joint.
    """
    require_state(chain, guess)
    held = flat_rates(
        np.zeros(chain.joint_count),
        np.full_like(guess.object_twist, hold_object),
        np.full(6, hold_base or hold_trunk) if chain.floats else None,
    )
    if chain.trunk is not None:
        held[joint_rows(chain)][chain.joints[TRUNK]] = hold_trunk
    found = forest_close(chain.as_forest.forest, *flat_state(chain, guess), held=held if held.any() else None)
    state, at = chain_state(chain, found.q, found.qd), 0
    if hold_object:  # even a zero rotation could change the last bit of a pose
        state = replace(state, object_pose=guess.object_pose)
    for name, joint in zip(chain.joint_names(), chain.all_joints, strict=True):
        (low, high), x = joint.position_limits, state.q[at]
        if limits and not joint.type.quaternion and not low <= x <= high:
            raise ClosureError(
                f"joint '{name}': closed only at {x:.6g}, expected {low:g} to {high:g}; try another guess, or"
                " limits=False"
            )
        at += joint.type.position_count
    return state


def mechanism_dynamics(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    inputs: Inputs | None = None,
    method: Any = "sequential",
    *,
    check: bool = True,
) -> MechanismResult:
    """Return the accelerations and forces of a chain by its forest; see `forward_dynamics` for arguments and errors."""
    if not isinstance(method, str) or method not in FOREST_METHODS:
        why = f"for serial arms that hold one object, but the chain has {', '.join(chain.beyond_serial[:2])}"
        listed = " or ".join(map(repr, FOREST_METHODS))
        raise MethodNotApplicable(f"{method if isinstance(method, str) else 'a function'}: {why}; try method={listed}")
    return mechanism_result(chain, solved_forest(mechanism_arguments(chain, state, tau, inputs), method, check)[2])


def mechanism_result(chain: ClosedChain, found: ForestResult) -> MechanismResult:
    """Return the result of a chain's forest in the chain's terms."""
    own = {name: part.of(vars(found)) for name, part in chain_results(chain).items()}
    return MechanismResult(
        chain,
        own["qdd"],
        own["object_acceleration"],
        own["grasp_wrench"],
        own["coupling_force"],
        found.rank,
        found.mobility,
        found.status,
        found.condition,
        found.method,
        found,
        own.get("floating_acceleration"),
    )
