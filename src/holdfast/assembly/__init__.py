"""Assembly of arms, an object and grasps to a closed chain in a closed state, with a report."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
