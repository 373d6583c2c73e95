"""The table of forward dynamics algorithms (`method=`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from holdfast.dynamics.arm import free_dynamics
from holdfast.dynamics.closed.analytic import analytic
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.general import FreeDynamics, general
from holdfast.dynamics.closed.kkt import kkt
from holdfast.dynamics.closed.nonrigid import nonrigid
from holdfast.dynamics.closed.rccfd1 import rccfd1
from holdfast.dynamics.closed.rccfd2 import rccfd2
from holdfast.dynamics.closed.rccfd3 import rccfd3
from holdfast.dynamics.closed.reduced_kkt import reduced_kkt
from holdfast.dynamics.closed.sequential import sequential
from holdfast.errors import MethodNotApplicable
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, FrozenDict

RIGID_REGULAR = "rigid grasps, Omega regular"


@called
@dataclass(frozen=True)
class Method(Frozen):
    """One algorithm.

    Attributes:
        name: the value of `method=`.
        equation: its equation in the paper.
        cost: order of the operations in the numbers of joints n and arms l.
        applies: the chains to which it applies.
        rigid_only: whether every grasp must be rigid.
        solve: the function that implements it.
        takes_trunk: whether arms may be mounted on a trunk.
    """

    name: str
    equation: str
    cost: str
    applies: str
    rigid_only: bool
    solve: Callable[[ChainMotion], Solution]
    takes_trunk: bool = False


def _general(name: str, source: str, cost: str, solver: FreeDynamics) -> Method:
    return Method(
        f"general:{name}", f"(4.9) with {source}", cost, RIGID_REGULAR, True, partial(general, free_dynamics=solver)
    )


_FILTER = "O(n) + O(l)"
_LINEAR = "O(n) + O(l^3)"
_CUBIC = "O(n^3)"
METHODS: Mapping[str, Method] = FrozenDict(
    {
        m.name: m
        for m in (
            Method("sequential", "filter across arms, after (6.18)", _FILTER, "every chain", False, sequential, True),
            Method("kkt", "(2.11), (b.1)", _CUBIC, "all grasps, f unique", False, kkt, True),
            Method("reduced_kkt", "(2.14)", _CUBIC, RIGID_REGULAR, True, reduced_kkt),
            Method("analytic", "(3.6)", _CUBIC, RIGID_REGULAR, True, analytic),
            _general("composite", "the mass matrix", "O(n N^2) + O(l^3)", free_dynamics.composite),
            _general("newton_euler", "unit accelerations", "O(n N^2) + O(l^3)", free_dynamics.newton_euler_columns),
            _general("articulated", "(5.8)-(5.10)", _LINEAR, free_dynamics.articulated),
            _general("three_sweep", "(5.14)", _LINEAR, free_dynamics.three_sweep),
            Method("rccfd1", "(6.11)", _LINEAR, RIGID_REGULAR, True, rccfd1),
            Method("rccfd2", "(6.18)", _LINEAR, RIGID_REGULAR, True, rccfd2),
            Method("rccfd3", "(6.22)", _LINEAR, RIGID_REGULAR, True, rccfd3),
            Method("nonrigid", "(b.9)", _LINEAR, "all grasps, Omega regular", False, nonrigid),
        )
    }
)


def method_named(name: str | FreeDynamics) -> Method:
    """Return the method with the given name, or (4.9) with a user's function for the dynamics of one arm.

    Raises:
        MethodNotApplicable: if there is no such method.
    """
    if callable(name):
        label = getattr(name, "__name__", "user")
        return _general(label, "a user's solver", "any", name)
    if not isinstance(name, str) or name not in METHODS:
        raise MethodNotApplicable(f"no method {name!r}.{checks.did_you_mean(str(name), METHODS)}")
    return METHODS[name]
