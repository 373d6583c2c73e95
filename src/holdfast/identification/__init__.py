"""Identification of the payload, sensor offsets, gravity and grasp frames from recorded motions."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
