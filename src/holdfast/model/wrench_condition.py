"""Conditions on the wrench of a grasp: cones, and bounds on norms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, array, sqrt

# The components of a wrench in contact axes; the normal points into the object.
MOMENT_X, MOMENT_Y, MOMENT_Z, FORCE_X, FORCE_Y, NORMAL = np.eye(6)


class Condition(NamedTuple):
    """One condition on a wrench in contact axes: constant + pressing . f >= |loading f|.

    Attributes:
        constant: c [N].
        pressing: (6,) a.
        loading: (rows, 6) B.
        broken: what the grasp does if the condition is violated, for example "slips".
    """

    constant: Scalar
    pressing: Array
    loading: Array
    broken: str

    def margin(self, wrench: Array) -> Scalar:
        """Return c + a.f - |B f| [N]."""
        load = self.loading @ wrench
        return self.constant + self.pressing @ wrench - sqrt(load @ load)


def friction_cone(mu: Scalar, *further: Array) -> tuple[Condition, ...]:
    """Return the conditions of a contact that presses and does not slide.

    Args:
        mu: friction coefficient.
        further: (6,) further components that use up friction, in addition to the tangential force, in newtons.
    """
    sliding = Condition(0.0, mu * NORMAL, array([FORCE_X, FORCE_Y, *further]), "slips")
    return sliding, Condition(0.0, NORMAL, np.zeros((1, 6)), "lifts off")


def sliding(mu: Scalar, size: Array) -> tuple[Condition, ...]:
    """Return the conditions of a contact at a point: mu f_n >= |f_t|."""
    return friction_cone(mu)


def sliding_or_spinning(mu: Scalar, size: Array) -> tuple[Condition, ...]:
    """Return the conditions of a contact patch of torsion radius e: mu f_n >= sqrt(|f_t|^2 + (m_n/e)^2)."""
    return friction_cone(mu, MOMENT_Z / size[0])


def sliding_or_tipping(mu: Scalar, size: Array) -> tuple[Condition, ...]:
    """Return the conditions of an edge of half length L: mu f_n >= |f_t|, and f_n >= |m_y| / L."""
    return *friction_cone(mu), Condition(0.0, NORMAL, array([MOMENT_Y / size[0]]), "tips over its edge")


def standing(mu: Scalar, size: Array) -> tuple[Condition, ...]:
    """Return the conditions of a sole of half lengths a, b: mu f_n >= |f_t|, f_n >= |m_y| / a, and f_n >= |m_x| / b."""
    front = Condition(0.0, NORMAL, array([MOMENT_Y / size[0]]), "tips over its front edge")
    side = Condition(0.0, NORMAL, array([MOMENT_X / size[1]]), "tips over its side edge")
    return *friction_cone(mu), front, side


def largest_force_and_moment(moment: Scalar, force: Scalar, lever: Scalar) -> tuple[Condition, ...]:
    """Return the conditions for a largest moment [N m] and force [N]; moments are divided by `lever` [m]."""
    none, unit = np.zeros(6), np.eye(6)
    return (
        Condition(force, none, unit[3:], "gives way to the force"),
        Condition(moment / lever, none, unit[:3] / lever, "gives way to the moment"),
    )
