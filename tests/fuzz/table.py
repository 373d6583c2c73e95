"""The calls that a fuzz spoils, in one order."""

from __future__ import annotations

import pytest

from tests.fuzz import chain_calls, part_calls  # noqa: F401 (adds its calls)
from tests.fuzz.calls import CALLS

SLOW = ("linearise", "forward_dynamics_jacobian", "assemble")
LIBRARIES = ("jax", "gymnasium", "pyarrow", "mujoco", "pandas", "xarray")
QUICK = [name for name in CALLS if not name.startswith(SLOW)]


def every_call() -> list[str]:
    """Return the names of all calls, those of machine code, runs and files too."""
    for library in LIBRARIES:
        pytest.importorskip(library, reason=f"needs {library}: pip install 'holdfast[dev]'")
    from tests.fuzz import compiled_calls, file_calls, run_calls  # noqa: F401 (adds its calls)

    return list(CALLS)
