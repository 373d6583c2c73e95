"""Gymnasium environments for tasks of arms that hold one object; their ids are registered on import.

Raises:
    MissingExtra: gymnasium is not installed.
"""

from holdfast.gym.registration import register_ids
from holdfast.names import attach as _attach

register_ids()

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
