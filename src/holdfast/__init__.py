"""holdfast: exact dynamics for robot arms that hold one object together."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from holdfast.compiled.bound_dynamics import BoundDynamics
    from holdfast.compiled.chain import CompiledChain, compile
    from holdfast.compiled.result import CompiledResult
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
    from holdfast.io.case_file import load_cases
    from holdfast.io.result_reader import load_result
    from holdfast.scenario.build import load_scene
    from holdfast.simulation.simulate import simulate
    from holdfast.simulation.trajectory import Trajectory

__version__ = "0.1.0"

# The model is imported at once; algorithms, files and simulation when first asked for.
_LATER = {
    "ArmResult": "holdfast.dynamics.result",
    "BoundDynamics": "holdfast.compiled.bound_dynamics",
    "CompiledChain": "holdfast.compiled.chain",
    "CompiledResult": "holdfast.compiled.result",
    "ContactAttitude": "holdfast.dynamics.contact_attitude",
    "Diagnosis": "holdfast.dynamics.diagnose",
    "ForwardResult": "holdfast.dynamics.result",
    "GraspResidual": "holdfast.dynamics.consistency",
    "METHODS": "holdfast.dynamics.methods",
    "Method": "holdfast.dynamics.methods",
    "Power": "holdfast.dynamics.energy",
    "Split": "holdfast.dynamics.split",
    "Status": "holdfast.dynamics.result",
    "Trajectory": "holdfast.simulation.trajectory",
    "centre_of_mass": "holdfast.dynamics.energy",
    "close": "holdfast.dynamics.closing",
    "closure": "holdfast.dynamics.consistency",
    "compile": "holdfast.compiled.chain",
    "contact_attitudes": "holdfast.dynamics.contact_attitude",
    "diagnose": "holdfast.dynamics.diagnose",
    "forward_dynamics": "holdfast.dynamics.forward",
    "inverse_dynamics": "holdfast.dynamics.inverse",
    "kinetic_energy": "holdfast.dynamics.energy",
    "load_cases": "holdfast.io.case_file",
    "load_result": "holdfast.io.result_reader",
    "load_scene": "holdfast.scenario.build",
    "momentum": "holdfast.dynamics.energy",
    "motion_basis": "holdfast.dynamics.object_level",
    "object_inertia": "holdfast.dynamics.object_level",
    "object_mobility": "holdfast.dynamics.object_level",
    "potential_energy": "holdfast.dynamics.energy",
    "power": "holdfast.dynamics.energy",
    "project": "holdfast.dynamics.projection",
    "project_velocity": "holdfast.dynamics.closing",
    "simulate": "holdfast.simulation.simulate",
    "split": "holdfast.dynamics.split",
    "state_from_joints": "holdfast.dynamics.object_from_joints",
}


def __getattr__(name: str) -> Any:
    """Return a public name that is imported late."""
    if name not in _LATER:
        raise AttributeError(f"module 'holdfast' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_LATER[name]), name)
    return value


def __dir__() -> list[str]:
    """Return the public names, imported yet or not."""
    return sorted(__all__)


__all__ = [
    "METHODS",
    "Arm",
    "ArmResult",
    "BoundDynamics",
    "ClosedChain",
    "ClosureError",
    "CompiledChain",
    "CompiledResult",
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
    "Trajectory",
    "centre_of_mass",
    "close",
    "closure",
    "compile",
    "contact_attitudes",
    "diagnose",
    "forward_dynamics",
    "inverse_dynamics",
    "kinetic_energy",
    "load_cases",
    "load_result",
    "load_scene",
    "momentum",
    "motion_basis",
    "object_inertia",
    "object_mobility",
    "potential_energy",
    "power",
    "project",
    "project_velocity",
    "simulate",
    "split",
    "state_from_joints",
]
