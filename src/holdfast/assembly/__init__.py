"""Assembly of arms, an object and grasps to a closed chain in a closed state, with a report."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
