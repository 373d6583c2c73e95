"""Gymnasium environments for tasks of arms that hold one object; their ids are registered on import.

Raises:
    MissingExtra: gymnasium is not installed.
"""

from holdfast.errors import MissingExtra as _MissingExtra
from holdfast.names import attach as _attach

try:
    from gymnasium.envs.registration import register as _register
    from gymnasium.envs.registration import registry as _registry
except ImportError as cause:
    raise _MissingExtra("holdfast.gym needs gymnasium; try pip install 'holdfast[gym]'") from cause

for _task in ("Carry", "HandOver", "PlaceOnTable"):
    if f"holdfast/{_task}-v0" not in _registry:
        _register(f"holdfast/{_task}-v0", f"holdfast.gym:{_task}", vector_entry_point=f"holdfast.gym:{_task}Vector")

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
