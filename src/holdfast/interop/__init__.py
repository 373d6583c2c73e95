"""To and from other libraries: MuJoCo's MJCF, Pinocchio's orders, functions for SciPy and JAX."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
