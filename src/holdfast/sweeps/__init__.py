"""Sweeps: one plan of many rollouts, computed in chunks by any processes, kept in a folder."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
