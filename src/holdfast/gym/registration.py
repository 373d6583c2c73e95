"""Registration of the environments under the ids that `gymnasium.make` and `make_vec` accept."""

from __future__ import annotations

from holdfast.errors import MissingExtra

IDS = {"holdfast/Carry-v0": ("Carry", "CarryVector"), "holdfast/HandOver-v0": ("HandOver", "HandOverVector")}


def register_ids() -> None:
    """Register the environments with Gymnasium, unless this has been done before.

    Raises:
        MissingExtra: gymnasium is not installed.
    """
    try:
        from gymnasium.envs.registration import register, registry
    except ImportError as cause:
        raise MissingExtra("holdfast.gym needs gymnasium; try pip install 'holdfast[gym]'") from cause
    for name, (single, vector) in IDS.items():
        if name not in registry:
            register(name, f"holdfast.gym:{single}", vector_entry_point=f"holdfast.gym:{vector}")
