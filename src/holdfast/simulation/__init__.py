"""Simulation of closed chains in time; every sample satisfies the grasp constraint."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
