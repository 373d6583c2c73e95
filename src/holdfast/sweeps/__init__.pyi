"""Sweeps: many rollouts of one plan, in a folder."""

from .distributions import NearPose as NearPose
from .distributions import Normal as Normal
from .distributions import Uniform as Uniform
from .of_scene import load_sweep as load_sweep
from .of_scene import sweep_scene as sweep_scene
from .result import Sweep as Sweep
