"""Simulation: closed chains through time, always on the constraint."""

from .carried_base import CarriedBase as CarriedBase
from .rollout.rollout import Rollout as Rollout
from .rollout.systems import RolloutStatus as RolloutStatus
from .rollout.systems import RolloutSystems as RolloutSystems
from .trajectory import Trajectory as Trajectory
