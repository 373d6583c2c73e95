"""The algorithms for single arms (`arm`) and closed chains (`closed`), and the functions that users call."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
