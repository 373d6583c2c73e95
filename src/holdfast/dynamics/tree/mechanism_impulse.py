"""Impulses when a grasp closes in a chain that is answered as a forest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.dynamics.grasp_gap import VELOCITY_TOLERANCE
from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_closing import impulse_of
from holdfast.dynamics.tree.forest_gaps import position_gaps, require_closed, velocity_gaps
from holdfast.dynamics.tree.mechanism_terms import chain_results, chain_state, mechanism_arguments
from holdfast.errors import ClosureError
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, FrozenDict, frozen_property
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@called
@dataclass(frozen=True, eq=False)
class MechanismAttachment(Frozen):
    """The result of closing a grasp of a chain with branches, loops, couplings or several objects, in world axes.

    Attributes:
        chain: the chain with the new grasp.
        state: the state just after; the positions do not change.
        impulses: (grasps and loops, 6) [moment; force] impulses about the contact points; see
            `MechanismResult.grasp_wrench` [N m s, N s].
        coupling_impulses: (couplings,) a coupling acts on each of its joints with c times this.
        energy_change: change of the kinetic energy, which is not positive if the bases stand still [J].
        status: whether the impulses are unique; if not, they are the smallest. Velocities are always unique.
    """

    chain: ClosedChain
    state: State
    impulses: Array
    coupling_impulses: Array
    energy_change: float
    status: Status

    @frozen_property
    def by_grasp(self) -> Mapping[Any, Array]:
        """The rows of `impulses` by the keys of the chain's grasps and loops."""
        return FrozenDict({key: self.impulses[i] for key, i in self.chain.as_forest.closures.items()})


def grasp_ends(chain: ClosedChain, state: State, key: Any) -> tuple[Pose, Pose]:
    """Return the poses in the world of the object and of the tip that a grasp closes."""
    given, i = mechanism_arguments(chain, state), chain.as_forest.closures[key]
    motion = given.motion({})
    return motion.bodies[given.forest.closures[i].b].at.frame, motion.closures[i].tip


@np.errstate(all="ignore")  # what overflows is refused
def mechanism_attach(
    chain: ClosedChain, closed: ClosedChain, state: State, key: Any, tolerance: float, inputs: Inputs | None
) -> MechanismAttachment:
    """Return velocities after a grasp has closed; see `attach` for errors. O(n).

    Args:
        chain: the chain before.
        closed: the chain with the new grasp.
        state: positions and velocities before.
        key: the new grasp's.
        tolerance: its largest accepted position gap [m and rad].
        inputs: base motion, if the bases move.
    """
    before = mechanism_arguments(chain, state, inputs=inputs)
    require_closed(before.motion({}), before.q, before.qd)
    given, found = mechanism_arguments(closed, state, inputs=inputs), closed.as_forest
    apart = float(np.abs(position_gaps(given.motion({}), given.q).closures[found.closures[key]]).max(initial=0.0))
    if not apart <= tolerance:
        raise ClosureError(
            f"grasp {key!r}: {apart:.3g} m or rad away, expected <= {tolerance:g}; try moving it there"
            " (holdfast.close), or here=True to grip where it is"
        )
    stopped = impulse_of(given)
    after = given._replace(qd=stopped.qd)
    left = velocity_gaps(after.motion({}), after.qd).largest
    limit = VELOCITY_TOLERANCE * max(1.0, float(np.linalg.norm(state.qd)))
    if not left <= limit:
        raise ClosureError(
            f"no velocities keep every grasp while the bases move as they do: a gap of {left:.3g} (m/s or rad/s) is"
            f" left, expected <= {limit:.3g}; try other base twists, or fewer grasps"
        )
    impulses = {"closure_wrench": stopped.closure_impulse, "coupling_force": stopped.coupling_impulse}
    places = chain_results(closed)
    return MechanismAttachment(
        closed,
        chain_state(closed, after.q, after.qd),
        places["grasp_wrench"].of(impulses),
        places["coupling_force"].of(impulses),
        stopped.energy_change,
        stopped.status,
    )
