"""The grasp forces that controllers command: the smallest forces for the motion, and an internal force."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import pseudo_gravity
from holdfast.dynamics.closed.force_elements import deflections, with_force_elements
from holdfast.dynamics.closed.object_motion import object_motion
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.contact_places import contact_places
from holdfast.forces.force_split import motion_wrenches
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from holdfast.state import Inputs, State


def commanded_wrenches(chain: ClosedChain, state: State, acceleration: Array, internal_force: float = 0.0) -> Array:
    """Return grasp wrenches that accelerate the object with a chosen internal force, (arms, 6).

    Every arm pushes along its contact's normal z. The smallest transmissible wrenches (in the metric of the force
    split) are added so that the sum agrees with the motion,
        A^T f = M(C) (alpha - [0; g]) + b(C) - w,  with the wrench w of springs and bushings on the object.
    Of the pushes, only the internal part therefore remains; for contacts that face each other, that is all of them.

    Args:
        chain: the chain.
        state: pose and twist of the object.
        acceleration: (6,) [omega_dot; v_dot] of C, the true acceleration, world axes.
        internal_force: push of every arm into the object [N].

    Returns:
        [moment; force] of each arm on the object about its contact, world axes; zero for an arm without a grasp, and
        for a bushing, whose wrench follows from the state.
    """
    if not chain.grasps:
        return np.zeros((len(chain.arms), 6))
    places = contact_places(chain, state)
    push, none = np.array([0.0, 0.0, 0.0, 0.0, 0.0, internal_force]), np.zeros(6)
    soft = [place.grasp.of_kind.compliant for place in places]  # the wrenches of bushings cannot be chosen
    pushes = array([none if of_state else rotate(at.R, push) for at, of_state in zip(places, soft, strict=True)])
    pushed = sum((shift_wrench(at.offset, f) for at, f in zip(places, pushes, strict=True)), start=np.zeros(6))

    still = Inputs().shaped(chain)
    pulled = with_force_elements(chain, state, still).object_wrench
    assert pulled is not None
    offsets = [at.offset for at, of_state in zip(places, soft, strict=True) if of_state]
    for offset, one in zip(offsets, deflections(chain, state, still), strict=True):
        pulled = pulled + shift_wrench(offset, one.wrench())
    body = object_motion(chain.held_object, state.object_frame, state.object_twist, pulled)
    needed = body.inertia.apply(acceleration - pseudo_gravity(chain)) + body.bias - body.wrench
    length = length_scale([grasp.frame.p for grasp in chain.grasps.values()])
    found = pushes + motion_wrenches(places, needed - pushed, length)
    wrenches = dict(zip(chain.grasps, found, strict=True))
    return array([wrenches.get(name, np.zeros(6)) for name in chain.names])
