"""The momentum balance: momentum is changed by bases, weights and external wrenches, not by grasps or drives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.energy import bodies, total_mass_moment
from holdfast.dynamics.result import ForwardResult, require_result_of
from holdfast.dynamics.tree.mechanism_balance import mechanism_momentum_rate
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest
from holdfast.model.trunk import bodies_of
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.vector import cross
from holdfast.state import Inputs, State, require_fit, shaped_inputs


@np.errstate(all="ignore")  # what overflows is refused below
def momentum_rate(
    chain: ClosedChain,
    state: State,
    result: ForwardResult,
    about: ArrayLike | None = None,
    inputs: Inputs | None = None,
) -> Array:
    """Return the rate of `energy.momentum` about a fixed world point, (6,) [angular; linear] [N m, N].

    d/dt (L, P) = sum of the wrenches of bases, weights, springs and the surroundings, about the same point. O(n).

    Args:
        chain: the chain.
        state: positions of links and object.
        result: forward dynamics at that state, for the base wrenches; for a chain with branches, loops, couplings or
            several objects, for the accelerations of its bodies, from which the rate then follows.
        about: (3,) world point; default the world's origin.
        inputs: external wrenches.

    Raises:
        StateError: `about` or the inputs have a wrong shape.
    """
    if answered_as_forest(chain):
        return mechanism_momentum_rate(chain, state, result, about, inputs)
    require_fit(chain, state)
    require_result_of(chain, result)
    checks.numbers(result.base_wrench, (len(chain.arms), 6), "result: base_wrench", StateError)
    point = np.zeros(3) if about is None else checks.numbers(about, (3,), "about", StateError)
    given = with_force_elements(chain, state, shaped_inputs(chain, inputs))
    return checks.finite(rate_of(chain, state, result, given, point), "momentum rate")


def rate_of(chain: ClosedChain, state: State, forces: Any, given: Inputs, point: Array) -> Array:
    """Return `momentum_rate` for floats or traced numbers.

    Args:
        chain: the chain.
        state: positions of links and object.
        forces: what has a `base_wrench` and a `trunk_base_wrench`.
        given: shaped inputs, which include the wrenches of springs.
        point: (3,) a fixed world point.
    """
    assert given.object_wrench is not None
    rate = shift_wrench(state.object_frame.p - point, given.object_wrench)
    for (name, arm), f in zip(chain.arms.items(), forces.base_wrench, strict=True):
        if name not in chain.mounts:
            rate = rate + shift_wrench(arm.base.p - point, f)
    if chain.trunk is not None and forces.trunk_base_wrench is not None:  # zero for a floating base
        rate = rate + shift_wrench(chain.trunk.base.p - point, forces.trunk_base_wrench)
    on_trunk = len(bodies_of(chain.trunk))
    if given.link_wrenches is not None or given.trunk_link_wrenches is not None:
        *links, _ = bodies(chain, state)
        for some, wrenches in ((links[:on_trunk], given.trunk_link_wrenches), (links[on_trunk:], given.link_wrenches)):
            for body, f in () if wrenches is None else zip(some, wrenches, strict=True):
                rate = rate + shift_wrench(body.origin - point, f)
    sums = total_mass_moment(chain, state)
    mass, moment = sums[0], sums[1:] - sums[0] * point
    return rate + concatenate([cross(moment, chain.gravity), mass * chain.gravity])
