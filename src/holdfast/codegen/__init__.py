"""Export of a chain's computations as C source or object files, which run on a robot without Python."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
