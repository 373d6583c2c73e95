"""Andrews' squeezing mechanism: seven bodies in a plane and three loops, by its published parameters and figures.

Test Set for IVP Solvers (Bari), problem "Andrews' squeezing mechanism"; E. Hairer and G. Wanner, Solving Ordinary
Differential Equations II, VII.7.
"""

from __future__ import annotations

import numpy as np

import holdfast as hf

M1, M2, M3, M4, M5, M6, M7 = 0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498  # kg
I1, I2, I3, I4, I5, I6, I7 = 2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5  # kg m^2
A, B, C = np.array([-0.06934, -0.00227]), np.array([-0.03635, 0.03273]), np.array([0.014, 0.072])  # m
C0, L0, MOMENT = 4530.0, 0.07785, 0.033  # N/m, m, N m
D, DA, E, EA, RR, RA = 28e-3, 115e-4, 2e-2, 1421e-5, 7e-3, 92e-5  # m
SS, SA, SB, SC, SD, TA, TB = 35e-3, 1874e-5, 1043e-5, 18e-3, 2e-2, 2308e-5, 916e-5
U, UA, UB, ZF, ZT, FA = 4e-2, 1228e-5, 449e-5, 2e-2, 4e-2, 1421e-5
ANGLES = {
    "beta": -0.0617138900142764496358948458001,
    "theta": 0.0,
    "gamma": 0.455279819163070380255912382449,
    "phi": 0.222668390165885884674473185609,
    "delta": 0.487364979543842550225598953530,
    "omega": -0.222668390165885884674473185609,
    "epsilon": 1.23054744454982119249735015568,
}
ACCELERATIONS = dict.fromkeys(ANGLES, 0.0) | {
    "beta": 14222.4439199541138705911625887,
    "theta": -10666.8329399655854029433719415,
}
FIRST_LOOP = [98.5668703962410896057654982170, -6.12268834425566265503114393122]  # N, the first two multipliers
HINGE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # a frame whose x axis is the world's z
# by angle: the body before, where its joint is on it, and the body's mass, mass centre and inertia
BODIES = {
    "beta": (None, (0.0, 0.0), M1, (RA, 0.0), I1),
    "theta": ("beta", (RR, 0.0), M2, (-DA, 0.0), I2),
    "gamma": (None, tuple(B), M3, (SB, -SA), I3),
    "delta": (None, tuple(A), M5, (TA, TB), I5),
    "phi": ("delta", (ZT, 0.0), M4, (0.0, EA - E), I4),
    "epsilon": (None, tuple(A), M7, (-UB, -UA), I7),
    "omega": ("epsilon", (0.0, -U), M6, (ZF - FA, 0.0), I6),
}
POINT = {"theta": (-D, 0.0), "gamma": (0.0, -SS), "phi": (0.0, -E), "omega": (ZF, 0.0)}  # where four bodies meet


def squeezer() -> tuple[hf.ClosedChain, hf.State, np.ndarray, hf.Inputs]:
    """Return the mechanism as one arm with branches and three hinges, its start, its torque, and the spring's pull."""
    names = [*BODIES]
    joints = [hf.Joint(placement=hf.Pose.translation(*at, 0.0), name=name) for name, (_, at, *_) in BODIES.items()]
    links = [
        hf.Link(mass, [*centre, 0.0], np.diag([inertia, inertia, inertia]), name)
        for name, (_, _, mass, centre, inertia) in BODIES.items()
    ]
    frames = {name: hf.Pose(HINGE, [*at, 0.0]) for name, at in POINT.items()}
    loops = {
        loop: hf.Closure("theta", name, hf.Grasp("hinge", frames[name]), frames["theta"])
        for loop, name in (("ground", "gamma"), ("lower", "phi"), ("upper", "omega"))
    }
    arm = hf.Arm(joints, links, parents=[of[0] for of in BODIES.values()], loops=loops)
    chain = hf.ClosedChain({"m": arm}, gravity=np.zeros(3))
    wrenches, s, c = np.zeros((7, 6)), np.sin(ANGLES["gamma"]), np.cos(ANGLES["gamma"])
    arm_of_spring = np.array([SC * s + SD * c, SD * s - SC * c])
    way = B + arm_of_spring - C
    length = np.hypot(*way)
    pull = -C0 * (length - L0) * way / length
    moment = arm_of_spring[0] * pull[1] - arm_of_spring[1] * pull[0]
    wrenches[names.index("gamma")] = [0.0, 0.0, moment, *pull, 0.0]
    tau = np.zeros(7)
    tau[names.index("beta")] = MOMENT
    q = [ANGLES[name] for name in names]
    return chain, hf.State(q, np.zeros(7)), tau, hf.Inputs(link_wrenches=wrenches)
