"""The one place that refuses chains with branches, loops, couplings or several objects where they are not answered."""

from __future__ import annotations

from typing import Any, TypeGuard

from holdfast.errors import MethodNotApplicable
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain

# what such chains can be asked
ANSWERED = (
    "close, project, forward_dynamics, its derivatives, inverse_dynamics, holding_torques, ObjectTracking, distribute,"
    " diagnose, margins, split, energies, attach, linearise, simulate with pictures and folders, compile, rollouts,"
    " export_c of forward and inverse dynamics"
)


def answered_as_forest(value: Any) -> TypeGuard[ClosedChain]:
    """Return whether a value is a chain with more than serial arms that hold one object."""
    return isinstance(value, ClosedChain) and bool(value.beyond_serial)


def serial_chain(value: Any, what: str) -> None:
    """Check that a value is a chain of serial arms that hold one object, which is what most questions are about.

    Raises:
        ModelError: it is no chain.
        MethodNotApplicable: it is a chain that is answered as a forest; the message says why, and what it can be asked.
    """
    checks.instance(value, ClosedChain, what)
    if value.beyond_serial:
        more = f" and {len(value.beyond_serial) - 1} more" if len(value.beyond_serial) > 1 else ""
        raise MethodNotApplicable(
            f"{what}: expected serial arms that hold one object, got a chain with {value.beyond_serial[0]}{more}; such"
            f" a chain answers {ANSWERED} today"
        )


def without_contacts(chain: Any, what: str) -> None:
    """Refuse a chain whose object may touch the world, where contacts are not part of the answer.

    Args:
        chain: the chain.
        what: names the question, for the message.

    Raises:
        MethodNotApplicable: it has `touching`; the message says what answers such chains.
    """
    if getattr(chain, "touching", None) is not None:
        raise MethodNotApplicable(
            f"{what}: expected a chain without touching, since contacts with the world are not built there; they are"
            " part of forward_dynamics and its derivatives, touch, distribute and simulate. Try"
            " dataclasses.replace(chain, touching=None)"
        )


def require_machine_code(chain: Any, what: str) -> None:
    """Refuse a chain with shapes that cannot be traced, of which there is no machine code.

    Raises:
        MethodNotApplicable: it is such a chain.
    """
    touching = getattr(chain, "touching", None)
    if touching is not None and touching.without_machine_code:
        raise MethodNotApplicable(
            f"{what}: expected shapes with machine code, got {', '.join(touching.without_machine_code)}; convex meshes"
            " are answered without it"
        )


def require_unused(**given: bool) -> None:
    """Refuse arguments that the answer of a forest does not use.

    Raises:
        MethodNotApplicable: one is given; the message names it.
    """
    for name, used in given.items():
        if used:
            raise MethodNotApplicable(
                f"{name}: expected its default for a forest, or a chain that is answered as a forest"
            )
