"""Gymnasium environments for tasks of arms that hold one object; their ids are registered on import.

Raises:
    MissingExtra: gymnasium is not installed.
"""

import lazy_loader

from holdfast.gym.registration import register_ids

register_ids()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
