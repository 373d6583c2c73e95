"""The algorithms: open chain (`arm`), closed chain (`closed`), and what is asked of them."""

from .closing import project_velocity as project_velocity
from .consistency import closure as closure
from .contact_places import contact_attitudes as contact_attitudes
from .energy import centre_of_mass as centre_of_mass
from .energy import kinetic_energy as kinetic_energy
from .energy import momentum as momentum
from .energy import potential_energy as potential_energy
from .energy import power as power
from .impulse import attach as attach
from .impulse import release as release
from .kinematics import joint_mass_matrix as joint_mass_matrix
from .kinematics import link_poses as link_poses
from .kinematics import state_from_joints as state_from_joints
from .kinematics import tip_jacobian as tip_jacobian
from .kinematics import tip_pose as tip_pose
from .methods import METHODS as METHODS
from .momentum_balance import momentum_rate as momentum_rate
from .object_level import motion_basis as motion_basis
from .object_level import object_inertia as object_inertia
from .object_level import object_mobility as object_mobility
from .posture import Posture as Posture
from .regressor import inertial_parameters as inertial_parameters
from .result import ForwardResult as ForwardResult
from .result import Status as Status
from .tree.forest_dynamics import forest_dynamics as forest_dynamics
from .tree.mechanism import MechanismResult as MechanismResult
