"""Forces at the grasps: margins, the split into motion and internal forces, and wrist wrenches."""

from holdfast.names import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
