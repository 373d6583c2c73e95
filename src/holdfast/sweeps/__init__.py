"""Sweeps: one plan of many rollouts, computed in chunks by any processes, kept in a folder."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
