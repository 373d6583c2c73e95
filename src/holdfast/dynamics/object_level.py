"""The mobility and the inertia of the closed chain at the held object."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.closed.object_motion import object_motion
from holdfast.dynamics.closed.sequential import rest_response
from holdfast.dynamics.constraint import constraint_rows
from holdfast.errors import SingularChainError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import OBJECT, Row
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import declare
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit

IMMOBILE = 1e-9  # mobilities below this, relative to the largest scaled one, count as zero


@np.errstate(all="ignore")  # what overflows is refused
def object_mobility(chain: ClosedChain, state: State) -> Array:
    """Return the closed chain's mobility at C, (6, 6), world axes: the filter's final P.

    An additional wrench w on the object changes its acceleration by P w. P is M(C)^-1 reduced by the inertia of all
    arms; it is zero along directions in which the arms cannot move the object. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions; velocities are ignored.

    Raises:
        StateError: a state of the wrong shape for the chain.

    Reference:
        `docs/theory/sequential_filter.md`.
    """
    require_fit(chain, state)
    return checks.finite(rest_response(chain_at_rest(chain, state)).mobility, "object mobility")


def object_inertia(chain: ClosedChain, state: State) -> Array:
    """Return the object's operational inertia in the closed chain, (6, 6): P^-1, about C.

    It is M(C) + sum A_i^T K_i^T (K_i Lambda_i K_i^T)^-1 K_i A_i if every Lambda_i is regular. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions; velocities are ignored.

    Raises:
        StateError: a state of the wrong shape for the chain.
        SingularChainError: the object cannot move in some direction.
    """
    P = object_mobility(chain, state)
    alone = object_motion(chain.held_object, state.object_frame, np.zeros(6), np.zeros(6))
    own = np.sqrt(np.diag(alone.mobility.dense()))
    sizes = np.linalg.eigvalsh(P / np.outer(own, own))
    stuck = int((sizes <= IMMOBILE * max(float(sizes[-1]), 1e-300)).sum())
    if stuck:
        raise SingularChainError(
            f"the object cannot move along {stuck} of 6 directions, so its inertia there is infinite; try"
            " object_mobility, which stays finite"
        )
    return np.linalg.inv(P)


def motion_basis(chain: ClosedChain, state: State) -> Array:
    """Return an orthonormal basis of the velocities (qd, V(C)) that the grasps allow. O(n^3).

    Args:
        chain: the chain.
        state: positions; velocities are ignored.

    Returns:
        (n + 6, mobility) matrix whose columns span the null space of K [J, -A]; the relative rates W follow from them.
        With a floating base it is (n + 12, mobility), with the twist of the base last.

    Raises:
        StateError: a state of the wrong shape for the chain.
    """
    require_fit(chain, state)
    return constraint_rows(chain_at_rest(chain, state)).motions


def _mobility(case: VariedCase) -> tuple[Array]:
    return (rest_response(chain_at_rest(case.chain, case.state)).mobility,)


OBJECT_MOBILITY = declare(
    Question(
        "object_mobility",
        _mobility,
        (Row("object_mobility", (6, 6), "", "mobility P at C, world axes: alpha(C) changes by P w"),),
        "the closed chain's mobility at C",
        inputs=("q", "object_pose"),
        parameters=(*OBJECT, "base_R", "base_p", "grasp_R", "grasp_p"),
        depends_on=("grasps", "links"),
    )
)
