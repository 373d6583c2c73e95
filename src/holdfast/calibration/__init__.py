"""Calibration: where bases, joints, grasps and sensors really are, from postures in which loops are closed."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
