"""The momentum balance: momentum is changed by bases, weights and external wrenches, not by grasps or drives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.energy import (
    MovingBody,
    bodies,
    total_kinetic_energy,
    total_mass_moment,
    total_momentum,
    total_potential_energy,
)
from holdfast.dynamics.kinematics import tip_rotations
from holdfast.dynamics.result import ForwardResult, require_result_of
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import OBJECT, STATE, Row
from holdfast.questions.case import VariedCase
from holdfast.questions.question import Question, of_arms
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
        result: forward dynamics at that state, for the base wrenches.
        about: (3,) world point; default the world's origin.
        inputs: external wrenches.

    Raises:
        StateError: `about` or the inputs have a wrong shape.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    checks.numbers(result.base_wrench, (len(chain.arms), 6), "result: base_wrench", StateError)
    point = np.zeros(3) if about is None else checks.numbers(about, (3,), "about", StateError)
    given = with_force_elements(chain, state, shaped_inputs(chain, inputs))
    return checks.finite(rate_of(chain, result, given, list(bodies(chain, state)), point), "momentum rate")


def rate_of(chain: ClosedChain, result: ForwardResult, given: Inputs, every: list[MovingBody], point: Array) -> Array:
    """Return `momentum_rate` for given bodies; the inputs are shaped and include the wrenches of springs."""
    *links, held = every
    on_trunk = 0 if chain.trunk is None else len(chain.trunk.bodies)
    assert given.object_wrench is not None
    rate = shift_wrench(held.origin - point, given.object_wrench)
    for (name, arm), f in zip(chain.arms.items(), result.base_wrench, strict=True):
        if name not in chain.mounts:
            rate = rate + shift_wrench(arm.base.p - point, f)
    if chain.trunk is not None and result.trunk_base_wrench is not None:  # zero for a floating base
        rate = rate + shift_wrench(chain.trunk.base.p - point, result.trunk_base_wrench)
    for some, wrenches in ((links[:on_trunk], given.trunk_link_wrenches), (links[on_trunk:], given.link_wrenches)):
        for body, f in () if wrenches is None else zip(some, wrenches, strict=True):
            rate = rate + shift_wrench(body.origin - point, f)
    for body in (*links, held):
        moment = cross(body.com - body.inertia.m * point, chain.gravity)
        rate = rate + concatenate([moment, body.inertia.m * chain.gravity])
    return rate


def _accounts(case: VariedCase) -> tuple[Array, ...]:
    chain, state, inputs = case.chain, case.state, case.inputs
    return (
        tip_rotations(case),
        total_kinetic_energy(chain, state, inputs),
        total_potential_energy(chain, state),
        total_momentum(chain, state, inputs, np.zeros(3)),
        total_mass_moment(chain, state),
    )


ACCOUNTS = Question(
    "accounts",
    _accounts,
    (
        Row("tip_R", of_arms(lambda *_: 9), "", "attitudes of the tips, by rows"),
        Row("kinetic", (), "J", "kinetic energy"),
        Row("potential", (), "J", "potential energy"),
        Row("momentum", (6,), "N m s, N s", "momentum about the world's origin, world axes"),
        Row("mass_moment", (4,), "kg, kg m", "mass, and first moment of mass about the world's origin"),
    ),
    "the energies and momenta of a state that a simulation's balances need",
    inputs=STATE,
    parameters=("gravity", *OBJECT, "base_R", "base_p", "base_twist"),
    depends_on=("links", "bushings"),
    shown=lambda chain: dict,
)
