"""Sweeps: many rollouts of one plan, in a folder."""

from .distributions import NearPose as NearPose
from .distributions import Normal as Normal
from .distributions import Uniform as Uniform
from .progress import Progress as Progress
from .result import Sweep as Sweep
