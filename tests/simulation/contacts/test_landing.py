"""Two arms under an impedance lay a box flat on a table: four redundant contacts, by steps."""

import dataclasses

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, RestToRest, cooperative_law
from holdfast.world import HalfSpace, Touching, corners

PRESS, STIFFNESS = 0.005, 800.0  # m below the table, N/m


@pytest.mark.long
def test_two_pandas_lay_a_box_flat_on_a_table():
    """The run is complete, gaps and grasps stay closed, and at rest the table carries what the spring presses."""
    at, arms, grasps = hf.Pose.translation, {}, {}
    for arm, y in {"left": 1, "right": -1}.items():
        arms[arm] = hf.robots.panda(at(0, 0.35 * y, 0))
        grasps[arm] = hf.Grasp("rigid", hf.contact_frame([0, 0.15 * y, 0], into=[0, -y, 0]))
    box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.3, z=0.2)
    chain, state = hf.assemble(arms, box, grasps, object_pose=at(0.55, 0, 0.4))
    table = HalfSpace(normal=[0, 0, 1], offset=0.28, friction=0.4)
    chain = dataclasses.replace(chain, touching=Touching(points=corners(0.3, 0.3, 0.2), world={"table": table}))
    path = RestToRest(state.object_frame, [0, 0, -0.02 - PRESS], duration=0.5)
    motion = ObjectImpedance(path, np.repeat([20.0, STIFFNESS], 3), np.repeat([8.0, 150.0], 3))
    law = cooperative_law(chain, motion, InternalForce(30.0))
    run = hf.simulate(chain, state, law, 0.8, 0.001, contacts="steps")
    assert run.stopped is None
    assert run.touch_gap.min() >= -1e-12
    assert run.position_gap[:, 1].max() <= 1e-12  # after projection
    assert run.touch_force[-1, :, 2].sum() == pytest.approx(STIFFNESS * PRESS, rel=1e-3)
    assert (
        np.abs(run.object_twist[-1]).max() <= 1e-5
    )  # redundant joints still settle: ends of steps are of second order
