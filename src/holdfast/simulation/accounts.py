"""What a run records besides the motion: energies, momentum and its rate, and what grasps and wrists carry."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.contact_places import tip_frames
from holdfast.dynamics.energy import total_kinetic_energy, total_momentum, total_potential_energy
from holdfast.dynamics.momentum_balance import rate_of
from holdfast.dynamics.result import ForwardResult
from holdfast.forces.force_split import constant_split, parts_by
from holdfast.forces.wrist import across_tips
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import Shape, state_of
from holdfast.simulation.environment import Environment
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, arctan2, array
from holdfast.state import Inputs, State

SPLIT = "split"  # a parameter of machine code: the result of `force_split.constant_split`


class Forces(NamedTuple):
    """The forces of forward dynamics on which the accounts depend, as in `ForwardResult`."""

    grasp_wrench: Array
    base_wrench: Array
    trunk_base_wrench: Array | None = None


def account_shapes(chain: ClosedChain, split: bool) -> dict[str, Shape]:
    """Return the shapes of what `accounts` returns, by name; `split` says whether it is given a matrix."""
    arms = len(chain.arms)
    found: dict[str, Shape] = {"kinetic": (), "potential": (), "momentum": (6,), "momentum_rate": (6,)}
    found |= {"wrist_wrench": (arms, 6), "spin": (arms,)}
    return found | ({"internal_wrench": (arms, 6), "load_share": (arms,)} if split else {})


def accounts(
    chain: ClosedChain, state: State, inputs: Inputs, forces: Forces | ForwardResult, split: Array | None
) -> dict[str, Scalar | Array]:
    """Return what is recorded at one instant besides the motion, by the names of a trajectory, floats or traced. O(n).

    Args:
        chain: the chain, with its bases at their poses at that time.
        state: positions and velocities.
        inputs: shaped external wrenches and base motion at that time.
        forces: result of forward dynamics, of which only the wrenches of grasps and bases are used.
        split: the result of `force_split.constant_split`; if it is None, the grasp wrenches are not split.
    """
    given, f = with_force_elements(chain, state, inputs), forces.grasp_wrench
    found = {
        "kinetic": total_kinetic_energy(chain, state, inputs),
        "potential": total_potential_energy(chain, state),
        "momentum": total_momentum(chain, state, inputs, np.zeros(3)),
        "momentum_rate": rate_of(chain, state, forces, given, np.zeros(3)),
        "wrist_wrench": across_tips(chain, state, f),
        "spin": array(list(spins(chain, state).values())),
    }
    if split is not None:
        found["internal_wrench"], found["load_share"] = parts_by(split, chain, state, f)
    return found


def accounts_of(environment: Environment, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Return the accounts of several instants, (k, ...) each, computed one by one on floats.

    Args:
        environment: the chain, its base motions and external inputs.
        t: (k,) times [s].
        arrays: states and forces by the names of machine code, (k, ...) each.
    """
    split, found = constant_split(environment.chain), []
    for k, time in enumerate(t.tolist()):
        state = state_of(arrays, k)
        chain, inputs = environment.at(time, state)
        forces = Forces(*(arrays[name][k] for name in Forces._fields if name in arrays))
        found.append(accounts(chain, state, inputs.shaped(chain), forces, split))
    return {name: np.array([one[name] for one in found]) for name in found[0]}


def spins(chain: ClosedChain, state: State) -> dict[str, Scalar]:
    """Return the rotation of each soft finger's contact about its normal, by arm [rad]; 0 for other grasps.

    This is the component about z of the rotation from the tip frame to the contact frame, within -pi .. pi. The spin
    rate of a soft finger is constrained to zero, but rolling still changes the angle (Appendix A). It is reported, not
    corrected.
    """
    turned: dict[str, Scalar] = dict.fromkeys(chain.names, 0.0)
    soft = [name for name, grasp in chain.grasps.items() if grasp.of_kind.rate_rows]
    for name, tip in tip_frames(chain, state, soft).items():
        q = rotation.to_quaternion(tip.R.T @ state.object_frame.R @ chain.grasps[name].frame.R)
        turned[name] = 2.0 * arctan2(q[3], q[0])
    return turned
