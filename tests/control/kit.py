"""The laws of the kit for two Pandas with a box, with values of their parameters."""

from __future__ import annotations

import numpy as np

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, Posture, RestToRest, cooperative_law
from tests.control.two_pandas import two_pandas

CHAIN, STATE = two_pandas()
N = CHAIN.joint_count
PATH = RestToRest(STATE.object_frame, displacement=[0, 0, 0.1], turn=[0, 0.1, 0.2], duration=1.5)
HERE = RestToRest(STATE.object_frame)
SPRING, DAMPER = np.repeat([20.0, 400.0], 3), np.repeat([2.0, 60.0], 3)  # [N m/rad, N/m], [N m s/rad, N s/m]
MASS = np.repeat([0.1, 5.0], 3)
STIFF = ObjectImpedance(HERE, SPRING, DAMPER)
PUSHED = np.array([0.3, -0.2, 0.1, 4.0, -3.0, 5.0])

LAWS = {
    "impedance": (cooperative_law(CHAIN, ObjectImpedance(PATH, SPRING, DAMPER), InternalForce(20.0)), {}),
    "known push": (
        cooperative_law(
            CHAIN, ObjectImpedance(PATH, SPRING, DAMPER, inertia=np.repeat([0.1, 5.0], 3)), InternalForce([5.0, 9.0])
        ),
        {"external_wrench": PUSHED},
    ),
    "posture": (cooperative_law(CHAIN, STIFF, posture=Posture(STATE.q + 0.1, 4.0, clearance=0.2)), {}),
}


def moving(seed: int, chain: hf.ClosedChain = CHAIN, state: hf.State = STATE) -> hf.State:
    """Return a closed state near one, in motion."""
    random = np.random.default_rng(seed)
    twist = 0.2 * random.normal(size=6)
    guess = hf.State(state.q, 0.3 * random.normal(size=N), state.object_pose, twist)
    return hf.dynamics.project_velocity(chain, guess, hold_object=True)
