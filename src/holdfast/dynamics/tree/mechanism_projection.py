"""The residuals of a chain that is answered as a forest, and its return to closed states."""

from __future__ import annotations

from functools import partial
from typing import Any

from holdfast.dynamics.tree.forest_closing import FOREST_CLOSED
from holdfast.dynamics.tree.forest_gaps import position_gaps, velocity_gaps
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_projection import closing_round, closing_rounds
from holdfast.dynamics.tree.mechanism_terms import chain_state, mechanism_arguments
from holdfast.errors import ClosureError, MethodNotApplicable
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

WIDEST_MECHANISM_GAP = 0.1  # m and rad: wider ones are no rounding of a step


def mechanism_residuals(chain: ClosedChain, state: State, inputs: Inputs | None) -> dict[Any, tuple[Array, Array]]:
    """Return the residuals of every grasp and loop in position and velocity, by their keys. O(bodies)."""
    given = mechanism_arguments(chain, state, inputs=inputs)
    motion = given.motion({})
    pairs = zip(position_gaps(motion, given.q).closures, velocity_gaps(motion, given.qd).closures, strict=True)
    return dict(zip(chain.as_forest.closures, pairs, strict=True))


def mechanism_project(chain: ClosedChain, state: State, inputs: Inputs | None) -> tuple[State, ForestMotion]:
    """Return the state closed by the smallest changes in the kinetic metric, and the motion of its forest.

    Raises:
        ClosureError: the state is too far off, or the rounds do not close it.
        MethodNotApplicable: a base moves as prescribed.
    """
    given = mechanism_arguments(chain, state, inputs=inputs)
    if given.under or given.behind:
        raise MethodNotApplicable("project: expected bases that stand still, for a chain that is answered as a forest")
    rounds = closing_rounds(partial(closing_round, given.forest), given.q, given.qd)
    now = next(rounds)
    if not now.position_gap <= WIDEST_MECHANISM_GAP:
        raise ClosureError(
            f"grasps, loops and couplings are open by {now.position_gap:.3g} (m or rad), expected a step's rounding;"
            " try holdfast.close, or a smaller time step"
        )
    now = [now, *rounds][-1]
    if not now.position_gap <= FOREST_CLOSED:
        raise ClosureError(
            f"grasps, loops and couplings stay open by {now.position_gap:.3g} (m or rad): try holdfast.close, or a"
            " smaller time step"
        )
    return chain_state(chain, now.q, now.qd), given._replace(q=now.q, qd=now.qd).motion({})
