"""Position and velocity residuals of the grasp constraints, grasp by grasp.

A grasp is closed in position if, for a rigid grasp, tip frame and contact frame coincide; for a hinge, their origins
and x axes coincide; for a soft finger or a ball, their origins coincide. The numbers of position and velocity rows
are rigid 6/6, hinge 5/5, soft finger 3/4 (its no-spin condition is nonholonomic) and ball 3/3. The other kinds are
in docs/theory/contacts.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, link_twists, tip_twist
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.contact import contact
from holdfast.dynamics.grasp_gap import POSITION_TOLERANCE, VELOCITY_TOLERANCE, position_residual
from holdfast.dynamics.tree.mechanism_projection import mechanism_residuals
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_kinds import GraspKind
from holdfast.model.serial_chain import answered_as_forest
from holdfast.questions.arrays import STATE, Row
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question, ResultPart, Show, arm_parts, of_arms
from holdfast.spatial.scalar import Array, concatenate, each_of
from holdfast.state import Inputs, State, require_fit, shaped_inputs

RATE_TOLERANCE = 1e-8  # rad/s, relative to max(1, |W|)


class GraspResidual(NamedTuple):
    """The constraint residuals of one grasp.

    Attributes:
        position: residuals of the position rows along contact axes: angles [rad] first, then lengths [m].
        velocity: (6 - n_g,) residuals of the velocity rows, K (A V(C) - V+) [rad/s, m/s].
    """

    position: Array
    velocity: Array


def residuals(motion: ChainMotion, state: State) -> dict[str, GraspResidual]:
    """Return the position and velocity residuals of every grasp, by arm name."""
    origin = state.object_frame.p
    return {
        name: GraspResidual(position_residual(c, origin + c.origin, motion.arms[name].at.tip), c.velocity_gap)
        for name, c in zip(motion.chain.grasps, motion.contacts, strict=True)
    }


def largest_position(motion: ChainMotion, state: State) -> float:
    """Return the largest position residual of any grasp, with angles instead of sines [m or rad]; 0 without grasps."""
    gaps = residuals(motion, state).values()
    return max((float(np.abs(gap.position).max(initial=0.0)) for gap in gaps), default=0.0)


@asked
@np.errstate(all="ignore")  # a gap may overflow
def closure(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> dict[str, GraspResidual]:
    """Return the constraint residuals of every grasp, by arm name. O(n) + O(l).

    Those of a chain with branches, loops, couplings or several objects are by the keys of its grasps and loops.

    Args:
        chain: the chain.
        state: any state; it need not satisfy the grasps.
        inputs: base motion, if the bases move.

    Its derivatives are of all residuals in the order of the grasps, concatenated: position and velocity. A rotation
    vector has no derivative at half a turn; the derivative for the chosen axis is then returned.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain.
    """
    if answered_as_forest(chain):
        found = {key: GraspResidual(*gap) for key, gap in mechanism_residuals(chain, state, inputs).items()}
    else:
        require_fit(chain, state)
        found = residuals_at(chain, state, shaped_inputs(chain, inputs))
    for gap in found.values():
        checks.finite(np.append(gap.position, gap.velocity), "closure")
    return found


def residuals_at(chain: ClosedChain, state: State, inputs: Inputs) -> dict[str, GraspResidual]:
    """Return the residuals of every grasp for shaped inputs; the numbers may carry derivatives. See `closure`."""
    bases, frame = base_kinematics(chain, state, inputs), state.object_frame

    def of_grasp(grasp: Grasp, arm: Arm, base_twist: Array, q: Array, qd: Array) -> GraspResidual:
        at = forward_kinematics(arm, q)
        moving = tip_twist(arm, at, link_twists(arm, at, qd, base_twist), base_twist)
        c = contact(grasp, frame, state.object_twist, at.tip, moving)
        return GraspResidual(position_residual(c, frame.p + c.origin, at.tip), c.velocity_gap)

    return each_of(chain.grasps, of_grasp, chain.grasps, bases.arms, bases.base_twists, bases.q, bases.qd)


def require_closed(motion: ChainMotion, state: State) -> None:
    """Refuse a state that does not satisfy the grasps.

    Raises:
        StateError: if a residual exceeds its tolerance; the message lists every such grasp.
    """
    limit = VELOCITY_TOLERANCE * max(1.0, float(np.linalg.norm(state.qd)))
    open_grasps = []
    for name, gap in residuals(motion, state).items():
        x, v = (float(np.abs(part).max(initial=0.0)) for part in gap)  # a bushing has no constraint rows
        if not (x <= POSITION_TOLERANCE and v <= limit):
            open_grasps.append(f"arm '{name}': position gap {x:.3g} (m, rad), velocity gap {v:.3g} (m/s, rad/s)")
    if open_grasps:
        raise StateError(
            f"the state does not satisfy the grasps: {'; '.join(open_grasps)}. Expected <= {POSITION_TOLERANCE:g} and"
            f" <= {limit:.3g}; try holdfast.close(chain, state)"
        )


def require_rates(motion: ChainMotion, rates: Array) -> None:
    """Refuse relative velocities W of the grasps that contradict the velocities of the tips and of the object.

    Raises:
        StateError: if they disagree; the message lists the difference at every such grasp.
    """
    gaps = []
    for (name, part), c in zip(motion.chain.contact_freedoms.items(), motion.contacts, strict=True):
        gap = float(np.abs(rates[part] - c.W).max(initial=0.0))
        if not gap <= RATE_TOLERANCE * max(1.0, float(np.abs(c.W).max(initial=0.0))):
            gaps.append(f"arm '{name}': gap {gap:.3g} rad/s")
    if gaps:
        raise StateError(
            f"W is not what the velocities imply, omega_object - omega_tip = h W: {'; '.join(gaps)}. Expected <="
            f" {RATE_TOLERANCE:g}; try leaving W out"
        )


def _closure(case: VariedCase) -> tuple[Array, Array]:
    gaps, none = residuals_at(case.chain, case.state, case.inputs).values(), np.zeros(0)
    return concatenate([none, *(gap.position for gap in gaps)]), concatenate([none, *(gap.velocity for gap in gaps)])


def _rows(result: str) -> Callable[[int, GraspKind | None], int]:
    """Return the number of an arm's rows of a residual, `position` or `velocity`, by the kind of its grasp."""
    return lambda _, kind: 0 if kind is None else len(kind.position_rows if result == "position" else kind.transmitted)


def _by_grasps(chain: ClosedChain, result: str) -> list[ResultPart]:
    entries = arm_parts(chain, _rows(result))
    return [ResultPart(entries[name], chain.names.index(name)) for name in chain.grasps]


def _residuals(chain: ClosedChain) -> Show:
    """Return what shows the residuals of every grasp, by arm name, of those of all grasps, (..., rows) each."""
    parts = [[part.entries for part in _by_grasps(chain, result)] for result in GraspResidual._fields]
    rows = list(zip(chain.grasps, *parts, strict=True))

    def shown(found: Mapping[str, Array]) -> dict[str, GraspResidual]:
        x, v = found["position"], found["velocity"]
        return {name: GraspResidual(x[..., of_x], v[..., of_v]) for name, of_x, of_v in rows}

    return shown


CLOSURE = declare(
    Question(
        "closure",
        _closure,
        (
            Row("position", of_arms(_rows("position")), "rad, m", "position residuals of all grasps"
                " along contact axes, angles first"),
            Row("velocity", of_arms(_rows("velocity")), "rad/s, m/s", "velocity residuals of all"
                " grasps, K (A V(C) - V+)"),
        ),
        "the constraint residuals of every grasp",
        inputs=STATE,
        parameters=("base_R", "base_p", "base_twist", "grasp_R", "grasp_p"),
        arguments=(
            *("q", "object_pose", "qd", "object_twist"),
            *("grasp_pose", "base_pose", "base_twist", "floating_pose", "floating_twist", "trunk_base_twist"),
        ),
        by=("q", "object_pose", "qd", "object_twist"),
        depends_on=("grasps",),
        parts=_by_grasps,
        of_object=True,
        returns="dict[str, GraspResidual]",
        shown=_residuals,
    ),
    closure,
)  # fmt: skip
