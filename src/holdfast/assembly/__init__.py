"""From arms, an object and grasps to a closed chain: where everything stands, and what is to be known about it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
