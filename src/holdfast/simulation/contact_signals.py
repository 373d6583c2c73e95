"""The signals at whose zeros contacts change their modes, behind the margins of grasps and joints.

Four for every contact, infinite where they do not apply: the gap of an open contact [m], the normal force of a closed
one [N], what friction leaves of a sticking one, mu lambda_n - |lambda_t| [N], and the speed of a slipping one along its
slip [m/s]. A contact that has just lifted has a gap of zero up to rounding, and may have been located just below zero:
it touches again below its gap at the start of the stretch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.dynamics.contact.fixed_modes import Touch
from holdfast.dynamics.contact.sliding_hands import Hand, names_of
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import Quantity, Signals
from holdfast.spatial.frozen import REQUIRED
from holdfast.spatial.scalar import Array

OPENING, FORCE, CONE, SLIP = range(4)
QUANTITIES: tuple[Quantity, ...] = ("gap", "normal force", "friction", "slip")
GAP_ROUNDING = 1e-14  # m
SLIP_ROUNDING = 1e-13  # m/s: slip that has just begun with next to no acceleration


@dataclass(frozen=True, eq=False)
class ContactSignals(Signals):
    """The margins of a chain and the signals of its contacts, in fixed modes.

    Attributes:
        least_gap: (k,) gap below which a contact touches, not above zero [m].
        hands: hands that slide, whose points follow the contacts with the world.
    """

    least_gap: Array = REQUIRED
    hands: tuple[Hand, ...] = ()

    def __len__(self) -> int:
        return self.of_margins + 4 * len(self.least_gap)

    @property
    def of_margins(self) -> int:
        """The number of margins of grasps and joints, which come first."""
        return super().__len__()

    @cached_property
    def names(self) -> list[str]:
        """Name of each signal: those of the margins, then four times that of every contact."""
        return [*super().names, *(name for name in names_of(self.chain, self.hands) for _ in QUANTITIES)]

    @cached_property
    def quantities(self) -> list[Quantity]:
        """The quantity that each signal limits."""
        return [*super().quantities, *QUANTITIES * len(self.least_gap)]

    @cached_property
    def limited(self) -> Array:
        """Indices of the signals that have a limit."""
        return np.concatenate([super().limited, np.arange(self.of_margins, len(self))])

    @property
    def logged(self) -> Array:
        """Indices of the signals whose violations are logged: not those of contacts, which change modes instead."""
        return self.limited[self.limited < self.of_margins]

    def of_each(self, instants: Sequence[Instant]) -> Array:
        """Return all signals at several instants, (instants, signals)."""
        found = [self._of_touch(at.touch) for at in instants if at.touch is not None]
        return np.concatenate([super().of_each(instants), found], axis=1)

    def of_arrays(self, x: Mapping[str, Array]) -> Array:
        """Return all signals of systems, (..., signals), from their arrays by name."""
        margins, gap, mode = super().of_arrays(x), x["touch_gap"], x["touch_mode"]
        if "touch_push" in x:
            speed = np.where(mode == ContactMode.SLIPS, x["touch_speed"], np.inf)
            found = self._of_contacts(gap, x["touch_push"], self._friction, mode, speed)
        else:  # all are open
            found = np.full((*gap.shape, 4), np.inf)
            found[..., OPENING] = gap - self.least_gap + GAP_ROUNDING
        return np.concatenate([margins, found.reshape(*gap.shape[:-1], -1)], axis=-1)

    def _of_touch(self, touch: Touch) -> Array:
        """Return the signals of the contacts, (4 k,)."""
        rows = touch.rows
        return self._of_contacts(rows.gap, touch.force, rows.friction, touch.modes.mode, touch.slip_speed).ravel()

    def _of_contacts(self, gap: Array, force: Array, friction: Array, mode: Array, speed: Array) -> Array:
        """Return the signals of contacts (..., k, 4), from arrays (..., k) and their forces (..., k, 3 or 4)."""
        is_open, along = mode == ContactMode.OPEN, np.delete(force, 2, axis=-1)
        left = friction * force[..., 2] - np.sqrt((along * along).sum(axis=-1))
        found = np.empty((*mode.shape, 4))
        found[..., OPENING] = np.where(is_open, gap - self.least_gap + GAP_ROUNDING, np.inf)
        found[..., FORCE] = np.where(is_open, np.inf, force[..., 2])
        found[..., CONE] = np.where(mode == ContactMode.STICKS, left, np.inf)
        found[..., SLIP] = speed + SLIP_ROUNDING
        return found

    @cached_property
    def _friction(self) -> Array:
        assert self.chain.touching is not None
        return np.array([one.shape.friction for one in self.chain.touching.candidates])

    def description(self, at: Any, signal: int) -> str:
        """Return a sentence on what happens when a signal reaches zero."""
        if signal < self.of_margins:
            return super().description(at, signal)
        return f"{self.quantities[signal]} of contact '{self.names[signal]}' reaches zero"
