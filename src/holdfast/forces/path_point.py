"""The limits on forces and rates at a place of a path, in the internal forces x, a = s'', b = s'^2 and c = s'.

Dampers add forces in proportion to c = sqrt(b).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.errors import StateError
from holdfast.forces.acceleration_map import acceleration_map, force_scale, motion_without_torques, scaled_map
from holdfast.forces.affine_map import ACCELERATION_SCALE, UNREACHED, AccelerationMap, AccelerationTask
from holdfast.forces.certificate import certificate
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.limit_rows import Limit, limit_rows
from holdfast.forces.limits import ForceLimits
from holdfast.forces.programmes import Costs, Solved, answer, posed
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State, shaped_inputs

PASSED_BETWEEN = 5e-4  # N by which limits may be passed
NO_COST = Costs(np.zeros((0, 0)), np.zeros(0))
OF_RATE = "rate"


@dataclass(frozen=True, eq=False)
class PathPoint:
    """The limits at a place of a path, in the unknowns y = (x, a, b, c), where x are the internal forces.

    Attributes:
        u: the share of the path.
        s: the place, for messages.
        found: the map at rest.
        forces: the limits on forces and accelerations, s = h - G y.
        rate: the limit of the joint that reaches its rate limit first, if any.
        free: number of internal forces.
        lam: wrenches of the grasps in contact axes, lam @ (x, a, b, c, 1).
    """

    u: float
    s: float
    found: AccelerationMap
    forces: list[Limit]
    rate: Limit | None
    free: int
    lam: Array

    @property
    def limits(self) -> list[Limit]:
        """All limits."""
        return self.forces if self.rate is None else [*self.forces, self.rate]

    @property
    def most(self) -> float:
        """The largest b within rate limits."""
        return np.inf if self.rate is None else float(self.rate.h[0])

    @cached_property
    def at_rest(self) -> float:
        """Least violation of limits on forces at rest, negative if there is room [N]."""
        return self.violation(0.0, 0.0)

    def violation(self, a: float, b: float) -> float:
        """Return by how much limits on forces have to be passed, negative if there is room [N]."""
        if not self.forces:
            return -np.inf
        done = self._least_violation(a, b)
        return -np.inf if done.verdict is Verdict.UNBOUNDED else done.extra * self.found.force

    def wrenches(self, x: Array, a: float, b: float) -> Array:
        """Return the wrenches of all grasps in contact axes."""
        return self.lam @ np.concatenate([x, [a, b, np.sqrt(b), 1.0]])

    def violation_with(self, wrenches: Array, a: float, b: float) -> float:
        """Return by how much limits on forces are passed with internal forces next to those of wrenches [N]."""
        missing = wrenches - self.wrenches(np.zeros(self.free), a, b)
        y = np.append(self._to_forces @ missing, [a, b, np.sqrt(b)])
        s = [limit.h - limit.G @ y for limit in self.forces]
        depths = [(one[0] - np.linalg.norm(one[1:])) / limit.weight for one, limit in zip(s, self.forces, strict=True)]
        return -min(depths, default=np.inf)

    @cached_property
    def _to_forces(self) -> Array:
        return np.linalg.pinv(self.lam[:, : self.free])

    def fastest(self) -> float:
        """Return the largest b within the limits, without dampers; infinite without a limit."""
        unknown = np.eye(self.free + 3)
        y = self.found._replace(v0=0.0 * unknown[0], N=unknown[:, :-2])  # y in place of v
        done = answer(posed("scale", y, self.limits, NO_COST, v1=unknown[-2])) if self.limits else None
        return done.extra if done is not None and done.verdict is Verdict.OPTIMAL else np.inf

    def require_held(self) -> None:
        """Check that the object can be held there.

        Raises:
            StateError: it cannot.
        """
        if (lack := self.at_rest) > PASSED_BETWEEN:
            done = self._least_violation(0.0, 0.0)
            words = [limit.words for limit in self.forces]
            proof = certificate(words, done.parts, lack, done.dual_residual * self.found.force)
            raise StateError(f"time_path: at s = {self.s:g}: the object cannot even be held there: {proof.words}")

    def _least_violation(self, a: float, b: float) -> Solved:
        start = np.concatenate([np.zeros(self.free), [a, b, np.sqrt(b)]])
        y = self.found._replace(v0=start, N=np.eye(self.free + 3)[:, :-3])  # y in place of v
        return answer(posed("violation", y, self.forces, NO_COST))


def path_point(
    chain: ClosedChain, u: float, s: float, state: State, joints: Array, acceleration: Array, limits: ForceLimits
) -> PathPoint:
    """Return the limits at a place of a path. O(n^3).

    Args:
        chain: the chain.
        u: the share of the path.
        s: the place.
        state: the closed state there with s' = 1.
        joints: (n,) second derivatives of the joint positions by s; what the grasps contradict is projected out.
        acceleration: (6,) acceleration of C with s' = 1 and s'' = 0, world axes.
        limits: the limits.

    Raises:
        StateError: the arms cannot give the object this motion.
    """
    at_rest, all_of_it = motion_at(chain, state, 0.0), AccelerationTask(np.eye(6), np.zeros(6))
    force, moved = force_scale(at_rest, np.zeros(6)), all_of_it._replace(values=acceleration)
    held, by_a = scaled_map(at_rest, all_of_it, state.object_twist, force=force)
    there = acceleration_map(motion_at(chain, state, 1.0), moved, force=force)
    back = acceleration_map(motion_at(chain, state, -1.0), moved, force=force) if is_damped(chain) else there
    U, size, Vt = np.linalg.svd(held.N[held.qdd], full_matrices=True)
    rank = int((size > UNREACHED * ACCELERATION_SCALE).sum())
    to_joints = held.N @ (Vt[:rank].T / size[:rank]) @ U[:, :rank].T  # accelerations of joints that the grasps permit
    x, still = held.N @ Vt[rank:].T, np.zeros(len(joints))
    v0, va, vb, vc = (
        v + to_joints @ (qdd - v[held.qdd])
        for v, qdd in (
            (held.v0, still),
            (by_a, state.qd),
            (0.5 * (there.v0 + back.v0) - held.v0, joints),
            (0.5 * (there.v0 - back.v0), still),
        )
    )
    of_rest, of_there = (limit_rows(each, state, limits) for each in (held, there))
    of_back = of_there if back is there else limit_rows(back, state, limits)
    rows = zip(of_rest, (one.h for one in of_there), (one.h for one in of_back), strict=True)
    found = [
        one._replace(
            G=np.column_stack(
                [one.G @ x, one.G @ va, one.G @ vb - 0.5 * (h + h_back) + one.h, one.G @ vc - 0.5 * (h - h_back)]
            ),
            h=one.h - one.G @ v0,
        )
        for one, h, h_back in rows
    ]
    free, at = x.shape[1], slice(held.alpha.stop, len(v0))
    lam = np.column_stack([x, va, vb, vc, v0])[at]
    return PathPoint(u, s, held, found, _rate_limit(chain, state.qd, force, free), free, lam)


def motion_at(chain: ClosedChain, state: State, rate: float) -> ChainMotion:
    """Return the chain's motion without torques at a multiple of a state's velocities."""
    moved = replace(state, qd=rate * state.qd, object_twist=rate * state.object_twist)
    return motion_without_torques(chain, moved, shaped_inputs(chain, None))


def is_damped(chain: ClosedChain) -> bool:
    """Return whether forces may depend on the velocities in another way than by their squares."""
    return (
        bool(chain.springs)
        or any(joint.damping for joint in chain.all_joints)
        or any(grasp.damping is not None for grasp in chain.grasps.values())
    )


def _rate_limit(chain: ClosedChain, slopes: Array, force: float, free: int) -> Limit | None:
    """Return b <= (rate / |q'|)^2 of the joint that allows least."""
    rates = np.array([joint.rate_limit for joint in chain.all_joints])
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.where(slopes == 0.0, np.inf, (rates / np.abs(slopes)) ** 2)
    j = int(np.argmin(most))
    if not np.isfinite(most[j]):
        return None
    return Limit(chain.joint_names()[j], OF_RATE, "", most[j] / force, np.eye(1, free + 3, free + 1), most[j : j + 1])
