"""Controllers: functions (t, state, memory) -> (torques, memory)."""

from .admittance_law import admittance_law as admittance_law
from .clipped import clipped as clipped
from .compiled_law import compile_law as compile_law
from .cooperative_law import cooperative_law as cooperative_law
from .gravity_compensation import GravityCompensation as GravityCompensation
from .holding_law import holding_law as holding_law
from .hybrid_force import HybridForce as HybridForce
from .internal_force import InternalForce as InternalForce
from .internal_impedance import InternalImpedance as InternalImpedance
from .load_share import LoadShare as LoadShare
from .momentum_observer import Observation as Observation
from .momentum_observer import observation as observation
from .momentum_observer import observed as observed
from .object_impedance import ObjectImpedance as ObjectImpedance
from .object_tracking import ObjectTracking as ObjectTracking
from .paths import RestToRest as RestToRest
from .pose_spline import PoseSpline as PoseSpline
from .posture_control import PostureControl as PostureControl
from .ramped_forces import RampedForces as RampedForces
from .ramped_forces import unloaded as unloaded
from .sampled import noise_stream as noise_stream
from .sampled import sampled as sampled
from .timed_path import TimedPath as TimedPath
from .torque_schedule import TorqueSchedule as TorqueSchedule
