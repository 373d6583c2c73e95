"""Compiled chains: the dynamics of a closed chain is traced to a schedule, which is compiled to machine code."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
