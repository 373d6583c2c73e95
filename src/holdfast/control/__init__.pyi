"""Controllers: functions (t, state, memory) -> (torques, memory)."""

from .clipped import clipped as clipped
from .compiled_law import compile_law as compile_law
from .gravity_compensation import GravityCompensation as GravityCompensation
from .holding_law import holding_law as holding_law
from .object_tracking import ObjectTracking as ObjectTracking
from .paths import RestToRest as RestToRest
from .pose_spline import PoseSpline as PoseSpline
from .sampled import noise_stream as noise_stream
from .sampled import sampled as sampled
from .torque_schedule import TorqueSchedule as TorqueSchedule
