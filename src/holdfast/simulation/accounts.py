"""The balance quantities recorded at every sample: energies, momentum and its rate, and the wrist wrenches."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.function import Function
from holdfast.compiled.structure import Options
from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.energy import bodies, elastic_energy, rotor_energy
from holdfast.dynamics.momentum_balance import ACCOUNTS, rate_of
from holdfast.errors import StateError
from holdfast.forces.wrist import wrist_wrenches
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.instant import Instant
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench, twist_shift
from holdfast.spatial.vector import cross
from holdfast.state import Inputs

ACCOUNTS_WORTH_COMPILING = 250  # instants: compiling takes as long as evaluating about this many without machine code


class Accounts(NamedTuple):
    """The balance quantities at one instant, in world axes about the world's origin.

    Attributes:
        kinetic: kinetic energy [J].
        potential: potential energy, of gravity and of springs [J].
        momentum: (6,) [angular; linear] [N m s, N s].
        rate: (6,) [moment; force] that bases, weights and external wrenches exert together [N m, N].
        wrist: (arms, 6) wrenches at the wrists, see `wrist_wrenches`.
    """

    kinetic: float
    potential: float
    momentum: Array
    rate: Array
    wrist: Array


def accounts_of(at: Instant) -> Accounts:
    """Return the balance quantities at an instant. O(n)."""
    chain, state = at.chain, at.state
    given, every = with_force_elements(chain, state, at.inputs.shaped(chain)), list(bodies(chain, state, at.inputs))
    return Accounts(
        sum(body.kinetic_energy for body in every) + rotor_energy(chain, state),
        sum(body.potential_energy(chain.gravity) for body in every) + elastic_energy(chain, state),
        np.sum([body.momentum(np.zeros(3)) for body in every], axis=0),
        rate_of(chain, at.result, given, every, np.zeros(3)),
        wrist_wrenches(chain, state, at.result),
    )


class CompiledAccounts:
    """Computes the balance quantities of one chain with machine code.

    This is possible for chains whose bases stand still and on which external wrenches act at the object only.

    Attributes:
        chain: the chain.
    """

    def __init__(self, chain: ClosedChain) -> None:
        """Store the chain, which is compiled when the first instant is evaluated."""
        self.chain = chain
        self._given: tuple[Array, ...] = (np.zeros(0),) * 4
        self._found: dict[str, Array] = {}

    @staticmethod
    def suit(chain: ClosedChain, inputs: Inputs) -> bool:
        """Return whether this class can be used: no trunk, springs between bodies, moving bases or link wrenches."""
        plain = chain.trunk is None and not chain.springs and not chain.bushings
        still = inputs.base_twists is None or not inputs.base_twists.any()
        return plain and still and inputs.link_wrenches is None

    @cached_property
    def _function(self) -> Function:
        return Function(CompiledChain(self.chain, Options(), None), ACCOUNTS)

    @cached_property
    def _at_origin(self) -> Array:
        """The matrix (6, 6 arms) that adds the wrenches of the bases up, about the world's origin."""
        return np.concatenate([twist_shift(arm.base.p) for arm in self.chain.arms.values()]).T

    def _of_state(self, *given: Array) -> dict[str, Array]:
        """Return the quantities that depend on the state only, reused if the state is that of the previous call.

        The two samples at a jump have the same state.
        """
        if not all(map(np.array_equal, given, self._given)):
            self._found, self._given = self._function(*given), given
        return self._found

    def of(self, at: Instant) -> Accounts:
        """Return the balance quantities of the chain at an instant."""
        state, result = at.state, at.result
        try:
            x = self._of_state(state.q, state.qd, state.object_pose, state.object_twist)
        except StateError:  # a joint has turned further than machine code accepts
            return accounts_of(at)
        mass, moment, gravity = x["mass_moment"][0], x["mass_moment"][1:], self.chain.gravity
        rate = np.concatenate([cross(moment, gravity), mass * gravity]) + self._at_origin @ result.base_wrench.ravel()
        if at.inputs.object_wrench is not None:
            rate = rate + shift_wrench(state.object_pose[4:], at.inputs.object_wrench)
        wrist = np.einsum("aji,akj->aki", x["tip_R"].reshape(-1, 3, 3), result.grasp_wrench.reshape(-1, 2, 3))
        return Accounts(float(x["kinetic"]), float(x["potential"]), x["momentum"], rate, wrist.reshape(-1, 6))
