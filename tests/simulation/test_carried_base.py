"""Bases on a table that tilts: how they move, and that seen from the table it is gravity that turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import Pose
from holdfast.control.pose_spline import PoseSpline
from holdfast.errors import ModelError
from holdfast.simulation.carried_base import CarriedBase
from holdfast.spatial import rotation
from tests.control.two_pandas import two_pandas

LEVEL, TILTED = Pose.identity(), Pose.from_rpy(0.3, 0.1, 0.0)
TABLE = PoseSpline([LEVEL, TILTED], [0.0, 0.5])
FRAME = Pose.from_rpy(0.1, 0.2, 0.3, [0.4, -0.2, 0.1])


def test_twist_and_acceleration_are_derivatives():
    """Central differences of the base's pose and twist."""
    base = CarriedBase(TABLE.at, FRAME)
    for t in (0.1, 0.25, 0.4):
        h = 1e-4
        (before, V0, _), (pose, V, a), (after, V1, _) = base(t - h), base(t), base(t + h)
        assert (TABLE.at(t).pose @ FRAME).p == pytest.approx(pose.p, abs=1e-15)
        assert rotation.log(after.R @ before.R.T) / (2 * h) == pytest.approx(V[:3], abs=1e-6)
        assert (after.p - before.p) / (2 * h) == pytest.approx(V[3:], abs=1e-6)
        assert (V1 - V0) / (2 * h) == pytest.approx(a, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("machine_code", [False, True])
def test_a_table_tilts_two_arms(machine_code):
    """Drives as stiff springs hold the arms on it; at its end they bear the gravity that a tilted world would have."""
    chain, state = two_pandas()
    table = TABLE if machine_code else type("Table", (), {"at": lambda self, t: TABLE.at(t)})()
    moving = {name: CarriedBase(table, arm.base) for name, arm in chain.arms.items()}
    assert all(base.traceable == machine_code for base in moving.values())
    hold = hf.holding_torques(chain, state, internal_force=20.0)

    damping = np.tile([40.0, 40.0, 40.0, 40.0, 4.0, 4.0, 1.0], 2)

    def servo(t, now, memory):
        return hold - 800.0 * (now.q - state.q) - damping * now.qd, memory

    run = hf.simulate(chain, state, servo, 0.5 if machine_code else 0.05, 0.001, base_motion=moving)
    assert run.stopped is None
    end = TABLE.at(run.t[-1])
    held = end.pose.inverse() @ Pose.from_wxyz_xyz(run.object_pose[-1])
    assert held.p == pytest.approx(state.object_pose[4:], abs=0.02)  # it went with the table
    if machine_code:
        # the same state seen from the table, where gravity is what has turned
        level = replace(chain, gravity=TILTED.R.T @ chain.gravity)
        twist = run.object_twist[-1].reshape(2, 3) @ TILTED.R
        seen = hf.State(run.q[-1], run.qd[-1], held.wxyz_xyz, twist.ravel())
        found = hf.forward_dynamics(level, seen, run.tau[-1])
        assert found.qdd == pytest.approx(run.qdd[-1], abs=1e-6 * np.abs(run.qdd[-1]).max() + 1e-6)


def test_refused():
    """A motion is a function or a path."""
    with pytest.raises(ModelError, match="carried base: motion: expected a path such as RestToRest"):
        CarriedBase(3.0, FRAME)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ModelError, match="carried base: frame"):
        CarriedBase(TABLE.at, [1.0])
