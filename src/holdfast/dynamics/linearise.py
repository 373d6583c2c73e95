"""Linearisation of forward dynamics about a state, in independent coordinates of the closed chain.

A change of state x = (dq, turn, shift, dqd, d omega, dv) keeps the grasps closed if it lies in the span of

    T = [ N_p  0 ; -G_v^+ D N_p  N_v ],    N_p = null G_p,  N_v = null G_v,  D = d(G_v v)/dx

with the position rows G_p and the velocity rows G_v of the grasps. For a floating base, its turn and shift follow those
of the object, and its twist follows that of the object. Along motions x = T z with
    dz/dt = A z + B du + rate,    A = T^+ F_x T,  B = T^+ F_u,  rate = T^+ F
in coordinates that do not rotate within the tangent space, T^+ dT/dt = 0 (docs/theory/derivatives.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE, constraint_rows
from holdfast.dynamics.derivatives import forward_dynamics_jacobian, result_named
from holdfast.dynamics.projection import displacement
from holdfast.dynamics.trunk.trunk_power import TrunkCase, TrunkUnknowns
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.pose import rates_of
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import skew
from holdfast.state import Inputs, State, shaped_inputs


@called
@dataclass(frozen=True, eq=False)
class Linearisation(Frozen):
    """The linearisation dz/dt = A z + B (tau - tau_0) + rate about a state.

    Attributes:
        state: the state.
        A: (m, m) derivative with respect to z.
        B: (m, n) derivative with respect to the joint torques.
        rate: (m,) dz/dt at the state itself; zero in equilibrium.
        basis: (2n + 12, m) T with the rows (dq, turn, shift, dqd, d omega, dv), those of the object along world axes;
            with a floating base (2n + 24, m), (dq, turn, shift, its turn, its shift, dqd, ..).
    """

    state: State
    A: Array
    B: Array
    rate: Array
    basis: Array

    def __repr__(self) -> str:
        """Return the numbers of coordinates and torques."""
        return f"<Linearisation: {self.A.shape[1]} coordinates, {self.B.shape[1]} torques, about {self.state!r}>"

    def coordinates(self, state: State) -> Array:
        """Return z of a neighbouring state, (m,), the component of its difference along the basis.

        Raises:
            StateError: the state has other joints, or another base.
        """
        return coordinates(self.basis, self.state, state)


def coordinates(basis: Array, here: State, state: State) -> Array:
    """Return the component of the difference between two states along a basis, (m,); see `Linearisation`.

    Raises:
        StateError: the states have different joints or bases.
    """
    checks.instance(state, State, "coordinates: state", StateError)
    if len(state.q) != len(here.q) or (state.base_pose is None) != (here.base_pose is None):
        floats = {True: "no floating base", False: "a floating base"}
        raise StateError(
            f"coordinates: state: expected {len(here.q)} joints and {floats[here.base_pose is None]}, got"
            f" {len(state.q)} joints and {floats[state.base_pose is None]}"
        )
    pairs = [(here.qd, state.qd), (here.object_twist, state.object_twist), (here.base_twist, state.base_twist)]
    velocities = [new - old for old, new in pairs if old is not None and new is not None]
    return np.linalg.lstsq(basis, np.r_[displacement(here, state), *velocities], rcond=None)[0]


def linearised_dynamics(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    inputs: Inputs | None = None,
    basis: Array | None = None,
    check: bool = True,
    generic_rank: int | None = None,
) -> Linearisation:
    """Return the linearisation of forward dynamics about a state; see `simulation.linearise`."""
    floating = chain.floats
    positions = ("q", "object_pose", *(["floating_pose"] if floating else []))
    velocities = ("qd", "object_twist", *(["floating_twist"] if floating else []))
    of = ("qdd", "object_acceleration", *(["floating_acceleration"] if floating else []))
    found = forward_dynamics_jacobian(
        chain,
        state,
        tau,
        of=of,
        by=(*positions, *velocities, "tau"),
        inputs=inputs,
        check=check,
        generic_rank=generic_rank,
    )
    T = basis_at(chain, state, shaped_inputs(chain, inputs))
    T = T if basis is None else turned_towards(T, basis)
    n, half = chain.joint_count, chain.velocity_count
    parts = [slice(0, n), *(slice(k, k + 6) for k in range(n, half, 6))]
    columns = [*parts, *(slice(half + part.start, half + part.stop) for part in parts)]
    twists = [state.object_twist, *([] if state.base_twist is None else [state.base_twist])]
    F_x, F_u = np.zeros((2 * half, 2 * half)), np.zeros((2 * half, n))
    F_x[:half, half:] = np.eye(half)
    for part, twist in zip(parts[1:], twists, strict=True):
        F_x[part.start : part.start + 3, part.start : part.start + 3] = skew(twist[:3])
    for rows, result in zip(columns[len(parts) :], of, strict=True):
        for part, name in zip(columns, (*positions, *velocities), strict=True):
            F_x[rows, part] = found[result, name]
        F_u[rows] = found[result, "tau"]
    F = np.concatenate([state.qd, *twists, *(result_named(found.result, name) for name in of)])
    inverse = np.linalg.pinv(T)
    return Linearisation(state, inverse @ F_x @ T, inverse @ F_u, inverse @ F, T)


def turned_towards(T: Array, basis: ArrayLike) -> Array:
    """Return a basis of the space of T that is aligned with another basis, by the polar factor of T^T basis.

    Raises:
        StateError: the shapes differ.
    """
    old = checks.numbers(basis, None, "linearise: basis", StateError)
    if old.shape != T.shape:
        raise StateError(f"linearise: basis: expected shape {T.shape}, as the state's own has, got {old.shape}")
    U, _, Vt = np.linalg.svd(T.T @ old)
    return T @ (U @ Vt)


def basis_at(chain: ClosedChain, state: State, inputs: Inputs) -> Array:
    """Return the tangent basis T at a state; see `tangent_basis`."""
    return tangent_basis(chain_motion(chain, state, np.zeros(chain.joint_count), inputs))


def tangent_basis(motion: ChainMotion) -> Array:
    """Return T, (2n + 12, m), for a chain's motion; (2n + 24, m) with a floating base."""
    chain = motion.chain
    half = chain.velocity_count
    in_position = [replace(c, rows=c.grasp.of_kind.position_rows) for c in motion.contacts]
    N_p = constraint_rows(replace(motion, contacts=in_position)).motions
    rows = constraint_rows(motion)
    gap_rates = velocity_gap_rates(motion)
    turned = np.array([gap_rates(unit) for unit in np.eye(half)]).T  # D
    N_v = rows.motions
    turned = turned.reshape(len(rows.matrix), half)
    follows = (
        -np.linalg.pinv(rows.matrix, rcond=NULL_SINGULAR_VALUE) @ (turned @ N_p) if len(rows.matrix) else 0.0 * N_p
    )
    return np.block([[N_p, np.zeros((half, N_v.shape[1]))], [follows, N_v]])


def velocity_gap_rates(motion: ChainMotion) -> Callable[[Array], Array]:
    """Return the rates of the velocity residuals, (rows,), as a function of those of the positions.

    Velocities are constant. The rates of the positions are (n + 6,), those of the joints and of the object's
    [turn; shift]; (n + 12,) with a floating base.
    """
    chain, n, trunk = motion.chain, motion.chain.joint_count, motion.trunk_case
    assert trunk is not None  # as the chain is in motion
    still = np.zeros(chain.velocity_count)
    none = TrunkUnknowns(np.zeros(len(trunk.serial.given.q)), np.zeros(6))
    of_bases = trunk.base_motion(none, list(_trunk_rates(chain, trunk, still)))

    def given(moved: Array) -> dict[str, dict[str, Array]]:
        carried, found = trunk.base_rates(of_bases, _trunk_rates(chain, trunk, moved)), {}
        for name in chain.grasps:
            poses = rates_of({"object_pose": moved[n : n + 6]}, "object", motion.cases[name].frame.R)
            found[name] = {"q": moved[chain.joints[name]]} | poses | carried.get(name, {})
            found[name].pop("base_acceleration", None)
        return found

    gaps = {name: motion.cases[name].velocity_gap(list(rates)) for name, rates in given(still).items()}
    return lambda moved: np.concatenate(
        [np.zeros(0), *(x for name, rates in given(moved).items() for x in gaps[name].rates(*rates.values()))]
    )


def _trunk_rates(chain: ClosedChain, case: TrunkCase, moved: Array) -> dict[str, Array]:
    """Return the rates of the trunk's positions."""
    rates = {"q": moved[: len(case.serial.given.q)]}
    if chain.floats:
        rates |= rates_of({"floating_pose": moved[chain.joint_count + 6 :]}, "floating", case.base.R, "base")
    return rates
