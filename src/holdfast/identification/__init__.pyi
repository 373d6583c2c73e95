"""Identification: the payload, sensor offsets, gravity and grasp frames, from what was recorded."""

from .base_parameters import base_parameters as base_parameters
from .identify import Identification as Identification
from .recording import Recording as Recording
from .recording import load_recording as load_recording
