"""A posture: where redundant joints would like to be, and how much each of them matters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, Converted, Frozen, FrozenDict
from holdfast.spatial.scalar import Array
from holdfast.state import State

LARGEST_WISH = 1e5  # rad or m

PerJoint = Mapping[str, ArrayLike] | ArrayLike | None


class PostureCost(NamedTuple):
    """The cost of joint positions, 1/2 sum stiffness_j (q_j - wish_j)^2.

    Attributes:
        wish: (n,) the cheapest joint positions [rad or m].
        stiffness: (n,) [1/rad^2 or 1/m^2].
    """

    wish: Array
    stiffness: Array

    def of(self, q: Array) -> float:
        """Return the cost of joint positions, (n,)."""
        return 0.5 * float(self.stiffness @ (q - self.wish) ** 2)


@called
@dataclass(frozen=True, eq=False)
class Posture(Frozen):
    """Wished joint positions with weights, for what the grasps leave to redundant arms and to a trunk.

    cost = 1/2 sum_j weight_j ((q_j - q*_j) / u_j)^2

    The unit u_j is half the range of a joint with two limits, so that it costs half its weight at either of them;
    otherwise it is 1 rad, or the longest reach of the arms.

    Attributes:
        q: wished positions q* [rad or m], by "arm/joint" as in `ClosedChain.joint_names`, by arm or "trunk" (one number
            for all of its joints, or one each), or (n,). By default q* is the middle of the range of joints with two
            limits in a trunk and in arms with a grasp; joints of arms with a bushing, and all others, stay where they
            are.
        weights: weights >= 0, in the same forms; by default 1.
    """

    q: Converted[Any, PerJoint] = NOT_GIVEN
    weights: Converted[Any, PerJoint] = NOT_GIVEN

    def __post_init__(self) -> None:
        for name in ("q", "weights"):
            given = getattr(self, name)
            if isinstance(given, Mapping):
                given = FrozenDict(
                    {
                        key: checks.numbers(x, None, f"posture: {name} of {key!r}", StateError)
                        for key, x in given.items()
                    }
                )
            elif given is not None:
                given = checks.vector(given, f"posture: {name}", StateError)
            object.__setattr__(self, name, given)

    def cost(self, chain: ClosedChain, state: State) -> PostureCost:
        """Return the cost for a chain whose other joints stay where they are in a state.

        Raises:
            StateError: a name is unknown, a number of values is wrong, a position is beyond 1e5, or a weight is
                negative.
        """
        low, high = chain.position_limits.T
        ranged = np.isfinite(high - low)
        sizes = coordinate_sizes(chain_at_rest(chain, state))[: chain.joint_count]
        units = np.where(ranged & (high > low), 0.5 * (high - low), sizes)
        middle = 0.5 * (np.where(ranged, low, 0.0) + np.where(ranged, high, 0.0))
        for name in (chain.arms.keys() - chain.grasps.keys()) | set(chain.bushings):
            ranged[chain.joints[name]] = False
        wish = _each_joint(chain, self.q, np.where(ranged, middle, state.q), "posture: q")
        weights = _each_joint(chain, self.weights, np.ones(chain.joint_count), "posture: weights")
        if np.abs(wish).max(initial=0.0) > LARGEST_WISH:
            raise StateError(f"posture: q: expected at most {LARGEST_WISH:g} rad or m, got {np.abs(wish).max():g}")
        if (weights < 0).any():
            name = chain.joint_names()[int(np.argmin(weights))]
            raise StateError(f"posture: weights: expected >= 0, got {weights.min():g} for '{name}'")
        return PostureCost(wish, weights / units**2)


def _each_joint(chain: ClosedChain, given: Any, default: Array, what: str) -> Array:
    """Return one value per joint, (n,), from values by joint, arm or trunk, or from (n,).

    Raises:
        StateError: a name is unknown, or a number of values is wrong.
    """
    if given is None:
        return default
    if not isinstance(given, Mapping):
        return np.array(checks.numbers(given, (chain.joint_count,), what, StateError))
    places = {name: slice(k, k + 1) for k, name in enumerate(chain.joint_names())}
    found = np.array(default)
    for name, value in sorted(given.items(), key=lambda item: item[0] in places):  # single joints come last
        part = places.get(name, chain.joints.get(name))
        if part is None:
            raise StateError(f"{what}: no joint or arm '{name}'.{checks.did_you_mean(name, [*places, *chain.joints])}")
        shape = () if np.ndim(value) == 0 else (part.stop - part.start,)
        found[part] = checks.numbers(value, shape, f"{what} of '{name}'", StateError)
    return found
