"""Simulation of closed chains in time; every sample satisfies the grasp constraint."""

from holdfast.names import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
