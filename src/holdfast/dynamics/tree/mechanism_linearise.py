"""Linearisation of chains that are answered as forests, in independent coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.linearise import turned_towards
from holdfast.dynamics.tree.forest_linearise import linearised_forest
from holdfast.dynamics.tree.mechanism_terms import driven_joints, flat_state, joint_rows, mechanism_arguments
from holdfast.dynamics.tree.varied_forest import displacement
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_state


@called
@dataclass(frozen=True, eq=False)
class MechanismLinearisation(Frozen):
    """The linearisation dz/dt = A z + B (tau - tau_0) + rate of a chain with branches about a state.

    Attributes:
        chain: the chain.
        state: the state.
        A: (m, m) derivative with respect to z.
        B: (m, n) derivative with respect to the joint torques; zero for passive joints.
        rate: (m,) dz/dt at the state itself; zero in equilibrium.
        basis: (2 n_v, m) T with the rows (dq, dqd), both in the coordinates of qd: those of a floating base first, then
            of the joints, and of the objects [turn; shift] in world axes.
    """

    chain: ClosedChain
    state: State
    A: Array
    B: Array
    rate: Array
    basis: Array

    def __repr__(self) -> str:
        """Return the numbers of coordinates and torques."""
        return (
            f"<{type(self).__name__}: {self.A.shape[1]} coordinates, {self.B.shape[1]} torques, about {self.state!r}>"
        )

    def coordinates(self, state: State) -> Array:
        """Return z of a neighbouring state, (m,), the component of its difference along the basis.

        Raises:
            StateError: it is a state of another chain.
        """
        require_state(self.chain, state)
        (q, qd), (there, then) = flat_state(self.chain, self.state), flat_state(self.chain, state)
        moved = np.append(displacement(self.chain.as_forest.forest, q, there), then - qd)
        return np.linalg.lstsq(self.basis, moved, rcond=None)[0]


def mechanism_linearisation(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    inputs: Inputs | None,
    basis: Array | None,
    check: bool,
) -> MechanismLinearisation:
    """Return the linearisation of forward dynamics about a state by a chain's forest; see `linearise`. O(n^3)."""
    found = linearised_forest(mechanism_arguments(chain, state, tau, inputs), check)
    T = found.basis if basis is None else turned_towards(found.basis, basis)
    turn = np.eye(T.shape[1]) if basis is None else np.linalg.pinv(found.basis) @ T
    B = turn.T @ found.B[:, joint_rows(chain)] * driven_joints(chain)
    return MechanismLinearisation(chain, state, turn.T @ found.A @ turn, B, turn.T @ found.rate, T)
