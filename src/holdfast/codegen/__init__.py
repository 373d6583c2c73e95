"""Export of a chain's computations as C source or object files, which run on a robot without Python."""

from holdfast.names import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
