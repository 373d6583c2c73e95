"""Forces at the grasps: margins, the split into motion and internal forces, and wrist wrenches."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
