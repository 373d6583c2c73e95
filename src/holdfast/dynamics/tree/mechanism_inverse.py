"""Inverse dynamics of chains that are answered as forests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.tree.forest_inverse import (
    driving_torques,
    inverse_at,
    pushes,
    torques_for,
    wanted_forces,
)
from holdfast.dynamics.tree.mechanism_terms import chain_results, flat_rates, joint_rows, mechanism_arguments
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, FrozenDict, frozen_property
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@called
@dataclass(frozen=True, eq=False)
class MechanismTorques(Frozen):
    """Torques of a chain with branches, loops, couplings or several objects. SI units, world axes.

    Attributes:
        chain: the chain.
        tau: (n,) torques of the drives, which also overcome dampers and springs; 0 for passive joints [N m or N].
        grasp_wrench: (grasps and loops, 6) [moment; force] about the contact points; see `MechanismResult`.
        coupling_force: (couplings,) a coupling acts on each of its joints with c times this.
    """

    chain: ClosedChain
    tau: Array
    grasp_wrench: Array
    coupling_force: Array

    def __repr__(self) -> str:
        """Return the torques of trunk and arms on a line each."""
        lines = [f"{type(self).__name__} [N m or N]"]
        lines += [f"  {name}: {checks.place(self.tau[part])}" for name, part in self.chain.joints.items()]
        return f"<{chr(10).join(lines)}>"

    @frozen_property
    def wrenches(self) -> Mapping[Any, Array]:
        """The rows of `grasp_wrench` by the keys of the chain's grasps and loops."""
        return FrozenDict({key: self.grasp_wrench[i] for key, i in self.chain.as_forest.closures.items()})


@np.errstate(all="ignore")  # what overflows is refused
def mechanism_torques(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike | None,
    inputs: Inputs | None,
    of_base: Array | None,
    object_acceleration: ArrayLike | None,
    *,
    check: bool = True,
) -> MechanismTorques:
    """Return torques for given accelerations by a chain's forest; see `inverse_dynamics` for errors.

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (grasps and loops, 6) wanted wrenches; None for zeros.
        inputs: external wrenches and base motion; zero by default.
        of_base: (6,) acceleration of a floating base, None without one.
        object_acceleration: (6,), or (k, 6) of several objects; None without one.
        check: whether state and accelerations must satisfy closures and couplings.
    """
    given, parts = mechanism_arguments(chain, state, inputs=inputs), chain_results(chain)

    def numbers(name: str, x: ArrayLike | None, needed: bool) -> Array:
        shape = parts[name].shape
        return np.zeros(shape) if x is None and not needed else checks.numbers(x, shape, name, StateError)

    of_joints = numbers("qdd", qdd, True)
    of_objects = numbers("object_acceleration", object_acceleration, bool(chain.free_objects))
    near = numbers("grasp_wrench", grasp_wrench, False)
    found = torques_for(given, flat_rates(of_joints, of_objects, of_base), near, check)
    return MechanismTorques(chain, found.tau[joint_rows(chain)], found.closure_wrench, found.coupling_force)


@np.errstate(all="ignore")  # what overflows is refused
def mechanism_holding(
    chain: ClosedChain,
    state: State,
    acceleration: Any,
    internal_force: Any,
    wished: Array | None = None,
    *,
    check: bool = True,
) -> Array:
    """Return torques for an acceleration of the objects, (n,); see `holding_torques` for errors. O(n^3).

    Args:
        chain: the chain.
        state: positions and velocities.
        acceleration: (6,), or (k, 6) of several objects; None for zero.
        internal_force: a push of every grasp along its contact normal into its object [N], or (grasps and loops, 6)
            wished wrenches.
        wished: (n,) joint accelerations, of which those of the arms give way as far as the objects' need it; zero by
            default.
        check: whether the state must be closed, and the accelerations must agree with it.
    """
    given, parts, forest = mechanism_arguments(chain, state), chain_results(chain), chain.as_forest.forest
    at, n = inverse_at(given), chain.joint_count
    shape = parts["object_acceleration"].shape
    alpha = np.zeros(shape) if acceleration is None else checks.numbers(acceleration, shape, "acceleration", StateError)
    if np.ndim(internal_force):
        near = checks.numbers(internal_force, parts["grasp_wrench"].shape, "internal_force", StateError)
        asked = wanted_forces(forest, at.terms, near)
    else:
        sizes = np.zeros(len(forest.closures))
        sizes[: len(chain.grasps)] = checks.numbers(internal_force, (), "internal_force", StateError)
        asked = pushes(forest, at.terms, sizes)
    of_arms = np.zeros(n, dtype=bool)
    of_arms[[k for part in chain.arm_joints for k in range(part.start, part.stop)]] = True
    of_base = np.zeros(6) if chain.floats else None
    moves = flat_rates(of_arms, np.zeros(alpha.shape, dtype=bool), of_base).astype(bool)
    wanted = flat_rates(np.zeros(n) if wished is None else wished, alpha, of_base)
    wanted = at.nearest(wanted, moves)
    if check:
        at.require(given, wanted)
    found = driving_torques(forest, at, wanted, asked)
    return found.tau[joint_rows(chain)].copy()  # which a user may change
