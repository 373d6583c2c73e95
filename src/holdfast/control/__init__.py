"""Controllers, which are functions (t, state, memory) -> (torques, memory)."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
