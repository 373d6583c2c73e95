"""Export of a chain's computations as C source or object files, which run on a robot without Python."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
