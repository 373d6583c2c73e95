"""Interfaces to other libraries: MJCF of MuJoCo, conventions of Pinocchio, functions for SciPy and JAX, MCAP files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
