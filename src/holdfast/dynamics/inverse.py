"""Inverse dynamics of a closed chain: torques for given accelerations and grasp forces, if these are feasible."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.tree.mechanism_inverse import mechanism_torques
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest
from holdfast.questions.arrays import ARGUMENTS, FLOATING_RESULT, TRUNK_BASE_MOTION, TRUNK_LINKS
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question, by_joints
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each, maximum
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import Inputs, State, require_fit, shaped_inputs

SAME_WRENCH = 1e-9  # largest relative difference between a given wrench and the one that a bushing exerts

NO_BASE_WRENCH = 1e-8  # a wrench on the floating base below this, relative to the largest one, is rounding


class TrunkTorques(NamedTuple):
    """The torques and the base wrench for given accelerations.

    Attributes:
        tau: (n,) torques of the drives of trunk and arms.
        base: (6,) wrench on the first body, about the base origin, which must be zero for a floating base.
        largest: the largest entry of any wrench on a body of the trunk.
    """

    tau: Array
    base: Array
    largest: Scalar


@asked
@np.errstate(all="ignore")  # what overflows is refused below
def inverse_dynamics(
    chain: ClosedChain,
    state: State,
    qdd: ArrayLike,
    grasp_wrench: ArrayLike | None = None,
    inputs: Inputs | None = None,
    base_acceleration: ArrayLike | None = None,
    *,
    object_acceleration: ArrayLike | None = None,
) -> Array:
    """Return tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), arm by arm (2.1a). O(n).

    The caller must provide accelerations that satisfy the grasps, and wrenches that move the object accordingly;
    `forward_dynamics` with the returned torques then reproduces them.

    For a chain with branches, loops, couplings or several objects, the wrenches are those closest to the given ones
    that carry objects and passive joints, so that none need be given. O(n^3).

    Args:
        chain: the chain.
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) wrench of each arm on the object, about the contact, world axes. Rows of arms without a
            grasp must be zero; rows of bushings must be the wrenches that these exert, or zero, which stands for them.
            Of a chain with branches, a row for each grasp and then for each loop; zeros by default.
        inputs: external wrenches and base motion.
        base_acceleration: (6,) true acceleration of a trunk's floating base, world axes; required if there is one.
        object_acceleration: (6,) true acceleration of the object, or (k, 6) of several, of a chain with branches.

    Returns:
        (n,) joint torques [N m or N]; for a chain with branches, loops, couplings or several objects
        `MechanismTorques`, which has them beside the forces of grasps, loops and couplings.

    Raises:
        StateError: a shape is wrong, a wrench is given for an arm without a grasp, a wrench differs from that of a
            bushing, a floating base would need a drive, or nothing can carry an object or a passive joint.
    """
    if answered_as_forest(chain):
        of_base = acceleration_of_base(chain, base_acceleration)
        found = mechanism_torques(chain, state, qdd, grasp_wrench, inputs, of_base, object_acceleration)
        return found  # pyright: ignore[reportReturnType]
    require_fit(chain, state)
    if object_acceleration is not None:
        raise StateError("object_acceleration: expected none, as that of the object follows from grasp_wrench")
    qdd = checks.numbers(qdd, (chain.joint_count,), "qdd", StateError)
    f = checks.numbers(grasp_wrench, (len(chain.arms), 6), "grasp_wrench", StateError)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), shaped_inputs(chain, inputs))
    require_holding(chain, {"grasp_wrench": f})
    tau, *others = torques_and_deciding(motion, qdd, f, acceleration_of_base(chain, base_acceleration))
    require_feasible(chain, f, dict(zip(feasibility(chain), others, strict=True)))
    return checks.finite(tau, "inverse dynamics")


def acceleration_of_base(chain: ClosedChain, given: ArrayLike | None) -> Array | None:
    """Return the checked acceleration of a chain's floating base, (6,); None without one.

    Raises:
        StateError: the acceleration is missing, or is given although no base floats.
    """
    if chain.floats != (given is not None):
        wanted = "the acceleration of the floating base" if chain.floats else "none, as no base floats"
        raise StateError(f"base_acceleration: expected {wanted}, got {checks.short(given)}")
    return None if given is None else checks.numbers(given, (6,), "base_acceleration", StateError)


def torques_and_deciding(motion: ChainMotion, qdd: Array, f: Array, base: Array | None) -> tuple[Array, ...]:
    """Return the torques of inverse dynamics, (n,), and then the arrays of `feasibility`.

    The wrenches of bushings are already part of the arms' bias, so their rows in f, (arms, 6), are not used.
    """
    exerted = [arm.known for arm in motion.arms.values()]
    known = [x for x in exerted if x is not None]
    left = array([row if x is None else np.zeros(6) for row, x in zip(f, exerted, strict=True)]) if known else f
    of_bushings = [array([np.zeros(6) if x is None else x for x in exerted])] if known else []
    if motion.trunk.floats:
        return *trunk_torques(motion, qdd, left, base), *of_bushings
    return torques(motion, qdd, left), *of_bushings


def trunk_torques(motion: ChainMotion, qdd: Array, f: Array, base: Array | None = None) -> TrunkTorques:
    """Return the drives' torques of trunk and arms, and the wrench on the base, by Newton-Euler recursions. O(n).

    Args:
        motion: the chain's motion with zero drive torques.
        qdd: (n,) joint accelerations.
        f: (arms, 6) wrench of each arm on the object, about the contact, world axes.
        base: (6,) true acceleration of a floating base; None without one.
    """
    trunk, own = motion.trunk, qdd[motion.trunk.joints]
    betas = trunk.accelerations(TrunkAcceleration(own, base))
    found = each(
        drive_torques,
        motion.arms.values(),
        [qdd[part] for part in motion.chain.arm_joints],
        f,
        [trunk.under(name, betas) for name in motion.arms],
    )
    bases = {name: wrench for name, (_, wrench) in zip(motion.arms, found, strict=True)}
    torques, under, largest = [], np.zeros(6), np.zeros(())[()]
    for k, loads, total in trunk.loads(betas, bases):
        body = trunk.bodies[k]
        largest = reduce(maximum, (abs(entry) for load in (total, *loads) for entry in load), largest)
        if body.H is not None and body.joint is not None:
            rotor = body.joint.armature * own[k - trunk.floats]
            torques.insert(0, body.H @ total + rotor - body.torque)  # body.torque is minus the passive torque
        under = shift_wrench(body.reach, total)
    return TrunkTorques(concatenate([torques, *(of_arm for of_arm, _ in found)]), under, largest)


def torques(motion: ChainMotion, qdd: Array, f: Array, base: Array | None = None) -> Array:
    """Return the torques of the drives of trunk and arms, (n,), for grasp wrenches from which bushings are excluded.

    A floating base has the acceleration `base`, (6,), or zero; the wrench that this requires is ignored. See
    `inverse_dynamics`.
    """
    return trunk_torques(motion, qdd, f, np.zeros(6) if base is None and motion.trunk.floats else base).tau


def _torques(case: VariedCase) -> tuple[Array, ...]:
    """Return tau and the arrays of `feasibility`."""
    motion = chain_motion(case.chain, case.state, np.zeros(case.chain.joint_count), case.inputs)
    return torques_and_deciding(motion, case.own["qdd"], case.own["grasp_wrench"], case.own.get(FLOATING_RESULT))


def _with_held(case: VariedCase) -> VariedCase:
    """Return the case with zero wrenches for arms without a grasp."""
    rows = zip(case.chain.arms, case.own["grasp_wrench"], strict=True)
    f = array([row if name in case.chain.grasps else np.zeros(6) for name, row in rows])
    return case._replace(own={**case.own, "grasp_wrench": f})


def feasibility(chain: ClosedChain) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of the numbers that show whether wrenches and accelerations are feasible.

    They are the wrench that a floating base would need, and beside it the largest wrench on the trunk; and the wrench
    that every bushing exerts on the object, with zeros for other grasps.
    """
    of_base: dict[str, tuple[int, ...]] = {"trunk_base_wrench": (6,), "largest_wrench": ()} if chain.floats else {}
    return of_base | ({"bushing_wrench": (len(chain.arms), 6)} if chain.bushings else {})


def differ(chain: ClosedChain, f: Array, exerted: Array) -> dict[str, Array]:
    """Return by arm whether the wrench given for its bushing is neither zero nor the one that it exerts, (...).

    Args:
        chain: the chain.
        f: (..., arms, 6) given wrenches.
        exerted: (..., arms, 6) exerted wrenches.
    """
    with np.errstate(invalid="ignore"):  # a batch may contain systems that are refused for other reasons
        off, size = (np.abs(x).max(-1) for x in (f - exerted, exerted))
        different = (f != 0.0).any(-1) & (off > SAME_WRENCH * np.maximum(1.0, size))
    return {name: different[..., chain.names.index(name)] for name in chain.bushings}


def require_feasible(chain: ClosedChain, f: Array, found: Mapping[str, Array]) -> None:
    """Refuse wrenches that bushings do not exert, and accelerations for which a floating base would need a drive.

    Args:
        chain: the chain.
        f: (arms, 6) given wrenches.
        found: the arrays of `feasibility`.

    Raises:
        StateError: they are not feasible; the message gives the wrench that is missing.
    """
    if chain.bushings:
        exerted = found["bushing_wrench"]
        for name in [name for name, different in differ(chain, f, exerted).items() if different]:
            i = chain.names.index(name)
            raise StateError(
                f"grasp_wrench: arm '{name}' holds by a bushing, which exerts {checks.place(exerted[i])} in this state,"
                f" got {checks.place(f[i])};"
                " try zeros, which stand for that"
            )
    if chain.floats:
        require_no_base_wrench(found["trunk_base_wrench"], found["largest_wrench"])


def feasible(chain: ClosedChain, given: Mapping[str, Array], found: Mapping[str, Array]) -> dict[str, Array]:
    """Return results without the arrays of `feasibility`; in a batch, those of infeasible systems become NaN.

    Args:
        chain: the chain.
        given: the inputs, with grasp_wrench (arms, 6) or (batch, arms, 6).
        found: results by name, one system's or a batch's, which are overwritten.

    Raises:
        StateError: One system is not feasible: a bushing exerts another wrench, or a floating base would need a drive.
    """
    decided, f = feasibility(chain), given["grasp_wrench"]
    if not decided:
        return dict(found)
    results = {name: x for name, x in found.items() if name not in decided}
    of = {name: found[name] for name in decided}
    if all(of[name].ndim == len(shape) for name, shape in decided.items()):
        require_feasible(chain, f, of)
        return results
    wrong = list(differ(chain, f, of["bushing_wrench"]).values()) if chain.bushings else []
    wrong += [needs_drive(of["trunk_base_wrench"], of["largest_wrench"])] if chain.floats else []
    for x in results.values():
        x[np.logical_or.reduce(wrong)] = np.nan
    return results


def needs_drive(base: Array, largest: Array) -> Array:
    """Return whether wrenches on a base, (..., 6), exceed rounding; the largest wrenches on the trunk are (...)."""
    return ~(np.abs(base).max(-1) <= NO_BASE_WRENCH * largest)


def require_no_base_wrench(base: Array, largest: Array) -> None:
    """Refuse accelerations of a floating base for which it would need a drive; arguments as in `needs_drive`.

    Raises:
        StateError: a wrench on the base is needed; the message gives it.
    """
    if needs_drive(base, largest):
        raise StateError(
            f"base_acceleration: the floating base has no drive, but would need the wrench {checks.place(base)}"
            " (moment, force about its origin) to accelerate so; try the accelerations and wrenches of forward_dynamics"
        )


def require_holding(chain: ClosedChain, given: Mapping[str, Array]) -> None:
    """Raise a StateError if a grasp_wrench (..., arms, 6) is not zero for an arm that holds nothing."""
    f = given["grasp_wrench"]
    for row, name in enumerate(chain.names):
        if name in chain.grasps:
            continue
        loads = f[..., row, :].reshape(-1, 6)
        loaded = np.flatnonzero((np.isfinite(loads) & (loads != 0.0)).any(1))
        if loaded.size:
            where = f" in system {loaded[0]}" if f.ndim > 2 else ""
            raise StateError(f"grasp_wrench: arm '{name}' holds nothing, expected zeros, got {loads[loaded[0]]}{where}")


INVERSE_DYNAMICS = declare(
    Question(
        "inverse_dynamics",
        _torques,
        ("tau",),
        "the joint torques of a motion under given grasp wrenches, tau = M qdd + C + J^T f + damping qd"
        " + stiffness (q - rest)",
        inputs=("q", "qd", "qdd", "grasp_wrench"),
        parameters=("gravity", "base_R", "base_twist", "base_acceleration"),
        arguments=(
            *(name for name in ARGUMENTS if name != "tau"),
            *("qdd", "grasp_wrench", FLOATING_RESULT),
            *(*TRUNK_LINKS, "trunk_link_wrench", *TRUNK_BASE_MOTION, "floating_twist", "floating_pose"),
        ),
        by=("q", "qd", "qdd", "grasp_wrench"),
        depends_on=("links", "forces", "bushings"),
        parts=by_joints,
        feasibility=feasibility,
        restricted=_with_held,
        require=require_holding,
        settle=feasible,
    ),
    inverse_dynamics,
)
