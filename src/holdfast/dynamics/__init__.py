"""The algorithms for single arms (`arm`) and closed chains (`closed`), and the functions that users call."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
