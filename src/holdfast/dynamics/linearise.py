"""Forward dynamics made linear about a state, in as many coordinates as the closed chain has.

A change of state x = (dq, turn, shift, dqd, d omega, dv) keeps the grasps closed if it lies in the span of

    T = [ N_p  0 ; -G_v^+ D N_p  N_v ],    N_p = null G_p,  N_v = null G_v,  D = d(G_v v)/dx

with G_p, G_v the rows of the grasps in position and in velocity. Along motions x = T z with

    dz/dt = A z + B du + rate,    A = T^+ F_x T,  B = T^+ F_u,  rate = T^+ F

in coordinates that do not turn within the tangent space, T^+ dT/dt = 0 (docs/theory/derivatives.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.forward_derivatives import rates_of
from holdfast.dynamics.constraint import DEPENDENT, constraint_rows
from holdfast.dynamics.derivatives import forward_dynamics_jacobian
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import skew
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class Linearisation(Frozen):
    """dz/dt = A z + B (tau - tau_0) + rate about a state.

    Attributes:
        state: where.
        A: (m, m).
        B: (m, n) by joint torques.
        rate: (m,) how fast z changes there; zero in equilibrium.
        basis: (2n + 12, m) T; its rows are (dq, turn, shift, dqd, d omega, dv), of the object along world axes.
    """

    state: State
    A: Array
    B: Array
    rate: Array
    basis: Array

    def coordinates(self, state: State) -> Array:
        """Return z of a state nearby, (m,): what of its difference lies along the basis."""
        here, there = self.state, state
        turn = rotation.log(there.object_frame.R @ here.object_frame.R.T)
        shift = there.object_frame.p - here.object_frame.p
        velocities = (there.qd - here.qd, there.object_twist - here.object_twist)
        difference = np.concatenate([there.q - here.q, turn, shift, *velocities])
        return np.linalg.lstsq(self.basis, difference, rcond=None)[0]


def linearise(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    inputs: Inputs | None = None,
    basis: Array | None = None,
    check: bool = True,
    generic_rank: int | None = None,
) -> Linearisation:
    """Return forward dynamics made linear about a state, for regulators such as LQR. O(n^3).

    Args:
        chain: arms, object and grasps.
        state: positions and velocities; must satisfy the grasps.
        tau: (n,) joint torques [N m or N].
        inputs: external wrenches and base motion, held; zero by default.
        basis: one that a neighbouring state has, which the new one is turned towards, so that along a trajectory it
            does not jump.
        check: False skips the consistency check.
        generic_rank: rank of the constraint away from singular configurations, if known.

    Returns:
        A `Linearisation`; m is twice the chain's mobility, less one for each row that grasps hold in velocity only.

    Raises:
        StateError: wrong shapes, or the state breaks a grasp.
        SingularChainError: the constraint's rank drops here.
        MethodNotApplicable: the chain has a trunk or bushings.
    """
    by = ("q", "object_pose", "qd", "object_twist", "tau")
    found = forward_dynamics_jacobian(
        chain,
        state,
        tau,
        of=("qdd", "object_acceleration"),
        by=by,
        inputs=inputs,
        check=check,
        generic_rank=generic_rank,
    )
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), (inputs or Inputs()).shaped(chain))
    T = tangent_basis(motion)
    if basis is not None:
        old = checks.numbers(basis, None, "linearise: basis", StateError)
        if old.shape != T.shape:
            raise StateError(f"linearise: basis: expected shape {T.shape}, as the state's own has, got {old.shape}")
        U, _, Vt = np.linalg.svd(T.T @ old)
        T = T @ (U @ Vt)
    n, half = chain.joint_count, chain.joint_count + 6
    F_x, F_u = np.zeros((2 * half, 2 * half)), np.zeros((2 * half, n))
    F_x[:half, half:] = np.eye(half)
    F_x[n : n + 3, n : n + 3] = skew(state.object_twist[:3])
    columns = (slice(0, n), slice(n, half), slice(half, half + n), slice(half + n, 2 * half))
    for rows, of in ((columns[2], "qdd"), (columns[3], "object_acceleration")):
        for part, name in zip(columns, by, strict=False):
            F_x[rows, part] = found[of, name]
        F_u[rows] = found[of, "tau"]
    F = np.concatenate([state.qd, state.object_twist, found.result.qdd, found.result.object_acceleration])
    inverse = np.linalg.pinv(T)
    return Linearisation(state, inverse @ F_x @ T, inverse @ F_u, inverse @ F, T)


def tangent_basis(motion: ChainMotion) -> Array:
    """Return T, (2n + 12, m), of a chain in motion without a trunk."""
    chain = motion.chain
    n, half = chain.joint_count, chain.joint_count + 6
    in_position = [replace(c, rows=c.grasp.of_kind.position_rows) for c in motion.contacts]
    N_p = constraint_rows(replace(motion, contacts=in_position)).motions
    rows = constraint_rows(motion)
    turned = np.zeros((len(rows.matrix), half))  # D
    for name, part in zip(chain.grasps, rows.slices, strict=True):
        case = motion.cases[name]
        gap, joints = case.velocity_gap(), chain.joints[name]
        count = joints.stop - joints.start
        still = {"q": np.zeros(count), "object_R": np.zeros((3, 3)), "object_p": np.zeros(3)}
        for k, unit in enumerate(np.eye(count)):
            (turned[part, joints.start + k],) = gap.rates(*(still | {"q": unit}).values())
        for k, unit in enumerate(np.eye(6)):
            moved = rates_of({"object_pose": unit}, "object", case.frame.R)
            (turned[part, n + k],) = gap.rates(*(still | moved).values())
    N_v = rows.motions
    follows = -np.linalg.pinv(rows.matrix, rcond=DEPENDENT) @ (turned @ N_p) if len(rows.matrix) else 0.0 * N_p
    return np.block([[N_p, np.zeros((half, N_v.shape[1]))], [follows, N_v]])
