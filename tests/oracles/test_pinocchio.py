"""Pinocchio, an independent library, computes the same arms and the same closed chains."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Pose, State, forward_dynamics
from holdfast.dynamics import project_velocity
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmInputs, arm_motion
from holdfast.robots import HOME, panda
from tests.systems import random_system
from tests.systems.as_chain import as_chain, mounted
from tests.systems.problems import random_problem, relative_gap
from tests.systems.random_parts import inertia_about_com, rotation, unit_vector

pin = pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")

from tests.oracles.pinocchio_model import RigidChain, arm_model, swapped  # noqa: E402  (needs pinocchio)

ARM_TOLERANCE = 1e-12
CHAIN_TOLERANCE = 1e-10
STATES = 50
GRAVITIES = (np.array([0.0, 0.0, -9.81]), np.array([3.0, -4.0, 8.0]), np.zeros(3))


def random_pose(rng: np.random.Generator) -> Pose:
    """Return a pose within a metre or so."""
    return Pose(rotation(rng), 0.5 * rng.normal(size=3))


def arm_gaps(arm: Arm, q, qd, gravity) -> dict[str, float]:
    """Return how far M, J and the bias torques are from Pinocchio's."""
    at_rest = np.zeros(6)
    given = ArmInputs(arm, q, qd, np.zeros(len(q)), at_rest, np.concatenate([np.zeros(3), -gravity]))
    motion = arm_motion(given)
    model, tip = arm_model(arm, gravity)
    data = model.createData()
    M = np.array(pin.crba(model, data, q))
    M = np.triu(M) + np.triu(M, 1).T  # crba fills the upper half
    J = np.array(pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)).reshape(6, -1)
    return {
        "M": relative_gap(mass_matrix(arm, motion.at)[0], M),
        "J": relative_gap(jacobian(arm, motion.at), swapped(J)),
        "bias": relative_gap(bias_torque(arm, motion.at, motion.bias.wrenches)[0], pin.nle(model, data, q, qd)),
    }


def worst(gaps: list[dict[str, float]]) -> dict[str, float]:
    """Return the largest gap of each quantity."""
    return {key: max(gap[key] for gap in gaps) for key in gaps[0]}


def show(what: str, gaps: dict[str, float]) -> None:
    """Print the worst relative differences (pytest -s)."""
    print(f"\n{what} against Pinocchio {pin.__version__}: " + ", ".join(f"{k} {v:.1e}" for k, v in gaps.items()))


def test_panda():
    """Mass matrix with armature, Jacobian and bias torques of the Panda."""
    gaps = []
    for seed in range(STATES):
        rng = np.random.default_rng(seed)
        arm = panda(random_pose(rng), random_pose(rng), armature=rng.uniform(0, 0.6, size=7))
        q = rng.uniform(*arm.position_limits.T)
        gaps.append(arm_gaps(arm, q, rng.normal(size=7), GRAVITIES[seed % 2]))
    show("panda", worst(gaps))
    assert max(worst(gaps).values()) <= ARM_TOLERANCE


def test_random_arms():
    """Arms of 1 to 12 joints, revolute and prismatic, any axes and placements, with armature."""
    gaps = []
    for seed in range(STATES):
        p = as_chain(random_system(1000 + seed, arms=1, joints=1 + seed % 12, grasps="rigid"))
        gaps.append(arm_gaps(p.chain.arms["arm1"], p.state.q, p.state.qd, GRAVITIES[seed % 2]))
    show("random arms", worst(gaps))
    assert max(worst(gaps).values()) <= ARM_TOLERANCE


def carried(rng: np.random.Generator, arms: dict[str, Arm], q: np.ndarray, gravity) -> tuple[ClosedChain, State]:
    """Return arms mounted so that they hold a random box rigidly, and a consistent state."""
    frame = random_pose(rng)
    box = HeldObject(rng.uniform(1.0, 8.0), inertia_about_com(rng, 4.0, 0.4), 0.05 * rng.normal(size=3))
    grasps = {name: Grasp("rigid", Pose(rotation(rng), 0.3 * unit_vector(rng))) for name in arms}
    chain = mounted(ClosedChain(arms, box, grasps, gravity), q, frame)
    rough = State(q, rng.normal(size=len(q)), frame.wxyz_xyz, rng.normal(size=6))
    return chain, project_velocity(chain, project_velocity(chain, rough))


def chain_gaps(chain: ClosedChain, state: State, tau) -> dict[str, float]:
    """Return how far accelerations and grasp wrenches are from Pinocchio's."""
    ours = forward_dynamics(chain, state, tau)
    qdd, acceleration, wrenches = RigidChain(chain).forward_dynamics(state, tau)
    return {
        "qdd": relative_gap(ours.qdd, qdd),
        "object acceleration": relative_gap(ours.object_acceleration, acceleration),
        "grasp force": relative_gap(ours.grasp_wrench[:, 3:], wrenches[:, 3:]),
        "grasp moment": relative_gap(ours.grasp_wrench[:, :3], wrenches[:, :3]),
    }


def test_two_pandas_hold_a_box():
    """Rigid grasps against `constraintDynamics` with its default proximal settings."""
    gaps = []
    for seed in range(STATES):
        rng = np.random.default_rng(2000 + seed)
        arms = {name: panda(armature=rng.uniform(0, 0.6, size=7)) for name in ("left", "right")}
        q = np.concatenate([HOME["panda"] + rng.uniform(-0.7, 0.7, size=7) for _ in arms])
        chain, state = carried(rng, arms, q, GRAVITIES[seed % 3])
        gaps.append(chain_gaps(chain, state, 20.0 * rng.normal(size=14)))
    show("two pandas and a box", worst(gaps))
    assert max(worst(gaps).values()) <= CHAIN_TOLERANCE


@pytest.mark.slow
def test_three_random_arms_hold_an_object():
    """The same for three arms of 7 to 9 joints, prismatic ones among them, with armature."""
    gaps = []
    for seed in range(STATES // 2):
        options = {"joints": (7, 8, 9), "grasps": "rigid", "moving_base": False, "extras": False}
        p = random_problem(seed, **options, gravity=tuple(GRAVITIES[seed % 3]))
        heavy = {
            name: replace(arm, joints=[replace(j, armature=0.05 * (k + 1)) for k, j in enumerate(arm.joints)])
            for name, arm in p.chain.arms.items()
        }
        gaps.append(chain_gaps(replace(p.chain, arms=heavy), p.state, p.tau))
    show("three random arms", worst(gaps))
    assert max(worst(gaps).values()) <= CHAIN_TOLERANCE
