"""Built-in arms from published data, two mechanisms made of short arms, and the import of URDF files."""

from holdfast.names import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
