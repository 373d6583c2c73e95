"""Projection of a state that nearly satisfies the grasps, by repeated iterations of `projection`."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.consistency import largest_position
from holdfast.dynamics.projection import (
    CLOSED_GAP,
    LEFT_OPEN,
    WIDEST_GAP,
    closer,
    hidden_gaps,
    position_mismatch,
    project_velocities,
)
from holdfast.dynamics.rank import constraint_pivots, may_mislead, rank_and_held_near
from holdfast.dynamics.tree.mechanism_projection import mechanism_project
from holdfast.errors import ClosureError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs

MOST_PROJECTIONS = 8


@np.errstate(all="ignore")  # what overflows is refused below
def project(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> tuple[State, ChainMotion]:
    """Return the state projected onto the position and velocity constraints, and the chain's motion there.

    A few Newton iterations correct the positions by the position rows (which do not include a soft finger's spin); then
    the velocities are corrected once. Both use the kinetic metric. O(n) + O(l) per iteration.

    Args:
        chain: the chain.
        state: a state that nearly satisfies the constraint, such as the end of an integrator's step.
        inputs: inputs of the chain, of which only the base motion matters.

    Returns:
        The state and the motion; for a chain with branches, loops, couplings or several objects that of its forest.

    Raises:
        ClosureError: the state is too far off, or the iteration does not converge.
        MethodNotApplicable: a base of a chain that is answered as a forest moves as prescribed.

    Reference:
        `docs/theory/simulation.md`.
    """
    if answered_as_forest(chain):
        return mechanism_project(chain, state, inputs)  # pyright: ignore[reportReturnType]
    require_fit(chain, state)
    given = shaped_inputs(chain, inputs)
    tau = np.zeros(chain.joint_count)
    motion = chain_motion(chain, state, tau, given)
    held, before, size, shown = None, np.inf, np.inf, np.inf
    for k in range(MOST_PROJECTIONS):
        gaps = position_mismatch(motion, state)
        shown = max((float(np.abs(gap).max()) for gap in gaps), default=0.0)
        size = max([shown, *map(float, hidden_gaps(motion, state))])
        if size <= CLOSED_GAP or size >= 0.5 * before:
            break
        if size > WIDEST_GAP:
            raise ClosureError(
                f"the grasps are open by {max(shown, largest_position(motion, state)):.3g} (m or rad), expected a"
                " step's rounding; try holdfast.close, or a smaller time step"
            )
        if k == 0:
            held = _rows_to_hold(chain, state, given, size)
        before = size
        state = closer(holding(motion, held, positions=True), state, gaps)
        motion = chain_motion(chain, state, tau, given)
    if size > LEFT_OPEN:
        raise ClosureError(
            f"the grasps stay open by {max(shown, largest_position(motion, state)):.3g} (m or rad): Newton's method"
            " does not close them; try a smaller time step"
        )
    state = project_velocities(holding(motion, held), state)
    return state, chain_motion(chain, state, tau, given)


def _rows_to_hold(chain: ClosedChain, state: State, inputs: Inputs, gap: float) -> Array | None:
    """Return the mask of rows to impose if a gap could make dependent rows look independent; None for all."""
    if not may_mislead(constraint_pivots(chain, state).condition, gap):
        return None
    return rank_and_held_near(chain, state, inputs)[1]
