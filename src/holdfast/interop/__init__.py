"""Interfaces to other libraries: MJCF files of MuJoCo, the conventions of Pinocchio, functions of JAX, MCAP files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
