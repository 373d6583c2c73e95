"""Calibration: where bases, joints, grasps and sensors really are, from postures in which loops are closed."""

from .calibrate import Calibration as Calibration
from .next_postures import next_postures as next_postures
from .noise import ClosureNoise as ClosureNoise
from .postures import FrameMeasurement as FrameMeasurement
from .postures import Postures as Postures
from .postures import load_postures as load_postures
from .urdf_origins import write_urdf as write_urdf
