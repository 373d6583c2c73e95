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
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.grasp_kinds import GraspKind
from holdfast.questions.arrays import STATE, Row
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question, ResultPart, Show, arm_parts, of_arms
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, concatenate, each_of
from holdfast.spatial.spatial_vector import rotate
from holdfast.state import Inputs, State, require_fit, shaped_inputs

POSITION_TOLERANCE = 1e-6  # m and rad
VELOCITY_TOLERANCE = 1e-6  # relative to max(1, |qd|)
RATE_TOLERANCE = 1e-8  # rad/s, relative to max(1, |W|)


class GraspResidual(NamedTuple):
    """The constraint residuals of one grasp.

    Attributes:
        position: residuals of the position rows along contact axes: angles [rad] first, then lengths [m].
        velocity: (6 - n_g,) residuals of the velocity rows, K (A V(C) - V+) [rad/s, m/s].
    """

    position: Array
    velocity: Array


def tip_from_contact(c: Contact, contact_point: Array, tip: Pose) -> Pose:
    """Return the pose of the tip frame in the contact frame, which is the identity for a closed rigid grasp.

    If the grasp has a motion subspace of the user's own, the position is along the tip's axes, because the tip
    carries that subspace.

    Args:
        c: the grasp in motion.
        contact_point: (3,) contact point on the object in the world, world axes [m].
        tip: pose of the arm's tip frame in the world.
    """
    axes = c.R if c.grasp.of_kind.given is None else c.frame
    return Pose.unchecked(axes.T @ tip.R, (tip.p - contact_point) @ c.R)


def position_gap(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return the displacement [rotation vector; translation] that would close the grasp, (6,) world axes [rad, m].

    The rotation takes the tip frame to the contact frame for a rigid grasp. It is the smallest one between the
    x axes for a hinge, and zero for grasps that leave the attitude free.

    Args:
        c: the grasp in motion.
        contact_point: (3,) contact point on the object in the world, world axes [m].
        tip: pose of the arm's tip frame in the world.
    """
    seen = tip_from_contact(c, contact_point, tip)
    return rotate(c.R, c.grasp.of_kind.gap(seen.R, seen.p))


def position_residual(c: Contact, contact_point: Array, tip: Pose) -> Array:
    """Return the residuals of one grasp's position rows along contact axes: angles [rad], then lengths [m]."""
    kind, seen = c.grasp.of_kind, tip_from_contact(c, contact_point, tip)
    return kind.along(kind.gap(seen.R, seen.p))[list(kind.position_rows)]


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

    Args:
        chain: the chain.
        state: any state; it need not satisfy the grasps.
        inputs: base motion, if the bases move.

    Its derivatives are of all residuals in the order of the grasps, concatenated: position and velocity. A rotation
    vector has no derivative at half a turn; the derivative for the chosen axis is then returned.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain.
    """
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
