"""holdfast: exact dynamics for robot arms that hold one object together."""

from holdfast.dynamics.closing import close, project_velocity
from holdfast.dynamics.consistency import GraspResidual, closure
from holdfast.dynamics.contact_attitude import ContactAttitude, contact_attitudes
from holdfast.dynamics.diagnose import Diagnosis, diagnose
from holdfast.dynamics.energy import Power, centre_of_mass, kinetic_energy, momentum, potential_energy, power
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.inverse import inverse_dynamics
from holdfast.dynamics.methods import METHODS, Method
from holdfast.dynamics.object_from_joints import state_from_joints
from holdfast.dynamics.object_level import motion_basis, object_inertia, object_mobility
from holdfast.dynamics.projection import project
from holdfast.dynamics.result import ArmResult, ForwardResult, Status
from holdfast.dynamics.split import Split, split
from holdfast.errors import (
    ClosureError,
    HoldfastError,
    MethodNotApplicable,
    MissingExtra,
    ModelError,
    ResultError,
    SceneError,
    SingularChainError,
    StateError,
)
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Friction, Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose
from holdfast.state import Inputs, State

__version__ = "0.1.0"

__all__ = [
    "METHODS",
    "Arm",
    "ArmResult",
    "ClosedChain",
    "ClosureError",
    "ContactAttitude",
    "Diagnosis",
    "ForwardResult",
    "Friction",
    "Grasp",
    "GraspResidual",
    "HeldObject",
    "HoldfastError",
    "Inputs",
    "Joint",
    "Link",
    "Method",
    "MethodNotApplicable",
    "MissingExtra",
    "ModelError",
    "Pose",
    "Power",
    "ResultError",
    "SceneError",
    "SingularChainError",
    "Split",
    "State",
    "StateError",
    "Status",
    "centre_of_mass",
    "close",
    "closure",
    "contact_attitudes",
    "diagnose",
    "forward_dynamics",
    "inverse_dynamics",
    "kinetic_energy",
    "momentum",
    "motion_basis",
    "object_inertia",
    "object_mobility",
    "potential_energy",
    "power",
    "project",
    "project_velocity",
    "split",
    "state_from_joints",
]
