"""Figures, pages and playbacks of runs, and tables of their summaries."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
