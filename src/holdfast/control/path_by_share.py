"""A path of the object and of the joints by its share, from 0 to 1."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.control.paths import Joints, Target, path_function, quintic
from holdfast.control.piecewise import polynomial, row_at
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.closing import close
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.scalar import Array, Scalar, clip, maximum, minimum, sqrt, where
from holdfast.state import State, require_fit

STANDING_SHARE = 1e-6  # of the path's mean speed, below which it stands
OFF_REST = 1e-3  # share of the span by which derivatives stay away from the ends of a path that rests there
INVERSE_STEPS = 12
SMALLEST_RATE = 1e-300


class PathByShare(NamedTuple):
    """A path of object and joints by its share u, from 0 to 1.

    If the path rests at both ends, so that its derivatives vanish there, s is a quintic's inverse of u, which makes
    that of `RestToRest` straight.

    Attributes:
        path: the object's target as a function of s.
        joints: joint positions and their first two derivatives as a function of s, (n,) each.
        first: s at u = 0.
        length: length of the span of s.
        rests: whether the path rests at both ends.
    """

    path: Callable[[float], Target]
    joints: Callable[[float], Joints]
    first: float
    length: float
    rests: bool

    def place(self, u: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Return s, and ds/du and d2s/du2 with the s they belong to, which stays off the ends if the path rests."""
        if not self.rests:
            s = self.first + self.length * u
            return s, s, self.length, 0.0
        x = _inverse_quintic(u)
        near = clip(x, OFF_REST, 1.0 - OFF_REST)
        _, rate, second = quintic(near)
        slope = self.length / rate
        return self.first + self.length * x, self.first + self.length * near, slope, -slope * second / (rate * rate)

    def object_at(self, u: Scalar) -> Target:
        """Return the object's target with u as time."""
        s, near, slope, curve = self.place(u)
        at = self.path(near)
        acceleration = slope * slope * at.acceleration + curve * at.twist
        return Target(at.pose if s is near else self.path(s).pose, slope * at.twist, acceleration)

    def joints_at(self, u: Scalar) -> Joints:
        """Return joint positions and their derivatives by u."""
        s, near, slope, curve = self.place(u)
        q, first, second = self.joints(near)
        q = q if s is near else self.joints(s)[0]
        return q, slope * first, slope * slope * second + curve * first


class GivenJoints(NamedTuple):
    """Joint positions and two derivatives from a function, checked."""

    given: Callable[[float], Any]
    joint_count: int

    def __call__(self, s: float) -> Joints:
        """Return them at s.

        Raises:
            ModelError, StateError: the function returns something else.
        """
        found = self.given(s)
        if not isinstance(found, tuple) or len(found) != 3:
            raise ModelError(
                f"time_path: joints: expected a tuple of q and its first two derivatives, got {checks.short(found)}"
            )
        q, slope, curve = (checks.numbers(x, (self.joint_count,), "time_path: joints", StateError) for x in found)
        return q, slope, curve


class JointSpline(NamedTuple):
    """Joint positions and two derivatives from a spline through closed states.

    Attributes:
        rows: (k, 6 n + 1) of each piece the coefficients by powers of s - begin, (n, 6), and begin.
    """

    rows: Array

    def __call__(self, s: Scalar) -> Joints:
        """Return them at s."""
        row = row_at(s, self.rows[:, -1], self.rows)
        return polynomial(row[:-1].reshape(-1, 6), s - row[-1])


def path_by_share(chain: ClosedChain, joints: Any, path: Callable[[float], Any], places: Array) -> PathByShare:
    """Return the path of object and joints by its share.

    Raises:
        ModelError: it stands elsewhere than at both ends.
    """
    targets = [path(float(s)) for s in places]
    for target in targets:
        checks.instance(target, Target, "time_path: path: what it returns")
    still = _standing([target.twist for target in targets])
    if isinstance(joints, State):
        at = _continued(chain, joints, places, targets, bool(still[0] and still[-1]))
    else:
        at = GivenJoints(path_function(joints, "time_path: joints"), chain.joint_count)
        still &= _standing([at(float(s))[1] for s in places])
    rests = bool(still[0] and still[-1])
    if still[1:-1].any() or still[0] != still[-1]:
        s = places[1:-1][still[1:-1]][0] if still[1:-1].any() else places[0 if still[0] else -1]
        raise ModelError(
            f"time_path: path: expected one that moves everywhere, or rests at both ends only; it stands at s = {s:g}."
            " Try one path from rest to rest after the other"
        )
    return PathByShare(path, at, float(places[0]), float(places[-1] - places[0]), rests)


def _standing(rates: list[Array]) -> Array:
    """Return where a path stands, (m,) booleans."""
    speeds = np.linalg.norm(rates, axis=1)
    return ~(speeds > STANDING_SHARE * speeds.mean())


def _continued(chain: ClosedChain, start: State, places: Array, targets: list[Target], rests: bool) -> JointSpline:
    """Return the joint path through the closed states nearest to each other, in which soft fingers do not roll."""
    from scipy.interpolate import make_interp_spline  # imported here because it takes half a second

    require_fit(chain, start)
    held = held_steadily(chain, start)
    q, found = start.q, []
    for target in targets:
        q = closed_along(held, q, np.zeros_like(q), target).q
        found.append(q)
    still = [(1, np.zeros_like(q)), (2, np.zeros_like(q))]
    try:
        whole = make_interp_spline(places, np.array(found), k=5, bc_type=(still, still) if rests else None)
    except np.linalg.LinAlgError as cause:
        raise ModelError(
            f"time_path: span: expected one whose places rounding tells apart, got {places[0]:g} to {places[-1]:g}"
        ) from cause
    begins = np.unique(whole.t)[:-1]
    coefficients = np.stack([whole(begins, j) / math.factorial(j) for j in range(6)], axis=-1)
    return JointSpline(checks.read_only(np.column_stack([coefficients.reshape(len(begins), -1), begins])))


def held_steadily(chain: ClosedChain, state: State) -> ClosedChain:
    """Return the chain with rigid grasps, where the tips are, in place of soft fingers and bushings.

    No spin of a soft finger follows from positions, and a bushing would leave its arm behind.
    """
    tips, inverse = chain_at_rest(chain, state).arms, state.object_frame.inverse()
    grasps = {
        name: Grasp("rigid", inverse @ tips[name].at.tip)
        if grasp.of_kind.rate_rows or grasp.of_kind.compliant
        else grasp
        for name, grasp in chain.grasps.items()
    }
    return replace(chain, grasps=grasps)


def closed_along(chain: ClosedChain, q: Array, qd: Array, target: Target, *, limits: bool = True) -> State:
    """Return the closed state nearest to joint positions and rates, with the object on its path.

    Trunk and arms may move.
    """
    guess = State(q, qd, target.pose.wxyz_xyz, target.twist)
    return close(chain, guess, hold_object=True, hold_trunk=False, limits=limits)


def _inverse_quintic(u: Scalar) -> Scalar:
    """Return x with quintic(x) = u in 0..1, by Newton steps from the side of the nearer end."""
    upper = u > 0.5
    near = where(upper, 1.0 - u, u)
    x, root = 1.0, 0.1 * near
    for _ in range(4):  # about the cube root of near / 10: 1/4 + 1/16 + ... = 1/3
        root = sqrt(sqrt(root))
        x = x * root
    for _ in range(INVERSE_STEPS):
        value, rate, _ = quintic(x)
        x = where(rate > 0.0, minimum(x - (value - near) / maximum(rate, SMALLEST_RATE), 0.5), 0.0)
    return where(upper, 1.0 - x, x)
