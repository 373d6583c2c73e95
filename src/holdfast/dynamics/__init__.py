"""The algorithms for single arms (`arm`) and closed chains (`closed`), and the functions that users call."""

from holdfast.names import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
