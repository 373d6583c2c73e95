"""Interfaces to other libraries: MuJoCo's MJCF, the conventions of Pinocchio, functions for SciPy and JAX, MCAP files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
