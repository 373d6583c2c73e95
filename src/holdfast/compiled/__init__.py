"""Compiled chains: the dynamics of a closed chain is traced to a schedule, which is compiled to machine code."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
