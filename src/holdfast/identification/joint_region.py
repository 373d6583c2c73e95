"""Whether values lie in the joint region of an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import chdtri, fdtri

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.scalar import Array


def in_region(
    estimate: Mapping[str, float],
    covariance: Array,
    freedoms: float,
    given: Any,
    level: Any,
    open_names: tuple[str, ...],
) -> bool:
    """Return whether e^T C^-1 e < k F(level; k, freedoms) for the errors e of k values (Scheffe 1959).

    Args:
        estimate: values by name, in the order of the covariance.
        covariance: (p, p) of their errors.
        freedoms: degrees of freedom from which the noise was estimated; infinite if it was known.
        given: values by name.
        level: probability of the region.
        open_names: names of values that are not determined, of which there is no region.

    Raises:
        ModelError: a name is unknown or not determined, or the level is not between 0 and 1.
    """
    checks.instance(given, Mapping, "holds: values")
    p = checks.number(level, "holds: level", above=0.0)
    if p >= 1.0:
        raise ModelError(f"holds: level: expected a probability below 1, got {p:g}")
    names = list(estimate)
    if not given:
        raise ModelError("holds: values: expected at least one, got none")
    for name in given:
        if name not in estimate:
            raise ModelError(f"holds: values: there is no {name!r}.{checks.did_you_mean(str(name), names)}")
        if name in open_names:
            raise ModelError(f"holds: values: {name!r} is not determined; try the names with finite deviations")
    error = np.array([checks.number(x, f"holds: {name}") - estimate[name] for name, x in given.items()])
    of, k = [names.index(name) for name in given], len(given)
    C = covariance[np.ix_(of, of)]
    sizes = np.sqrt(np.diag(C))
    distance = float(error / sizes @ np.linalg.solve(C / np.outer(sizes, sizes), error / sizes))
    return distance < (float(chdtri(k, 1.0 - p)) if np.isinf(freedoms) else k * float(fdtri(k, freedoms, p)))
