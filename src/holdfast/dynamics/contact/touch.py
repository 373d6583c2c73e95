"""Impacts of a chain's object on the world: impulses at the contacts, shared by the grasps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_at_rest
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.sequential import sequential, tips_of
from holdfast.dynamics.contact.collision import Collision, impact
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.dynamics.contact.touching_chain import CLOSED, chain_mobility, pushed
from holdfast.dynamics.projection import Change, quickened
from holdfast.dynamics.rank import rank_and_held_near
from holdfast.dynamics.result import Status
from holdfast.dynamics.smallest_forces import with_smallest_forces
from holdfast.errors import ContactError, ModelError
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs


@called
@dataclass(frozen=True, eq=False)
class Impact(Frozen):
    """The result of an impact, in world axes.

    Attributes:
        state: the state just after; the positions do not change.
        touch_impulse: (k, 3) impulse of the world on the object at every candidate of `touching` [N s].
        touch_wrench: (6,) their sum about C [N m s, N s].
        touch_gap: (k,) distances [m].
        touch_mode: (k,) numbers of `ContactMode` while the object is compressed.
        touch_status: whether impulses and velocities are unique.
        touch_residual: violation of the laws of contact, relative to the velocities.
        grasp_impulse: (arms, 6) [moment; force] impulse of each arm on the object about its contact point.
        base_impulse: (arms, 6) impulse of the base, or of the trunk, on each arm about the arm's base origin.
        energy_change: change of the kinetic energy [J]; not positive if bases and world stand still.
        rounds: collisions that followed on each other; 0 if no contact approaches.
        status: whether the impulses of the grasps are unique; otherwise they are the smallest ones.
    """

    state: State
    touch_impulse: Array
    touch_wrench: Array
    touch_gap: Array
    touch_mode: Array
    touch_status: ContactStatus
    touch_residual: float
    grasp_impulse: Array
    base_impulse: Array
    energy_change: float
    rounds: int
    status: Status


@np.errstate(all="ignore")  # what overflows is refused by what is called
def touch(chain: ClosedChain, state: State, *, inputs: Inputs | None = None) -> Impact:
    """Return the impulses of closed contacts that approach, and the velocities after them.

    Compression by the laws of Signorini and Coulomb at the velocities, then expansion by Poisson's law with the shapes'
    coefficients of restitution, never with a gain of energy; repeated while contacts still approach, at most eight
    times. The impulses act on the object alone, and the grasps share them. O(n) + O(l) + O(k).

    Args:
        chain: a chain with `touching`.
        state: positions and velocities just before. Only contacts with a gap of at most 1e-9 m take part.
        inputs: base motion, if the bases move.

    Returns:
        An `Impact`; where nothing approaches, the same state and no impulses.

    Raises:
        ModelError: the chain has no `touching`.
        StateError: a shape is wrong.
        ContactError: no impulses that satisfy the laws were found.
    """
    require_fit(chain, state)
    if chain.touching is None:
        raise ModelError(
            "touch: expected a chain whose object may touch something, got one without touching; try"
            " dataclasses.replace(chain, touching=holdfast.world.Touching(...))"
        )
    given, twist = shaped_inputs(chain, inputs), state.object_twist
    rank, mask = (0, None) if not chain.grasps else rank_and_held_near(chain, state, given)
    still = holding(chain_at_rest(chain, state), mask)
    rows = contact_rows(chain.touching, state.object_frame, twist)
    closed = rows.gap <= CLOSED
    hit = impact(
        chain_mobility(still, tips_of(still)),
        rows.C[closed],
        rows.velocity(twist)[closed],
        rows.friction[closed],
        rows.restitution[closed],
        float(np.abs(twist).max()),
    )
    _require_impulses(hit, chain, closed)
    impulses, modes = np.zeros((len(closed), 3)), np.zeros(len(closed), int)
    impulses[closed], modes[closed] = hit.impulse, hit.mode
    change, found = impulse_response(still, state, hit.wrench)
    status = Status.OK
    if rank < chain.constraint_row_count:
        status, found = Status.INDETERMINATE_FORCES, with_smallest_forces(still, found)
    of_chain = chain_solution(still, found, "auto")
    after = quickened(state, change)
    work = float(hit.wrench @ (twist + after.object_twist)) / 2.0
    if given.base_twists is not None:
        standing = [i for i, name in enumerate(chain.arms) if name not in chain.mounted_on]
        work += float((given.base_twists[standing] * of_chain.base_wrench[standing]).sum())
    if given.trunk_base_twist is not None and of_chain.trunk_base_wrench is not None:
        work += float(given.trunk_base_twist @ of_chain.trunk_base_wrench)
    return Impact(
        after,
        rows.in_world(impulses),
        hit.wrench,
        rows.gap,
        modes,
        hit.status,
        hit.residual,
        of_chain.grasp_wrench,
        of_chain.base_wrench,
        work,
        hit.rounds,
        status,
    )


def impulse_response(still: ChainMotion, state: State, wrench: Array) -> tuple[Change, Solution]:
    """Return the change of the velocities by an impulse on the object, and the solution with the grasps' impulses."""
    found = sequential(pushed(still, state.at_rest(), wrench))
    of_chain = chain_solution(still, found, "auto")
    return Change(of_chain.qdd, found.object_acceleration, of_chain.base_acceleration), found


def _require_impulses(hit: Collision, chain: ClosedChain, closed: Array) -> None:
    assert chain.touching is not None
    if hit.status in (ContactStatus.JAMMED, ContactStatus.UNRESOLVED):
        at = ", ".join(chain.touching.names_of(closed)[:4])
        raise ContactError(
            f"no impulses were found at {at} that satisfy Coulomb's law to 1e-9 of the velocities: the best ones"
            f" violate it by {hit.residual:.1e}; try fewer or less opposed contacts, or a smaller friction",
            hit.status.name,
        )
