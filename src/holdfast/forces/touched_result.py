"""What a distribution says of the contacts of the object with the world."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.dynamics.forward import forward_dynamics
from holdfast.errors import HoldfastError
from holdfast.forces.affine_map import ACCELERATION_SCALE
from holdfast.forces.force_question import ForceQuestion
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array

SAME = 1e-6  # difference of accelerations, relative to the largest, by which motions are told apart
OF_MODE = 1e-7  # violations of a mode below this, relative to F0, are rounding


def of_contacts(question: ForceQuestion, tau: Array, v: Array) -> dict[str, Any]:
    """Return the fields of `Distribution` about contacts, for torques and unknowns v of the map."""
    found = question.found
    touched, touching = found.touched, found.chain.touching
    assert touched is not None
    assert touching is not None
    forces = touched.forces(v[found.touch])
    margins, in_world = touched.margins(forces), touched.rows.in_world(forces)
    keeps = bool(margins.min(initial=np.inf) >= -OF_MODE * found.force)
    return {
        "touch_force": in_world,
        "touch_mode": touched.mode,
        "touch_margin": margins,
        "touch_status": _status(question, tau, v[found.alpha]) if keeps else None,
        "touches": FrozenDict(zip(touching.names, in_world, strict=True)),
    }


def _status(question: ForceQuestion, tau: Array, alpha: Array) -> ContactStatus | None:
    """Return the status of forward dynamics with torques, AMBIGUOUS if it finds another motion; None if it refuses."""
    try:
        back = forward_dynamics(question.found.chain, question.state, tau, inputs=question.inputs, check=False)
    except HoldfastError:  # a singular configuration, of which the map of forces has no fear
        return None
    size = max(ACCELERATION_SCALE, float(np.abs(alpha).max()), float(np.abs(back.object_acceleration).max()))
    same = np.abs(back.object_acceleration - alpha).max() <= SAME * size
    return back.touch_status if same else ContactStatus.AMBIGUOUS
