"""Code for the robot: a chain's computations as C, or as object files, that run without Python."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
