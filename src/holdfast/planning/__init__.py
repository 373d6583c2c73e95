"""Joint paths along a given motion of the object, planned before a law runs."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
