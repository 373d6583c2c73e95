"""Derivatives of a round that closes a forest (`forest_projection`), by the virtual power of the forest at rest.

With the gaps g(q, qd) as right-hand sides, K z = [0; -g] for z = (changes, impulses). A cotangent of the changes gives
K y = S_z^T z_bar and the gradient of z_bar . S - L for constant z and y, as for forward dynamics
(`forest_derivatives`). The rounds are differentiated as they are computed, since the derivative of the closed state
would differ by the order of the gaps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from holdfast.dynamics.tree.forest_gaps import position_gaps, velocity_gaps
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_projection import closing_sides
from holdfast.dynamics.tree.limb_power import LimbsInMotion
from holdfast.dynamics.tree.varied_forest import ForestArguments, position_rates
from holdfast.dynamics.tree.virtual_power import ForestUnknowns, carried, residual, unknowns_from, virtual_power
from holdfast.spatial.differentiation import gradient, linearised
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.symmetric import symmetric_part

POSITIONS_AND_RATES = ("q", "qd")


class ClosingPoint(NamedTuple):
    """A round at one state.

    Attributes:
        given: the forest's arguments, of which positions and rates matter.
        changes: per change, of positions and of rates, the unknowns of its equations.
        at_rest: returns the solution of K z = r.
    """

    given: ForestArguments
    changes: Sequence[ForestUnknowns]
    at_rest: Callable[[ForestMotion, ForestUnknowns], ForestUnknowns]

    def backward(self, cotangents: Sequence[Array], by: Sequence[str] = POSITIONS_AND_RATES) -> dict[str, Array]:
        """Return the gradients of sum(cotangent . change) by some arguments. O(bodies).

        Args:
            cotangents: of the changes of positions and of rates, (n_v,) each.
            by: q, in the coordinates of qd, qd, and numbers of bodies, as in `FOREST_ARGUMENTS`.
        """
        motion = self.given.motion({})

        def shown(still: ForestMotion, rates: Sequence[Array], x: Array) -> Scalar:
            return x @ concatenate([body.of_frame(own) for body, own in zip(still.bodies, rates, strict=True)])

        def virtual(z: ForestUnknowns, x: Array) -> ForestUnknowns:
            z_bar = gradient(lambda flat: shown(motion, unknowns_from(motion, flat).rates, x), z.flat)[0]
            return self.at_rest(motion, unknowns_from(motion, z_bar))

        pairs = [*zip(self.changes, cotangents, strict=True)]
        every = [virtual(*pair) for pair in pairs]

        def power(*numbers: Array) -> Scalar:
            found = zip(self._still(dict(zip(by, numbers, strict=True))), pairs, every, strict=True)
            return sum(
                shown(still, z.rates, x) - virtual_power(LimbsInMotion(still), z, carried(still, z.rates), y)
                for still, (z, x), y in found
            )

        found = dict(zip(by, gradient(power, *self.given.values(by).values()), strict=True))
        return found | {name: symmetric_part(x) for name, x in found.items() if name == "link_inertia"}

    def forward(self, along: Mapping[str, Array]) -> list[Array]:
        """Return the rates of the changes of positions and of rates, (n_v,) each. O(bodies).

        Args:
            along: rates of arguments by name, as in `backward`.
        """
        motion, values = self.given.motion({}), [*self.given.values([*along]).values()]
        along = {name: symmetric_part(x) if name == "link_inertia" else x for name, x in along.items()}

        def varied(numbers: Sequence[Array]) -> list[ForestMotion]:
            return self._still(dict(zip(along, numbers, strict=True)))

        def left(*numbers: Array) -> list[Array]:
            return [residual(still, z) for still, z in zip(varied(numbers), self.changes, strict=True)]

        moved = [
            self.at_rest(motion, unknowns_from(motion, -x)).flat
            for x in linearised(left, *values).rates(*along.values())
        ]

        def changes(*numbers: Array) -> list[Array]:
            found = zip(varied(numbers[len(moved) :]), numbers[: len(moved)], strict=True)
            return [
                concatenate(
                    [body.of_frame(x) for body, x in zip(still.bodies, unknowns_from(still, z).rates, strict=True)]
                )
                for still, z in found
            ]

        flat = [z.flat for z in self.changes]
        return linearised(changes, *flat, *values).rates(*moved, *along.values())

    def _still(self, numbers: Mapping[str, Array]) -> list[ForestMotion]:
        """Return the forest at rest with the right-hand sides of both changes, at some arguments."""
        q, qd, motion = self.given.q, numbers.get("qd", self.given.qd), self.given.motion(numbers)
        if "q" in numbers:
            q = q + position_rates(self.given.forest, q, numbers["q"])
        sides = closing_sides(motion, position_gaps(motion, q), velocity_gaps(motion, qd))
        return [motion.at_rest_with(*side) for side in sides]
