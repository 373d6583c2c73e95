"""Back onto the constraint from a state that is a little off it; `projection` has the round that this repeats."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.projection import (
    CLOSED,
    FARTHEST,
    LEFT_OPEN,
    closer,
    position_mismatch,
    project_velocities,
)
from holdfast.dynamics.rank import constraint_pivots, may_mislead, rank_and_held_near
from holdfast.errors import ClosureError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs

ROUNDS = 8


@np.errstate(all="ignore")  # what overflows is refused below
def project(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> tuple[State, ChainMotion]:
    """Return the state moved back onto position and velocity constraints, and its motion there.

    Positions in a few Newton rounds on the position rows (a soft finger's spin is left
    alone), then velocities once, both in the kinetic metric. O(n) + O(l) a round.

    Args:
        chain: the chain.
        state: a state near the constraint, as an integrator's step leaves it.
        inputs: what acts on the chain besides torques; base motion enters.

    Raises:
        ClosureError: if the state is too far off, or does not come closer.

    Reference:
        `docs/theory/simulation.md`.
    """
    require_fit(chain, state)
    given = shaped_inputs(chain, inputs)
    tau = np.zeros(chain.joint_count)
    motion = chain_motion(chain, state, tau, given)
    held, before, size = None, np.inf, np.inf
    for k in range(ROUNDS):
        gaps = position_mismatch(motion, state)
        size = max((float(np.abs(gap).max()) for gap in gaps), default=0.0)
        if size <= CLOSED or size >= 0.5 * before:
            break
        if size > FARTHEST:
            raise ClosureError(
                f"the grasps are open by {size:.3g} (m or rad), expected a step's rounding; try a smaller time step"
            )
        if k == 0:
            held = _rows_to_hold(chain, state, given, size)
        before = size
        state = closer(holding(motion, held, positions=True), state, gaps)
        motion = chain_motion(chain, state, tau, given)
    if size > LEFT_OPEN:
        raise ClosureError(
            f"the grasps stay open by {size:.3g} (m or rad): Newton's method does not close them; try a smaller time"
            " step"
        )
    state = project_velocities(holding(motion, held), state)
    return state, chain_motion(chain, state, tau, given)


def _rows_to_hold(chain: ClosedChain, state: State, inputs: Inputs, gap: float) -> Array | None:
    """Return which components of the grasps to hold, where a gap makes rows look independent; None: all of them."""
    if not may_mislead(constraint_pivots(chain, state).condition, gap):
        return None
    return rank_and_held_near(chain, state, inputs)[1]
