"""Where robots meet the compiler: chains become schedules of stages, and these machine code."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
