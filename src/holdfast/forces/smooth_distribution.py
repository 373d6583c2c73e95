"""The distribution of forces at a barrier, which changes smoothly with the state: what machine code computes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.errors import MethodNotApplicable
from holdfast.forces.acceleration_map import AccelerationMap
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.elastic_distribution import ElasticDistribution, distributed, distribution_parameters
from holdfast.forces.limit_rows import Limit
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.programmes import Costs, Solved
from holdfast.forces.second_order_cone import cone_inverse
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.case import VariedCase
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

    Raises:
        MethodNotApplicable: it is asked what machine code is not.
    """
    given_way = cost is not None and cost.task is not None
    for wrong, what in (
        (task is not None, "task: expected None"),
        (given_way, "cost: task: expected None"),
        (form != "elastic", "form: expected 'elastic'"),
    ):
        if wrong:
            raise MethodNotApplicable(
                f"distribute: {what} with a barrier and for derivatives, which are those of an elastic programme that"
                " keeps all six directions of the acceleration"
            )
    asked = np.zeros(6) if acceleration is None else acceleration
    return {**distribution_parameters(chain, state, limits, cost), "acceleration": asked}


def smooth_solution(case: VariedCase, found: AccelerationMap, limits: Sequence[Limit], of: Costs) -> Solved:
    """Return the central point of the elastic programme as its solution; multipliers are mu s^-1.

    Args:
        case: the arguments.
        found: the map of all motions and forces.
        limits: the limits.
        of: the cost.
    """
    at, chain = ElasticDistribution(*distributed(case)), found.motion.chain
    lambdas = zip(chain.grasps, found.motion.contacts, strict=True)
    known = np.concatenate([at.qdd, *(c.K @ at.grasp_wrench[chain.names.index(name)] for name, c in lambdas)])
    own = np.r_[found.qdd, found.alpha.stop : len(found.v0)]  # the others follow from these
    v = found.v0 + found.N @ np.linalg.lstsq(found.N[own], known - found.v0[own])[0]
    size, extra = found.force, float(at.violation) / found.force
    parts = []
    for limit in limits:
        s = (limit.h - limit.G @ v) / (limit.weight * size)
        parts.append(float(case.own["barrier"]) * cone_inverse(s + extra * np.eye(len(s))[0]))
    left = of.Q @ v + of.r
    value = 0.5 * float(left @ left) + (float(case.own["price"]) + 0.5 * extra) * extra
    return Solved(Verdict.OPTIMAL, v, extra, value, parts, 0.0, float(at.residual))
