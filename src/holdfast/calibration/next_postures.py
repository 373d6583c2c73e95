"""The postures that would tell most about what is still unknown."""

from __future__ import annotations

import numpy as np

from holdfast.calibration.calibrate import Calibration, PostureSource, problem_of
from holdfast.calibration.fit import settled
from holdfast.calibration.postures import Postures, postures_of
from holdfast.calibration.problem import evaluated, whitened
from holdfast.dynamics.closing import close
from holdfast.errors import ClosureError, HoldfastError, StateError
from holdfast.model import checks
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.state import State


def next_postures(
    found: Calibration,
    candidates: PostureSource | State,
    count: int = 10,
    *,
    tries: int = 200,
    turn: float = 0.5,
    shift: float = 0.2,
    seed: int = 0,
) -> Postures:
    """Return the postures that reduce the volume of the uncertainty most, chosen one after the other (D-optimal).

    Each choice maximises log det(H + J^T J) with the information H of the calibration, its priors and the postures
    chosen before; directions that are not determined count with their sizes. O(candidates count p^2 rows).

    Args:
        found: a calibration, with its chain, noise and priors.
        candidates: postures from which to choose, as for `calibrate`; or a closed state from which candidates are
            made: the object is moved at random, and the chain closed again within its joint limits.
        count: how many to return.
        tries: number of candidates that are made from a state.
        turn: largest turn of the object [rad] about each axis.
        shift: largest shift of the object along each axis [m].
        seed: of the random numbers.

    Raises:
        StateError: there are fewer candidates than requested, or they do not match the chain.
    """
    checks.instance(found, Calibration, "next_postures: found")
    number = int(checks.number(count, "next_postures: count", at_least=1.0))
    if isinstance(candidates, State):
        candidates = _closed_around(
            found, candidates, int(checks.number(tries, "tries", at_least=1.0)), turn, shift, seed
        )
    given = postures_of(candidates, found.model, "next_postures: candidates")
    if len(given) < number:
        raise StateError(f"next_postures: candidates: expected {number} or more, got {len(given)}")
    problem = problem_of(found.problem, given)
    at, _ = settled(problem, found.fitted.x)
    variances = np.array(list(found.noise.values())) ** 2
    J = whitened(problem, evaluated(problem, at), variances, np.ones(len(given))).still
    covariance = np.linalg.inv(found.fitted.information + np.eye(J.shape[2]))
    chosen: list[int] = []
    for _ in range(number):
        spread = np.eye(J.shape[1]) + J @ covariance @ np.swapaxes(J, 1, 2)
        gain = np.linalg.slogdet(spread)[1]
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        covariance = covariance - covariance @ J[best].T @ np.linalg.solve(spread[best], J[best] @ covariance)
    return given.part(np.array(chosen))


def _closed_around(found: Calibration, state: State, tries: int, turn: float, shift: float, seed: int) -> Array:
    """Return joint positions (candidates, n) of closed states around one, within joint limits."""
    chain, random = found.chain, np.random.default_rng(seed)
    low, high = chain.position_limits.T
    postures = []
    for _ in range(tries):
        moved = state.object_frame
        R = rotation.exp(random.uniform(-turn, turn, 3)) @ moved.R
        pose = np.r_[rotation.to_quaternion(R), moved.p + random.uniform(-shift, shift, 3)]
        try:
            closed = close(chain, State(state.q, 0.0 * state.qd, pose, np.zeros(6)), hold_object=True)
        except HoldfastError:
            continue
        if (closed.q >= low).all() and (closed.q <= high).all():
            postures.append(closed.q)
    if not postures:
        raise ClosureError("next_postures: no candidate could be closed; try smaller turn= and shift=")
    return np.array(postures)
