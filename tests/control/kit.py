"""The laws of the kit for two Pandas with a box, with values of their parameters."""

from __future__ import annotations

import numpy as np

import holdfast as hf
from holdfast.control import (
    HybridForce,
    InternalForce,
    InternalImpedance,
    LoadShare,
    ObjectImpedance,
    ObjectTracking,
    PostureControl,
    RampedForces,
    RestToRest,
    admittance_law,
    cooperative_law,
    observed,
)
from holdfast.forces import ForceCost, ForceLimits
from tests.control.two_pandas import two_pandas

CHAIN, STATE = two_pandas()
N = CHAIN.joint_count
PATH = RestToRest(STATE.object_frame, displacement=[0, 0, 0.1], turn=[0, 0.1, 0.2], duration=1.5)
HERE = RestToRest(STATE.object_frame)
SPRING, DAMPER = np.repeat([20.0, 400.0], 3), np.repeat([2.0, 60.0], 3)  # [N m/rad, N/m], [N m s/rad, N s/m]
MASS = np.repeat([0.1, 5.0], 3)
STIFF = ObjectImpedance(HERE, SPRING, DAMPER)
MEASURED = 20.0 * np.random.default_rng(4).normal(size=(2, 6))
PUSHED = np.array([0.3, -0.2, 0.1, 4.0, -3.0, 5.0])

LAWS = {
    "impedance": (cooperative_law(CHAIN, ObjectImpedance(PATH, SPRING, DAMPER), InternalForce(20.0)), {}),
    "known push": (
        cooperative_law(
            CHAIN, ObjectImpedance(PATH, SPRING, DAMPER, inertia=np.repeat([0.1, 5.0], 3)), InternalForce([5.0, 9.0])
        ),
        {"external_wrench": PUSHED},
    ),
    "posture": (cooperative_law(CHAIN, STIFF, posture=PostureControl(STATE.q + 0.1, 4.0, clearance=0.2)), {}),
    "given shares": (cooperative_law(CHAIN, STIFF, LoadShare({"left": 0.7, "right": 0.3}, 20.0)), {}),
    "shares by reserve": (cooperative_law(CHAIN, STIFF, LoadShare(force=20.0)), {}),
    "ramp": (cooperative_law(CHAIN, STIFF, RampedForces(InternalForce(5.0), LoadShare(force=20.0), 0.1, 0.5)), {}),
    "internal impedance": (cooperative_law(CHAIN, STIFF, InternalImpedance(500.0, 20.0, InternalForce(20.0))), {}),
    "hybrid": (
        cooperative_law(CHAIN, STIFF, HybridForce(100.0, 1e-3, InternalForce(20.0), limit=30.0)),
        {"measured_wrenches": MEASURED},
    ),
    "hybrid, simulated sensor": (
        cooperative_law(CHAIN, STIFF, HybridForce(100.0, 1e-3, InternalForce(20.0), sensor=CHAIN)),
        {},
    ),
    "limits": (
        cooperative_law(
            CHAIN,
            ObjectImpedance(PATH, SPRING, DAMPER),
            InternalForce(20.0),
            PostureControl(STATE.q + 0.1),
            limits=ForceLimits(0.8, most_normal=60.0, sample_time=1e-3),
            cost=ForceCost(wrench=1.0),
        ),
        {},
    ),
    "hybrid, limits": (
        cooperative_law(
            CHAIN,
            STIFF,
            HybridForce(100.0, 1e-3, InternalForce(20.0)),
            limits=ForceLimits(),
            cost=ForceCost(wrench=1e2),
        ),
        {"measured_wrenches": MEASURED},
    ),
    "admittance": (
        admittance_law(
            CHAIN,
            PATH,
            stiffness=SPRING,
            damping=DAMPER,
            inertia=MASS,
            internal_damping=1000.0,
            contact_stiffness=5e5,
            sample_time=1e-3,
            force=20.0,
            posture=PostureControl(STATE.q + 0.2, 1.0, clearance=0.2),
        ),
        {"measured_wrenches": MEASURED},
    ),
    "observer": (observed(ObjectTracking(CHAIN, PATH, 20.0), CHAIN, gain=30.0, sample_time=1e-3), {}),
    "observer feeds impedance": (
        observed(
            cooperative_law(CHAIN, ObjectImpedance(PATH, SPRING, DAMPER, MASS), InternalForce(20.0)),
            CHAIN,
            gain=30.0,
            sample_time=1e-3,
        ),
        {},
    ),
    "observer at wrists": (
        observed(ObjectTracking(CHAIN, PATH, 20.0), CHAIN, gain=30.0, sample_time=1e-3, measured=True),
        {"measured_wrenches": MEASURED},
    ),
}


def moving(seed: int, chain: hf.ClosedChain = CHAIN, state: hf.State = STATE) -> hf.State:
    """Return a closed state near one, in motion."""
    random = np.random.default_rng(seed)
    twist = 0.2 * random.normal(size=6)
    guess = hf.State(state.q, 0.3 * random.normal(size=N), state.object_pose, twist)
    return hf.dynamics.project_velocity(chain, guess, hold_object=True)
