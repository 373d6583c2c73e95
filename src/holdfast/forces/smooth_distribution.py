"""The distribution of forces at a barrier, which changes smoothly with the state: what machine code computes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.dynamics.closed.chain_motion import pseudo_gravity
from holdfast.errors import MethodNotApplicable
from holdfast.forces.acceleration_map import asked_rows
from holdfast.forces.affine_map import AccelerationMap
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.elastic_distribution import (
    ElasticDistribution,
    dearer,
    distributed,
    distribution_parameters,
    raised_price,
)
from holdfast.forces.limit_rows import Limit
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.programmes import Costs, Solved
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.case import VariedCase
from holdfast.spatial.second_order_cone import cone_inverse
from holdfast.state import State


def smooth_parameters(
    chain: ClosedChain,
    state: State,
    acceleration: Any,
    *,
    task: Any,
    cost: ForceCost | None,
    limits: ForceLimits | None,
    form: str,
    **_: Any,
) -> dict[str, Any]:
    """Return the arrays of the question `distribute`, of the arguments of the function.

    Of a task S alpha = s, the acceleration is the smallest one with S a = s.

    Raises:
        MethodNotApplicable: it is asked what machine code is not.
    """
    if form != "elastic":
        raise MethodNotApplicable(
            "distribute: form: expected 'elastic' with a barrier and for derivatives: where limits that do not give way"
            " conflict, there is no point between them"
        )
    asked = np.zeros(6) if acceleration is None else np.asarray(acceleration)
    if task is not None and acceleration is not None:
        asked = np.linalg.pinv(asked_rows(task)) @ asked
    return {**distribution_parameters(chain, state, limits, cost, task), "acceleration": asked}


def smooth_solution(case: VariedCase, found: AccelerationMap, limits: Sequence[Limit], of: Costs) -> Solved:
    """Return the central point of the elastic programme as its solution; multipliers are mu s^-1.

    Args:
        case: the arguments.
        found: the map of all motions and forces.
        limits: the limits.
        of: the cost.
    """
    at, chain = ElasticDistribution(*distributed(case)), found.chain
    known = np.concatenate([at.qdd, *(one.contact.K @ at.grasp_wrench[one.row] for one in found.grasps)])
    own = np.r_[found.qdd, found.alpha.stop : len(found.v0)]  # the others follow from these
    price = raised_price(case.own, dearer(case.own, case.own["acceleration"] - pseudo_gravity(chain)))
    v = found.v0 + found.N @ np.linalg.lstsq(found.N[own], known - found.v0[own])[0]
    size, extra = found.force, float(at.violation) / found.force
    parts = []
    for limit in limits:
        s = (limit.h - limit.G @ v) / (limit.weight * size)
        parts.append(float(case.own["barrier"]) * cone_inverse(s + extra * np.eye(len(s))[0]))
    left = of.Q @ v + of.r
    value = 0.5 * float(left @ left) + (float(price) + 0.5 * extra) * extra
    return Solved(Verdict.OPTIMAL, v, extra, value, parts, 0.0, float(at.residual))
