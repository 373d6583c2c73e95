"""Simulation: closed chains through time, always on the constraint."""

from .carried_base import CarriedBase as CarriedBase
from .rollout.record import RolloutRecord as RolloutRecord
from .rollout.rollout import Rollout as Rollout
from .rollout.systems import RolloutStatus as RolloutStatus
from .rollout.systems import RolloutSystems as RolloutSystems
from .setting import Setting as Setting
from .trajectory import Trajectory as Trajectory
