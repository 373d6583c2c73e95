"""Impulses when an arm grasps the object while the chain moves, and release of a grasp.

When a grasp closes, the relative velocity of tip and object along its transmitted directions becomes zero at once. The
impulses p act through all grasps, old and new (docs/theory/simulation.md):
    K Omega K^T p = K (V_tip - A V(C)),   dqd = -M^-1 J^T p,   dV(C) = M(C)^-1 A^T p
They change the kinetic energy by Delta T = sum_b V_b.j_b - 1/2 p^T K Omega K^T p, with the impulses j_b of the bases on
the arms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.dynamics.arm.motion import at_rest
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion
from holdfast.dynamics.closed.chain_solution import base_wrench
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.consistency import require_closed
from holdfast.dynamics.grasp_gap import POSITION_TOLERANCE, VELOCITY_TOLERANCE, position_residual
from holdfast.dynamics.projection import constraint_impulses, quickened
from holdfast.dynamics.rank import rank_and_held_near
from holdfast.dynamics.result import Status
from holdfast.dynamics.smallest_forces import with_smallest_forces
from holdfast.dynamics.tree.mechanism_impulse import MechanismAttachment, grasp_ends, mechanism_attach
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration
from holdfast.errors import ClosureError, ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.closure import Closure
from holdfast.model.grasp import Grasp
from holdfast.model.serial_chain import answered_as_forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State, require_fit, shaped_inputs


@called
@dataclass(frozen=True, eq=False)
class Attachment(Frozen):
    """The result of closing a grasp, in world axes.

    Attributes:
        chain: the chain with the new grasp.
        state: the state just after; the positions do not change.
        impulses: (arms, 6) [moment; force] impulse of each arm on the object about its contact point; zero for
            an arm without a grasp [N m s, N s].
        base_impulses: (arms, 6) impulse of the base on each arm about the base origin [N m s, N s].
        trunk_base_impulse: (6,) impulse of the base on a trunk about the base origin, 0 if it floats; None without a
            trunk.
        energy_change: change of the kinetic energy, which is not positive if the bases stand still [J].
        status: whether the impulses are unique. With INDETERMINATE_FORCES, they are the smallest ones in the metric of
            the force split. The velocities are always unique.
    """

    chain: ClosedChain
    state: State
    impulses: Array
    base_impulses: Array
    energy_change: float
    status: Status
    trunk_base_impulse: Array | None = None


@np.errstate(all="ignore")  # what overflows is refused below
def attach(
    chain: ClosedChain,
    state: State,
    name: str | tuple[str, str],
    grasp: Grasp | Closure,
    *,
    here: bool = False,
    inputs: Inputs | None = None,
    tolerance: float = POSITION_TOLERANCE,
) -> Attachment:
    """Return the chain and its velocities after an arm has grasped the object, or a loop has closed.

    The impulses are computed by the object's filter in O(n) + O(l). The check whether they are unique costs O(n l^2).

    Args:
        chain: the chain.
        state: positions and velocities before; they must satisfy the chain's grasps.
        name: an arm without a grasp, or (arm, frame) of a chain with branches; the name of a new loop.
        grasp: the grasp to close; a `Closure` for a loop, for example of an object onto another.
        here: move the grasp's frame to the tip, see `grasp_here`. Otherwise the tip must be at the frame.
        inputs: base motion, if the bases move.
        tolerance: largest accepted position gap of the new grasp [m and rad].

    Returns:
        An `Attachment`; for a chain with branches, loops, couplings or several objects a `MechanismAttachment`.

    Raises:
        ModelError: there is no such arm, or it already has a grasp; the chain has a loop of this name.
        StateError: a shape is wrong, or the state violates the grasps before.
        ClosureError: the tip is not at the grasp, the grasp cannot be moved to the tip, or no velocities satisfy all
            grasps with the given motion of the bases.
    """
    if answered_as_forest(chain) or not isinstance(name, str) or isinstance(grasp, Closure):
        found = forest_attach(chain, state, name, grasp, here=here, inputs=inputs, tolerance=tolerance)
        return found  # pyright: ignore[reportReturnType]
    require_fit(chain, state)
    given = shaped_inputs(chain, inputs)
    closed = chain.with_grasp(name, grasp)
    before = chain_motion(chain, state, np.zeros(chain.joint_count), given)
    require_closed(before, state)
    if here:
        closed = chain.with_grasp(name, grasp_here(grasp, state.object_frame, before.arms[name].at.tip, name))
    motion = chain_motion(closed, state, np.zeros(chain.joint_count), given)
    if not here:
        _require_there(motion, state, name, checks.number(tolerance, "tolerance", at_least=0.0))
    stopped = _stopped(motion, state, given)
    _require_velocities(stopped, given)
    return stopped


def forest_attach(
    chain: ClosedChain,
    state: State,
    name: str | tuple[str, str],
    grasp: Grasp | Closure,
    *,
    here: bool = False,
    inputs: Inputs | None = None,
    tolerance: float = POSITION_TOLERANCE,
) -> MechanismAttachment:
    """Return the result of `attach` by the forest of any chain."""
    checks.instance(chain, ClosedChain, "chain")
    closed = _with(chain, name, grasp)
    if here:
        closed = _with(chain, name, _moved_here(closed, state, name, grasp))
    limit = checks.number(tolerance, "tolerance", at_least=0.0)
    return mechanism_attach(chain, closed, state, name, limit, inputs)


def release(chain: ClosedChain, name: str | tuple[str, str]) -> ClosedChain:
    """Return the chain with one grasp or loop opened; there is no impulse, and all velocities stay the same. O(1).

    Args:
        chain: the chain.
        name: an arm with a grasp, or (arm, frame); one of the chain's own `loops`.

    Raises:
        ModelError: there is no such grasp or loop.
    """
    checks.instance(chain, ClosedChain, "chain")
    if isinstance(name, str) and name in chain.loops:
        return replace(chain, loops={key: loop for key, loop in chain.loops.items() if key != name})
    return chain.without_grasp(name)


def _with(chain: ClosedChain, name: str | tuple[str, str], grasp: Grasp | Closure) -> ClosedChain:
    """Return the chain with a further grasp or loop."""
    if not isinstance(grasp, Closure):
        return chain.with_grasp(name, grasp)
    checks.name(name, "loop: name")
    if name in chain.loops:
        raise ModelError(f"loop '{name}': expected a new name, since this loop is closed; try release first")
    return replace(chain, loops={**chain.loops, name: grasp})


def _moved_here(closed: ClosedChain, state: State, name: str | tuple[str, str], grasp: Grasp | Closure) -> Any:
    """Return a grasp or loop of a chain, closed as its ends stand; see `grasp_here`."""
    body, tip = grasp_ends(closed, state, name)
    if not isinstance(grasp, Closure):
        return grasp_here(grasp, body, tip, str(name))
    on_body = closed.as_forest.forest.closures[closed.as_forest.closures[name]].grasp.frame
    end = body @ on_body @ grasp.grasp.frame.inverse()  # the frame of b, in which that of the grasp is given
    return replace(grasp, grasp=grasp_here(grasp.grasp, end, tip, str(name)))


def grasp_here(grasp: Grasp, object_frame: Pose, tip: Pose, name: str = "") -> Grasp:
    """Return the grasp with its frame changed as little as possible, so that it is closed at the tip's pose.

    The contact point moves to the tip's origin. A rigid grasp gets the tip's axes. A hinge gets the tip's x axis, and a
    normal that is perpendicular to it and as close as possible to its own. A soft finger and a ball keep their axes,
    because the normal belongs to the object.

    Args:
        grasp: the grasp.
        object_frame: pose of the object in the world.
        tip: pose of the arm's tip frame in the world.
        name: name of the arm, for messages.

    Raises:
        ClosureError: the tip's x axis is parallel to the normal of a hinge.
    """
    seen = object_frame.inverse() @ tip
    R = grasp.of_kind.regrasped(grasp.frame.R, seen.R)
    if R is None:
        raise ClosureError(
            f"arm '{name}': cannot grip by a {grasp.kind} here: expected the tip's x axis along the object's surface,"
            " got it along the contact's normal; try turning the tip, or another grasp frame"
        )
    return replace(grasp, frame=Pose.unchecked(R, seen.p))


def _require_there(motion: ChainMotion, state: State, name: str, tolerance: float) -> None:
    """Refuse a tip that is not at its grasp; the message gives both gaps."""
    c = motion.contacts[list(motion.chain.grasps).index(name)]
    gap = position_residual(c, state.object_frame.p + c.origin, motion.arms[name].at.tip)
    angles = len(c.grasp.of_kind.closed_angles)
    shift, turn = float(np.linalg.norm(gap[angles:])), float(np.linalg.norm(gap[:angles]))
    if not max(shift, turn) <= tolerance:
        angle = f" and {turn:.3g} rad" if angles else ""
        raise ClosureError(
            f"arm '{name}': its tip is {shift:.3g} m{angle} away from the grasp, expected <= {tolerance:g}; try moving"
            " it there (holdfast.close), or here=True to grip where it is"
        )


def _stopped(motion: ChainMotion, state: State, given: Inputs) -> Attachment:
    """Return the chain after the impulses that make the velocities agree at every grasp."""
    chain = motion.chain
    rank, held = rank_and_held_near(chain, state, given)  # if the grasps are slightly open, all rows seem independent
    mismatch = [
        arm.tip_twist - shift_twist(c.offset, state.object_twist)
        for arm, c in zip(motion.holding, motion.contacts, strict=True)
    ]
    jump, found = constraint_impulses(motion, holding(motion, held).contacts, mismatch)
    status = Status.OK
    if rank < chain.constraint_row_count:
        status = Status.INDETERMINATE_FORCES
        found = with_smallest_forces(motion, Solution([], found, jump.object, rank=rank)).wrenches
    impulses, base = np.zeros((len(chain.arms), 6)), np.zeros((len(chain.arms), 6))
    for name, impulse in zip(chain.grasps, found, strict=True):
        impulses[chain.names.index(name)] = impulse
    trunk = motion.trunk.at_rest()
    betas = trunk.accelerations(TrunkAcceleration(jump.qd[trunk.joints], jump.base))
    for i, (name, arm) in enumerate(motion.arms.items()):
        own = jump.qd[chain.joints[name]]
        base[i] = newton_euler(at_rest(arm), own, impulses[i], trunk.under(name, betas))[1]
    assert given.base_twists is not None
    change = (given.base_twists * base).sum()  # V_b.j_b
    below = base_wrench(trunk, betas, dict(zip(chain.arms, base, strict=True)))
    if below is not None and given.trunk_base_twist is not None:
        change += given.trunk_base_twist @ below
    change -= 0.5 * sum(p @ v for p, v in zip(found, mismatch, strict=True))  # p^T K v = p^T K Omega K^T p
    return Attachment(chain, quickened(state, jump), impulses, base, float(change), status, below)


def _require_velocities(stopped: Attachment, given: Inputs) -> None:
    """Refuse a motion of the bases that no closed chain can follow."""
    chain, state = stopped.chain, stopped.state
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), given)
    left = max(float(np.abs(c.velocity_gap).max(initial=0.0)) for c in motion.contacts)
    limit = VELOCITY_TOLERANCE * max(1.0, float(np.linalg.norm(state.qd)))
    if not left <= limit:
        raise ClosureError(
            f"no velocities keep every grasp while the bases move as they do: a gap of {left:.3g} (m/s or rad/s) is"
            f" left, expected <= {limit:.3g}; try other base twists, or fewer grasps"
        )
