"""Interfaces to other libraries: MJCF of MuJoCo, conventions of Pinocchio, functions for SciPy and JAX, MCAP files."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
