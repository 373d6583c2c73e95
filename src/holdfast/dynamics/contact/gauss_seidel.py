"""Contact forces by sweeps over the contacts, each solved by itself: slow, and the last way of the reference.

Reference: Jean, "The non-smooth contact dynamics method", 1999.
"""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.contact.contact_law import ReducedContact
from holdfast.dynamics.contact.proximal_newton import lawful_force
from holdfast.spatial.scalar import Array

SWEEPS = 500
SLIP_ROUNDS = 12  # rounds of the direction of slip
REGULAR = 1e-9  # part of a contact's mobility that is added to it


def swept_forces(contacts: list[ReducedContact]) -> list[Array]:
    """Return the forces after `SWEEPS` sweeps from rest, axes [n, t1, t2]; floats only."""
    forces, z = [0.0 * c.free for c in contacts], np.zeros(contacts[0].by_z.shape[1])
    blocks = [c.by_z @ c.along.T + np.eye(len(c.free)) * (REGULAR * c.gauge + c.compliance) for c in contacts]
    for _ in range(SWEEPS):
        before = z
        for j, (c, G) in enumerate(zip(contacts, blocks, strict=True)):
            new = _alone(G, c.velocity(z) + c.compliance * forces[j] - G @ forces[j], float(c.friction), forces[j])
            z = z + (new - forces[j]) @ c.along
            forces[j] = new
        if np.abs(z - before).max() <= 1e-15 * np.abs(z).max(initial=0.0):
            break
    return forces


def _alone(G: Array, b: Array, mu: float, old: Array) -> Array:
    """Return the force of a single contact with u = b + G x: none, that which holds it, or that of slipping."""
    if b[0] >= 0.0:
        return 0.0 * b
    if mu > 0.0:
        holding = np.linalg.solve(G, -b)
        if holding[0] >= 0.0 and np.linalg.norm(holding[1:]) <= mu * holding[0]:
            return holding
    else:
        return np.eye(len(b))[0] * (-b[0] / max(G[0, 0], 1e-14 * np.abs(G).max()))
    d = old[1:] if old[1:].any() else G[1:, 0] * (b[0] / G[0, 0]) - b[1:]
    x = 0.0 * b
    for _ in range(SLIP_ROUNDS + 1):
        d = d / max(float(np.linalg.norm(d)), 1e-300)
        stiff = G[0, 0] + mu * (G[0, 1:] @ d)
        n = -b[0] / (stiff if abs(stiff) > 1e-14 * G[0, 0] else 1e-14 * G[0, 0])
        x = n * np.concatenate([[1.0], mu * d])
        d = x[1:] - (0.75 * (len(b) - 1) / np.trace(G[1:, 1:])) * (b + G @ x)[1:]
    return x if np.isfinite(x).all() and x[0] > 0.0 else lawful_force(-b / G[0, 0], mu)
