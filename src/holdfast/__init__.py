"""holdfast: exact dynamics for robot arms that hold one object together."""

from holdfast.dynamics.closing import close, project_velocity
from holdfast.dynamics.consistency import closure
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.methods import METHODS
from holdfast.dynamics.result import ForwardResult, Status
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
    "ClosedChain",
    "ClosureError",
    "ForwardResult",
    "Friction",
    "Grasp",
    "HeldObject",
    "HoldfastError",
    "Inputs",
    "Joint",
    "Link",
    "MethodNotApplicable",
    "MissingExtra",
    "ModelError",
    "Pose",
    "ResultError",
    "SceneError",
    "SingularChainError",
    "State",
    "StateError",
    "Status",
    "close",
    "closure",
    "forward_dynamics",
    "project_velocity",
]
