"""Which margins the grasps can have where their forces are not unique, at the torques of a result.

Grasp forces that no joint and no object motion feels are f + N z, z unknown: what they are depends on
how the parts were put together. A margin is concave in z, so one that z changes at all has no lower bound.
Internal forces that load a joint are not among them, because they would need other torques (`largest_margin`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.indeterminate import free_wrenches
from holdfast.dynamics.result import ForwardResult, Status, require_result_of
from holdfast.forces.cone_program import AffineMargin, felt_directions, largest_least
from holdfast.forces.margins import conditions, grasp_margins
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import State, require_fit


class MarginRange(NamedTuple):
    """The margins that internal forces which load no joint allow, in the order of `chain.grasps` [N].

    Attributes:
        worst: (grasps,) the smallest of each; minus infinity where internal forces change it at all.
        best: (grasps,) the largest of each, the others left to themselves; infinite where squeezing harder
            always helps.
        together: the largest that the smallest of all can be: below 0 the given torques hold the grasps by no
            internal force. Other torques may; see `largest_margin`.
    """

    worst: Array
    best: Array
    together: float


def margin_range(chain: ClosedChain, state: State, result: ForwardResult) -> MarginRange:
    """Return worst and best grasp margins over all grasp forces that the result's torques leave open.

    Only combinations of forces that load no joint and move nothing vary. Where the forces are unique
    there are none, and both are `grasp_margins`. The largest margin that other torques can give for the
    same motion is `largest_margin`. Best values are good to about 1e-9 of the forces and limits. A
    cone program a grasp: O(l^3) an iteration.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state.

    Raises:
        StateError: a result of another chain, or one without forces.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    now = grasp_margins(chain, state, result.grasp_wrench)
    if result.status is not Status.INDETERMINATE_FORCES:
        return MarginRange(now, now, float(now.min(initial=math.inf)))
    motion = chain_at_rest(chain, state)
    N = free_wrenches(motion, length_scale([c.offset for c in motion.contacts]), int(result.rank))
    affine = affine_margins(motion, result.grasp_wrench, N)
    touched = np.array([bool(of_one) and felt_directions(of_one).shape[1] > 0 for of_one in affine])
    best = [largest_least(of_one) if free else value for of_one, free, value in zip(affine, touched, now, strict=True)]
    every = [margin for of_one in affine for margin in of_one]
    return MarginRange(
        np.where(touched, -math.inf, now), np.array(best), largest_least(every) if touched.any() else float(now.min())
    )


def affine_margins(motion: ChainMotion, grasp_wrench: Array, N: Array) -> list[list[AffineMargin]]:
    """Return per grasp its conditions as functions of z, those that always hold left out.

    Args:
        motion: the chain.
        grasp_wrench: (arms, 6) at z = 0, about the contacts, world axes.
        N: (6l, k) stacked wrenches of the grasps, one column for each entry of z.
    """
    chain, count = motion.chain, len(motion.contacts)
    found = []
    for name, c, free in zip(chain.grasps, motion.contacts, N.reshape(count, 6, N.shape[1]), strict=True):
        f = unrotate(c.R, grasp_wrench[chain.names.index(name)])
        along = np.array([unrotate(c.R, column) for column in free.T]).reshape(-1, 6).T  # contact axes
        found.append(
            [
                AffineMargin(k.constant + k.pressing @ f, k.pressing @ along, k.loading @ f, k.loading @ along)
                for k in conditions(c.grasp)
                if math.isfinite(k.constant)
            ]
        )
    return found
