"""What people see: figures and tables."""

from holdfast.names import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
