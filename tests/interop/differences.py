"""Five-point differences along a direction, with poses kept of unit length."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


def five_points(f: Callable[[float], Any], h: float = 1e-4) -> float:
    """Return df/ds at s = 0 from f(-2 h), f(-h), f(h) and f(2 h)."""
    return float((8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h))


def moved(values: Mapping[str, np.ndarray], name: str, by: np.ndarray) -> dict[str, np.ndarray]:
    """Return arguments with one moved."""
    x = values[name] + by
    if name.endswith("_pose"):
        x = np.concatenate([x[..., :4] / np.linalg.norm(x[..., :4], axis=-1, keepdims=True), x[..., 4:]], -1)
    return {**values, name: x}
