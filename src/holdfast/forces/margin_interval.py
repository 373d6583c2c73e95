"""The range of the grasp margins for given torques, if the grasp forces are not unique.

Forces without effect on the joints and the object can be added: f + N z with unknown z, which depends on how the parts
were assembled. A margin is concave in z, so a margin that depends on z has no lower bound. Internal forces that load a
joint are not included, because they need other torques (`largest_margin`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.indeterminate import free_wrenches
from holdfast.dynamics.result import ForwardResult, Status, require_result_of
from holdfast.forces.cone_program import AffineMargin, largest_least, sensitive_directions
from holdfast.forces.margins import conditions, grasp_margins
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate
from holdfast.state import State, require_fit


class MarginRange(NamedTuple):
    """The range of margins over the internal forces that load no joint, in the order of `chain.grasps` [N].

    Attributes:
        worst: (grasps,) the smallest margin of each grasp; minus infinity if internal forces change it.
        best: (grasps,) the largest margin of each grasp alone; infinite if squeezing harder always increases it.
        together: the largest possible value of the least margin. If it is negative, no internal force holds all grasps
            with the given torques; other torques may, see `largest_margin`.
    """

    worst: Array
    best: Array
    together: float


def margin_range(chain: ClosedChain, state: State, result: ForwardResult) -> MarginRange:
    """Return the worst and best grasp margins over all grasp forces that are possible with the result's torques.

    Only forces without effect on joints and object vary. If the forces are unique, both results are `grasp_margins`.
    `largest_margin` gives the largest margin over other torques for the same motion. The best values are accurate to
    about 1e-9 of the forces and limits. The cost is one cone program per grasp, O(l^3) per iteration.

    Args:
        chain: the chain.
        state: a closed state.
        result: forward dynamics at that state.

    Raises:
        StateError: the result belongs to another chain, or contains no forces.
    """
    require_fit(chain, state)
    require_result_of(chain, result)
    now = grasp_margins(chain, state, result.grasp_wrench)
    if result.status is not Status.INDETERMINATE_FORCES:
        return MarginRange(now, now, float(now.min(initial=math.inf)))
    motion = chain_at_rest(chain, state)
    N = free_wrenches(motion, length_scale([c.offset for c in motion.contacts]), int(result.rank))
    affine = affine_margins(motion, result.grasp_wrench, N)
    touched = np.array([bool(of_one) and sensitive_directions(of_one).shape[1] > 0 for of_one in affine])
    best = [largest_least(of_one) if free else value for of_one, free, value in zip(affine, touched, now, strict=True)]
    every = [margin for of_one in affine for margin in of_one]
    return MarginRange(
        np.where(touched, -math.inf, now), np.array(best), largest_least(every) if touched.any() else float(now.min())
    )


def affine_margins(motion: ChainMotion, grasp_wrench: Array, N: Array) -> list[list[AffineMargin]]:
    """Return for each grasp its conditions as functions of z, without those that always hold.

    Args:
        motion: the chain's motion.
        grasp_wrench: (arms, 6) wrenches at z = 0, about the contacts, world axes.
        N: (6l, k) stacked wrenches of the grasps, one column per entry of z.
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
