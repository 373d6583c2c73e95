"""Two arms with a box above a table, under an impedance that lowers it into the table."""

import dataclasses

import numpy as np

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, RestToRest, cooperative_law
from holdfast.spatial import rotation
from holdfast.world import HalfSpace, Touching, corners

TABLE, HEIGHT, STIFFNESS = 0.28, 0.4, 800.0  # m, m, N/m


def lowering(path, duration=0.5, turned=None):
    """Return chain, state and law of two Pandas that move a box of 0.3 x 0.3 x 0.2 m, 3 kg.

    Args:
        path: displacement (3,) [m].
        duration: of the path [s].
        turned: rotation (3,) of the box at the start [rad].
    """
    at, arms, grasps = hf.Pose.translation, {}, {}
    for arm, y in {"left": 1, "right": -1}.items():
        arms[arm] = hf.robots.panda(at(0, 0.35 * y, 0))
        grasps[arm] = hf.Grasp("rigid", hf.contact_frame([0, 0.15 * y, 0], into=[0, -y, 0]))
    box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.3, z=0.2)
    R = np.eye(3) if turned is None else rotation.exp(np.asarray(turned))
    chain, state = hf.assemble(arms, box, grasps, object_pose=hf.Pose(R, np.array([0.55, 0.0, HEIGHT])))
    table = HalfSpace(normal=[0, 0, 1], offset=TABLE, friction=0.4)
    chain = dataclasses.replace(chain, touching=Touching(points=corners(0.3, 0.3, 0.2), world={"table": table}))
    motion = ObjectImpedance(
        RestToRest(state.object_frame, path, duration=duration),
        np.repeat([20.0, STIFFNESS], 3),
        np.repeat([8.0, 150.0], 3),
    )
    return chain, state, cooperative_law(chain, motion, InternalForce(30.0))
