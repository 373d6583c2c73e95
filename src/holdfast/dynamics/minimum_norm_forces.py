"""Derivatives of the smallest grasp forces, for chains whose grasp forces are not unique.

f = W^-1 B^T mu with B f = (J^T f, -A^T f, H f), where J has columns for a trunk's joints and its floating base. At
constant rank, with an orthonormal basis N of ker B (N^T W N = 1) and P = 1 - N N^T W,
    df = P df_any + N N^T (dB^T) mu
where df_any is any solution of K dz = -R' for constant mu, with the smallest forces for f in R. A cotangent f_bar of
the smallest forces is equivalent to the cotangent f_bar - W N N^T f_bar of any solution, plus the virtual power v .
(B^T mu) of the wrenches v = N N^T f_bar (docs/theory/derivatives.md; Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.forward_derivatives import VirtualPower, arm_residual_rates
from holdfast.dynamics.closed.forward_jacobian import unit_wrenches
from holdfast.dynamics.closed.second_solve import Point
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.closed.virtual_power import ArmUnknowns
from holdfast.dynamics.constraint import free_wrenches, length_scale
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration
from holdfast.dynamics.trunk.trunk_power import TrunkUnknowns
from holdfast.questions.arrays import BASE_RESULT
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import twist_shift


class MinimumNormForces(NamedTuple):
    """The smallest of the forces that are not unique, f = W^-1 B^T mu.

    Attributes:
        N: (6 l, k) basis of the wrenches without effect, N^T W N = 1.
        W: (6 l,) the metric.
        mu: multipliers by arm; zero for arms without a grasp.
        of_trunk: multipliers of the trunk.
        wrench_jacobians: by result, its derivative with respect to the grasp wrenches (6 l,): (6 l, 6 l), or (6, 6 l)
            for the wrench of the base on the trunk.
    """

    N: Array
    W: Array
    mu: Mapping[str, ArmUnknowns]
    of_trunk: TrunkUnknowns
    wrench_jacobians: Mapping[str, Array]

    def forward(self, at: Point, found: dict[str, Array], tangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the rates of the results with those of the smallest forces.

        Args:
            at: the point, with the smallest forces.
            found: rates of the results for any choice of the forces.
            tangents: rates of the arguments by name.
        """
        rows = holding_rows(at.motion)
        nothing = {name: ArmUnknowns(*(0.0 * x for x in z)) for name, z in at.unknowns.items()}
        still_trunk = TrunkUnknowns(*(0.0 * x for x in self.of_trunk))
        turned = arm_residual_rates(with_trunk(at, self.of_trunk), dict(self.mu), tangents)
        still = arm_residual_rates(with_trunk(at, still_trunk), nothing, tangents)
        f = np.concatenate([found["grasp_wrench"][row] for row in rows])
        B_mu = np.concatenate([turned[name].wrench - still[name].wrench for name in at.motion.chain.grasps])
        more = self.N @ (self.N.T @ (B_mu - self.W * f))
        changed = {name: x.copy() for name, x in found.items()}
        for name, matrix in self.wrench_jacobians.items():
            changed[name][... if name == BASE_RESULT else rows] += (matrix @ more).reshape(-1, 6).squeeze()
        return changed

    def backward(self, at: Point, cotangents: Mapping[str, Array]) -> tuple[dict[str, Array], tuple[VirtualPower, ...]]:
        """Return the equivalent cotangents for any choice of forces, and the terms to add to L."""
        chain, rows = at.motion.chain, holding_rows(at.motion)
        f_bar = np.zeros(len(self.W))
        for name, matrix in self.wrench_jacobians.items():
            if name in cotangents:
                f_bar = f_bar + np.ravel(cotangents[name] if name == BASE_RESULT else cotangents[name][rows]) @ matrix
        v = self.N @ (self.N.T @ f_bar)
        of_f = np.array(cotangents.get("grasp_wrench", np.zeros((len(chain.arms), 6))))
        of_f[rows] -= (self.W * v).reshape(-1, 6)
        z = dict(at.unknowns) | {
            name: at.unknowns[name]._replace(wrench=x) for name, x in zip(chain.grasps, v.reshape(-1, 6), strict=True)
        }
        without = {name: x._replace(wrench=np.zeros(6)) if name in chain.grasps else x for name, x in z.items()}
        assert at.motion.trunk_case is not None
        carried = at.motion.trunk_case.carried(at.trunk, self.of_trunk)
        y = {**self.mu, **{name: self.mu[name]._replace(base=base.virtual) for name, base in carried.items()}}
        also = (VirtualPower(1.0, z, y, self.of_trunk), VirtualPower(-1.0, without, y, self.of_trunk))
        return {**cotangents, "grasp_wrench": of_f}, also


def minimum_norm_forces(at: Point) -> MinimumNormForces:
    """Return the smallest forces at a point whose wrenches are the smallest."""
    motion, chain = at.motion, at.motion.chain
    length = length_scale([c.offset for c in motion.contacts])
    W = np.tile(np.r_[np.full(3, 1 / length**2), np.ones(3)], len(motion.contacts))
    N = free_wrenches(motion, length, None if at.found.rank is None else int(at.found.rank))
    s = Stacked(motion)
    columns = [motion.trunk.jacobian(name, motion.arms[name].base_to_tip) for name in chain.grasps]
    by_trunk = np.vstack([np.hstack(one) for one in columns])
    f = np.concatenate([at.unknowns[name].wrench for name in chain.grasps])
    solved = np.linalg.lstsq(np.hstack([s.J, -s.A, s.HT, by_trunk]), W * f, rcond=1e-10)[0]
    counts = [chain.arms[name].joint_count for name in chain.grasps]
    ends = np.cumsum([*counts, 6, *(len(grasp.free) for grasp in chain.grasps.values())])
    *parts, below = np.split(solved, ends)
    qdd, alpha, rates = parts[: len(counts)], parts[len(counts)], parts[len(counts) + 1 :]
    none = np.zeros(6)
    mu = {name: ArmUnknowns(*(0.0 * x for x in z)) for name, z in at.unknowns.items()}
    for name, a, W_dot in zip(chain.grasps, qdd, rates, strict=True):
        mu[name] = mu[name]._replace(qdd=a, contact_acceleration=W_dot, object_acceleration=alpha)
    of_trunk = TrunkUnknowns(*np.split(below, [len(below) - 6])) if chain.floats else TrunkUnknowns(below, none)
    return MinimumNormForces(N, W, mu, of_trunk, wrench_jacobians(at))


def wrench_jacobians(at: Point) -> dict[str, Array]:
    """Return the derivatives of the results with respect to the grasp wrenches, by name; see `MinimumNormForces`."""
    motion, width = at.motion, 6 * len(at.motion.contacts)
    of_bases = np.zeros((width, width))
    under = np.zeros((6, width))
    for k, (name, arm) in enumerate(zip(motion.chain.grasps, motion.holding, strict=True)):
        own = slice(6 * k, 6 * k + 6)
        of_bases[own, own] = unit_wrenches(at.tips[name], arm).base
        if name in motion.trunk.mounts:
            lever = motion.trunk.mounts[name].frame.p - motion.trunk.base.p
            under[:, own] = twist_shift(lever).T @ of_bases[own, own]
    stands = motion.trunk.bodies and not motion.trunk.floats
    return {"grasp_wrench": np.eye(width), "base_wrench": of_bases} | ({BASE_RESULT: under} if stands else {})


def with_trunk(at: Point, moving: TrunkUnknowns) -> Point:
    """Return a point with other accelerations of the trunk, and of the bases mounted on it."""
    motion = at.motion
    base = moving.base if motion.chain.floats else None
    betas = motion.trunk.accelerations(TrunkAcceleration(moving.qdd, base))
    cases = {name: case.moved(motion.trunk.under(name, betas)) for name, case in motion.cases.items()}
    return replace(at, cases=cases, trunk=moving)


def holding_rows(motion: ChainMotion) -> list[int]:
    """Return the indices of the arms with a grasp, in the order of the grasps."""
    return [motion.chain.names.index(name) for name in motion.chain.grasps]
