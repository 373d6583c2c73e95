"""holdfast: exact dynamics for robot arms that hold one object together."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from holdfast.errors import (
    ClosureError,
    FrozenError,
    HoldfastError,
    MethodNotApplicable,
    MissingExtra,
    ModelError,
    ResultError,
    SceneError,
    SingularChainError,
    StateError,
    StepTooLongError,
)
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose
from holdfast.state import Inputs, State

if TYPE_CHECKING:
    from holdfast.assembly.assemble import Assembly, assemble
    from holdfast.assembly.report import AssemblyReport, assembly_report
    from holdfast.compiled.bound_dynamics import BoundDynamics
    from holdfast.compiled.chain import CompiledChain, compile
    from holdfast.compiled.result import CompiledResult
    from holdfast.control.controller import ControlLaw
    from holdfast.control.gravity_compensation import GravityCompensation
    from holdfast.control.holding_torques import holding_torques
    from holdfast.control.object_tracking import ObjectTracking
    from holdfast.control.paths import RestToRest
    from holdfast.control.torque_schedule import TorqueSchedule
    from holdfast.dynamics.closing import close, project_velocity
    from holdfast.dynamics.consistency import GraspResidual, closure
    from holdfast.dynamics.contact_attitude import ContactAttitude, contact_attitudes
    from holdfast.dynamics.diagnose import Diagnosis, diagnose
    from holdfast.dynamics.energy import Power, centre_of_mass, kinetic_energy, momentum, potential_energy, power
    from holdfast.dynamics.forward import forward_dynamics
    from holdfast.dynamics.impulse import Attachment, attach, release
    from holdfast.dynamics.inverse import inverse_dynamics
    from holdfast.dynamics.kinematics import joint_mass_matrix, link_poses, tip_jacobian, tip_pose
    from holdfast.dynamics.largest_margin import LargestMargin, largest_margin
    from holdfast.dynamics.margin_range import MarginRange, margin_range
    from holdfast.dynamics.margins import JointMargins, grasp_margins, joint_margins
    from holdfast.dynamics.methods import METHODS, Method
    from holdfast.dynamics.momentum_balance import momentum_rate
    from holdfast.dynamics.object_from_joints import state_from_joints
    from holdfast.dynamics.object_level import motion_basis, object_inertia, object_mobility
    from holdfast.dynamics.projection import project
    from holdfast.dynamics.result import ArmResult, ForwardResult, Status
    from holdfast.dynamics.split import Split, split
    from holdfast.dynamics.wrist import last_joint_wrenches, wrist_wrenches
    from holdfast.interop.joint_order import angular_first, linear_first, pinocchio_order
    from holdfast.interop.mjcf_reader import load_mjcf
    from holdfast.interop.mjcf_writer import to_mjcf
    from holdfast.io.case_file import load_cases
    from holdfast.io.export import export_csv, export_parquet
    from holdfast.io.result_reader import load_result
    from holdfast.robots.descriptions import load_robot_description
    from holdfast.robots.urdf import load_urdf, load_urdf_arms, urdf_chain
    from holdfast.scenario.build import load_scene
    from holdfast.simulation.events import Attach, Release
    from holdfast.simulation.rollout.compile_rollout import compile_rollout
    from holdfast.simulation.rollout.rollout import Rollout
    from holdfast.simulation.rollout.systems import RolloutRecord, RolloutStatus, RolloutSystems
    from holdfast.simulation.simulate import simulate
    from holdfast.simulation.trajectory import Trajectory
    from holdfast.view.film import film_of_run
    from holdfast.view.page import export_page
    from holdfast.view.plots import save_plots

__version__ = "0.1.0"

# The model is imported at once; algorithms, files and simulation when first asked for.
_LATER = {
    "ArmResult": "holdfast.dynamics.result",
    "Assembly": "holdfast.assembly.assemble",
    "AssemblyReport": "holdfast.assembly.report",
    "Attach": "holdfast.simulation.events",
    "Attachment": "holdfast.dynamics.impulse",
    "BoundDynamics": "holdfast.compiled.bound_dynamics",
    "CompiledChain": "holdfast.compiled.chain",
    "CompiledResult": "holdfast.compiled.result",
    "ContactAttitude": "holdfast.dynamics.contact_attitude",
    "ControlLaw": "holdfast.control.controller",
    "Diagnosis": "holdfast.dynamics.diagnose",
    "ForwardResult": "holdfast.dynamics.result",
    "GraspResidual": "holdfast.dynamics.consistency",
    "GravityCompensation": "holdfast.control.gravity_compensation",
    "JointMargins": "holdfast.dynamics.margins",
    "LargestMargin": "holdfast.dynamics.largest_margin",
    "METHODS": "holdfast.dynamics.methods",
    "MarginRange": "holdfast.dynamics.margin_range",
    "Method": "holdfast.dynamics.methods",
    "ObjectTracking": "holdfast.control.object_tracking",
    "Power": "holdfast.dynamics.energy",
    "Release": "holdfast.simulation.events",
    "RestToRest": "holdfast.control.paths",
    "Rollout": "holdfast.simulation.rollout.rollout",
    "RolloutRecord": "holdfast.simulation.rollout.systems",
    "RolloutStatus": "holdfast.simulation.rollout.systems",
    "RolloutSystems": "holdfast.simulation.rollout.systems",
    "Split": "holdfast.dynamics.split",
    "Status": "holdfast.dynamics.result",
    "TorqueSchedule": "holdfast.control.torque_schedule",
    "Trajectory": "holdfast.simulation.trajectory",
    "angular_first": "holdfast.interop.joint_order",
    "assemble": "holdfast.assembly.assemble",
    "assembly_report": "holdfast.assembly.report",
    "attach": "holdfast.dynamics.impulse",
    "centre_of_mass": "holdfast.dynamics.energy",
    "close": "holdfast.dynamics.closing",
    "closure": "holdfast.dynamics.consistency",
    "compile": "holdfast.compiled.chain",
    "compile_rollout": "holdfast.simulation.rollout.compile_rollout",
    "contact_attitudes": "holdfast.dynamics.contact_attitude",
    "diagnose": "holdfast.dynamics.diagnose",
    "export_csv": "holdfast.io.export",
    "export_page": "holdfast.view.page",
    "export_parquet": "holdfast.io.export",
    "film_of_run": "holdfast.view.film",
    "forward_dynamics": "holdfast.dynamics.forward",
    "grasp_margins": "holdfast.dynamics.margins",
    "holding_torques": "holdfast.control.holding_torques",
    "inverse_dynamics": "holdfast.dynamics.inverse",
    "joint_margins": "holdfast.dynamics.margins",
    "joint_mass_matrix": "holdfast.dynamics.kinematics",
    "kinetic_energy": "holdfast.dynamics.energy",
    "largest_margin": "holdfast.dynamics.largest_margin",
    "last_joint_wrenches": "holdfast.dynamics.wrist",
    "linear_first": "holdfast.interop.joint_order",
    "link_poses": "holdfast.dynamics.kinematics",
    "load_cases": "holdfast.io.case_file",
    "load_mjcf": "holdfast.interop.mjcf_reader",
    "load_result": "holdfast.io.result_reader",
    "load_robot_description": "holdfast.robots.descriptions",
    "load_scene": "holdfast.scenario.build",
    "load_urdf": "holdfast.robots.urdf",
    "load_urdf_arms": "holdfast.robots.urdf",
    "margin_range": "holdfast.dynamics.margin_range",
    "momentum": "holdfast.dynamics.energy",
    "momentum_rate": "holdfast.dynamics.momentum_balance",
    "motion_basis": "holdfast.dynamics.object_level",
    "object_inertia": "holdfast.dynamics.object_level",
    "object_mobility": "holdfast.dynamics.object_level",
    "pinocchio_order": "holdfast.interop.joint_order",
    "potential_energy": "holdfast.dynamics.energy",
    "power": "holdfast.dynamics.energy",
    "project": "holdfast.dynamics.projection",
    "project_velocity": "holdfast.dynamics.closing",
    "release": "holdfast.dynamics.impulse",
    "save_plots": "holdfast.view.plots",
    "simulate": "holdfast.simulation.simulate",
    "split": "holdfast.dynamics.split",
    "state_from_joints": "holdfast.dynamics.object_from_joints",
    "tip_jacobian": "holdfast.dynamics.kinematics",
    "tip_pose": "holdfast.dynamics.kinematics",
    "to_mjcf": "holdfast.interop.mjcf_writer",
    "urdf_chain": "holdfast.robots.urdf",
    "wrist_wrenches": "holdfast.dynamics.wrist",
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
    "Assembly",
    "AssemblyReport",
    "Attach",
    "Attachment",
    "BoundDynamics",
    "ClosedChain",
    "ClosureError",
    "CompiledChain",
    "CompiledResult",
    "ContactAttitude",
    "ControlLaw",
    "Diagnosis",
    "ForwardResult",
    "Friction",
    "FrozenError",
    "Grasp",
    "GraspResidual",
    "GravityCompensation",
    "HeldObject",
    "HoldfastError",
    "Inputs",
    "Joint",
    "JointMargins",
    "LargestMargin",
    "Link",
    "MarginRange",
    "Method",
    "MethodNotApplicable",
    "MissingExtra",
    "ModelError",
    "ObjectTracking",
    "Pose",
    "Power",
    "Release",
    "RestToRest",
    "ResultError",
    "Rollout",
    "RolloutRecord",
    "RolloutStatus",
    "RolloutSystems",
    "SceneError",
    "SingularChainError",
    "Split",
    "State",
    "StateError",
    "Status",
    "StepTooLongError",
    "TorqueSchedule",
    "Trajectory",
    "WrenchLimits",
    "angular_first",
    "assemble",
    "assembly_report",
    "attach",
    "centre_of_mass",
    "close",
    "closure",
    "compile",
    "compile_rollout",
    "contact_attitudes",
    "diagnose",
    "export_csv",
    "export_page",
    "export_parquet",
    "film_of_run",
    "forward_dynamics",
    "grasp_margins",
    "holding_torques",
    "inverse_dynamics",
    "joint_margins",
    "joint_mass_matrix",
    "kinetic_energy",
    "largest_margin",
    "last_joint_wrenches",
    "linear_first",
    "link_poses",
    "load_cases",
    "load_mjcf",
    "load_result",
    "load_robot_description",
    "load_scene",
    "load_urdf",
    "load_urdf_arms",
    "margin_range",
    "momentum",
    "momentum_rate",
    "motion_basis",
    "object_inertia",
    "object_mobility",
    "pinocchio_order",
    "potential_energy",
    "power",
    "project",
    "project_velocity",
    "release",
    "save_plots",
    "simulate",
    "split",
    "state_from_joints",
    "tip_jacobian",
    "tip_pose",
    "to_mjcf",
    "urdf_chain",
    "wrist_wrenches",
]
