"""The functions that a compiled chain does not have, with reasons; all others of the dynamics are its methods."""

from __future__ import annotations

from holdfast.errors import MethodNotApplicable
from holdfast.names import unknown_attribute

_ROUNDS = "it goes on for as many rounds as it takes"
_SINGULAR_VALUES = "it decides by singular values, which are NumPy's"
_OF_A_RESULT = "it reads one ForwardResult"

REASONS = {
    "close": f"{_ROUNDS}; where grasps are nearly closed try `project`, which takes two",
    "diagnose": f"{_SINGULAR_VALUES}; `forward_dynamics` gives rank, status and condition",
    "dynamics.attach": "another grasp is other code; compile the chain it returns",
    "dynamics.contact_attitudes": "it is a few products of one grasp; try `tip_poses`",
    "dynamics.joint_mass_matrix": "it is of one arm; `mass_matrix` gives those of all arms",
    "dynamics.momentum_rate": _OF_A_RESULT,
    "dynamics.motion_basis": _SINGULAR_VALUES,
    "dynamics.object_inertia": "it refuses an object held fast, by eigenvalues; `object_mobility` is its inverse",
    "dynamics.power": f"{_OF_A_RESULT}; the systems of a rollout have their `work`",
    "dynamics.project_velocity": f"{_SINGULAR_VALUES}; `project` takes the velocities nearest in kinetic energy",
    "dynamics.release": "another grasp is other code; compile the chain it returns",
    "dynamics.state_from_joints": "it is of rigid grasps only; try `tip_poses`",
    "dynamics.tip_jacobian": "it is of one arm; `jacobian` gives those of all arms",
    "dynamics.tip_pose": "it is of one arm; `tip_poses` gives those of all arms",
    "forces.largest_margin": f"it is a convex programme: {_ROUNDS}",
    "forces.last_joint_wrenches": _OF_A_RESULT,
    "forces.margin_range": f"it is a convex programme: {_ROUNDS}",
    "forces.split": f"{_OF_A_RESULT}, and its length follows from where the contacts are",
    "linearise": _SINGULAR_VALUES,
    "regressor": "it is of the model's parameters, which machine code has as constants",
    "dynamics.inertial_parameters": "it is of a body, not of a chain",
    "holding_torques": "it is a control law, made by `control.compile_law(control.holding_law(chain), chain)`",
}
_PATHS = {path.rpartition(".")[2]: path for path in REASONS}


class NotCompiledError(MethodNotApplicable, AttributeError):
    """A compiled chain has no such method; the message says why and what to use instead."""


def missing(name: str, of: object) -> AttributeError:
    """Return the error for an attribute that a compiled chain does not have."""
    if path := _PATHS.get(name):
        return NotCompiledError(
            f"compile: '{name}' runs as reference only: {REASONS[path]}. holdfast.{path} computes it from the chain"
        )
    return unknown_attribute(of, name)
