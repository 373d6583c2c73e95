"""Forces at the grasps: margins, the split into motion and internal forces, and wrist wrenches."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
