"""What a compiled chain does not compute, and why: every other function of the dynamics is one of its methods."""

from __future__ import annotations

from holdfast.errors import MethodNotApplicable

_ROUNDS = "it goes on for as many rounds as it takes"
_SINGULAR_VALUES = "it decides by singular values, which are NumPy's"
_OF_A_RESULT = "it reads one ForwardResult"

REASONS = {
    "attach": "another grasp is another code; try holdfast.attach, and compile the chain that it returns",
    "close": f"{_ROUNDS}; where grasps are nearly closed try `project`, which takes two",
    "contact_attitudes": "it is a few products of one grasp; try `tip_poses`",
    "diagnose": f"{_SINGULAR_VALUES}; `forward_dynamics` gives rank, status and condition",
    "grasp_margins": "its conditions differ from grasp to grasp; the systems of a rollout have their `margin`",
    "holding_torques": "it decides by numbers whether the grasps can hold",
    "joint_margins": "it is a difference of numbers that are given",
    "joint_mass_matrix": "it is of one arm; `mass_matrix` gives those of all arms",
    "largest_margin": f"it is a convex programme: {_ROUNDS}",
    "last_joint_wrenches": _OF_A_RESULT,
    "margin_range": f"it is a convex programme: {_ROUNDS}",
    "momentum_rate": _OF_A_RESULT,
    "motion_basis": _SINGULAR_VALUES,
    "object_inertia": "it refuses an object held fast, by eigenvalues; try numpy.linalg.inv of `object_mobility`",
    "power": f"{_OF_A_RESULT}; the systems of a rollout have their `work`",
    "project_velocity": f"{_SINGULAR_VALUES}; `project` takes the velocities nearest in kinetic energy",
    "release": "another grasp is another code; try holdfast.release, and compile the chain that it returns",
    "split": f"{_OF_A_RESULT}, and its length follows from where the contacts are",
    "state_from_joints": "it is of rigid grasps only; try `tip_poses`",
    "tip_jacobian": "it is of one arm; `jacobian` gives those of all arms",
    "tip_pose": "it is of one arm; `tip_poses` gives those of all arms",
    "wrist_wrenches": _OF_A_RESULT,
}


class NotCompiledError(MethodNotApplicable, AttributeError):
    """A compiled chain has no such method; the message says why, and what there is."""


def missing(name: str, kind: str) -> AttributeError:
    """Return the error for an attribute that a compiled chain has not."""
    if name in REASONS:
        return NotCompiledError(
            f"compile: '{name}' runs as reference only: {REASONS[name]}. holdfast.{name} computes it from the chain"
        )
    return AttributeError(f"'{kind}' object has no attribute '{name}'")
