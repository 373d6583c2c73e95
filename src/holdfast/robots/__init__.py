"""Built-in arms from published data, two mechanisms made of short arms, and the import of URDF files."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
