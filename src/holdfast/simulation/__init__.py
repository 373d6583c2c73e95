"""Simulation of closed chains in time; every sample satisfies the grasp constraint."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
