"""Contacts of one object in holdfast, MuJoCo and Drake: scenes, and what comes of them; see `contact_figure`."""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

import holdfast as hf
from benchmarks.bench.mujoco_peer import mjcf
from holdfast.control import InternalForce, ObjectImpedance, RestToRest, cooperative_law
from holdfast.interop.mjcf_writer import HARDEST, coordinates
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.world import HalfSpace, Sphere, Touching

STEP, G, RADIUS, MU, TILT = 1e-3, 9.81, 5e-3, 0.5, np.radians(15.0)
MANY = 512  # systems that a rollout takes together
EDGES, MASS = np.array([0.2, 0.2, 0.1]), 1.0  # m, kg
LEAN, SPEED = 0.3, 1.0  # rad, m/s: of the box that strikes with an edge
PRESS = 5e-3  # m below the table, where the arms' impedance rests
BEGINS, ENDS = 1.0, 2.0  # s: creep is measured between them
DEFAULT, HARD = "defaults", "hardest"


class Scene(NamedTuple):
    """A free box above a plane through the origin.

    Attributes:
        name: as above.
        normal: of the plane.
        pose: the box at the start.
        twist: likewise, [omega; v].
        duration: [s].
    """

    name: str
    normal: Array
    pose: hf.Pose
    twist: Array
    duration: float


class Course(NamedTuple):
    """What came of a scene.

    Attributes:
        who: simulator and settings.
        scene: its name.
        pose: (steps, 7) of the object after every step, wxyz_xyz.
        twist: (steps, 6).
        gap: (steps,) of the lowest point [m].
        force: (steps,) net normal force of the plane [N].
        cost: processor time of a step [s].
        together: the same of each of `MANY` systems; None if it was not tried.
    """

    who: str
    scene: str
    pose: Array
    twist: Array
    gap: Array
    force: Array
    cost: float
    together: float | None = None

    @property
    def t(self) -> Array:
        """(steps,) [s]."""
        return STEP * np.arange(1, len(self.gap) + 1)


def points_of(edges: Array) -> Array:
    """Return the centres of spheres in the corners of a box, (8, 3)."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * (0.5 * edges - RADIUS)


def scenes() -> list[Scene]:
    """Return the scenes without arms."""
    up, half = np.array([0.0, 0.0, 1.0]), 0.5 * EDGES[2]
    leaning = rotation.exp(np.array([0.0, LEAN, 0.0]))
    lowest = (points_of(EDGES) @ leaning.T)[:, 2].min() - RADIUS
    down = rotation.exp(np.array([0.0, TILT, 0.0]))
    falls = np.array([0, 0, 0, 0, 0, -SPEED])
    return [
        Scene("slope", down @ up, hf.Pose(down, half * (down @ up)), np.zeros(6), ENDS),
        Scene("table", up, hf.Pose.translation(0, 0, half + 0.02), np.zeros(6), 0.3),
        Scene("edge", up, hf.Pose(leaning, np.array([0.0, 0.0, 5e-3 - lowest])), falls, 0.05),
    ]


def body() -> hf.HeldObject:
    """Return the box."""
    return hf.HeldObject.box(MASS, *EDGES)


def touching(normal: Array, edges: Array, offset: float = 0.0) -> Touching:
    """Return its points and the plane."""
    spheres = {f"p{k}": Sphere(p, RADIUS) for k, p in enumerate(points_of(edges))}
    return Touching(spheres, {"plane": HalfSpace(normal=normal, offset=offset, friction=MU)})


def gap_of(pose: Array, normal: Array, edges: Array, offset: float = 0.0) -> float:
    """Return the distance of the lowest point from the plane [m]."""
    at = points_of(edges) @ rotation.from_quaternion(pose[:4]).T + pose[4:]
    return float((at @ normal).min()) - RADIUS - offset


def by_holdfast(scene: Scene) -> Course:
    """Return the steps of a rollout of one system."""
    chain = hf.ClosedChain({}, body(), {}, touching=touching(scene.normal, EDGES))
    start = hf.State([], [], scene.pose, scene.twist)
    return rolled_out(scene.name, hf.compile_rollout(chain), start, scene.duration, scene.normal)


def rolled_out(name: str, rollout: hf.simulation.Rollout, state: hf.State, duration: float, normal: Array) -> Course:
    """Return the steps of a rollout of one system; costs are those without a record, and include the law."""
    recorded, steps = ("object_pose", "object_twist", "touch_force", "touch_gap"), round(duration / STEP)

    def start(count: int) -> Any:
        return rollout.start(np.tile(state.q, (count, 1)), state.qd, state.object_pose, state.object_twist)

    def cost(count: int) -> float:
        systems, begun = start(count), time.process_time()
        rollout.step(systems, STEP, steps=steps, threads=1)
        return (time.process_time() - begun) / (steps * count)

    record = rollout.run(start(1), duration, STEP, record=recorded)
    pose, twist, force, gap = (record[each][1:, 0] for each in recorded)
    return Course("holdfast", name, pose, twist, gap.min(axis=1), force.sum(axis=1) @ normal, cost(1), cost(MANY))


def hardened(model: Any, mujoco: Any) -> None:
    """Give MuJoCo's contacts the hardest settings of a step: twice the step as time constant, full impedance."""
    model.geom_solref[:] = 2.0 * STEP, 1.0
    model.geom_solimp[:] = HARDEST, HARDEST, 0.001, 0.5, 2.0
    model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 100.0
    model.opt.noslip_iterations, model.opt.iterations = 20, 200


def geoms(root: Any, held: Any, edges: Array, plane: dict[str, str]) -> None:
    """Add the plane, and the points of a box, to a model without geoms that collide."""
    friction = {"friction": f"{MU} 0 0", "condim": "3", "contype": "1", "conaffinity": "1"}
    world = root.find("worldbody")
    ElementTree.SubElement(world, "geom", {"name": "plane", "type": "plane", "size": "5 5 0.1", **plane, **friction})
    for p in points_of(edges):
        at = " ".join(map(repr, p.tolist()))
        ElementTree.SubElement(held, "geom", {"type": "sphere", "size": repr(RADIUS), "pos": at, **friction})


def mujoco_model(chain: hf.ClosedChain, edges: Array, plane: dict[str, str], settings: str) -> tuple[Any, Any]:
    """Return MuJoCo's model of a chain whose object may touch a plane, and its data."""
    mujoco: Any = import_module("mujoco")
    root = ElementTree.fromstring(mjcf(chain, "Newton", "dense"))
    option = root.find("option")
    assert option is not None
    option.attrib.update(timestep=repr(STEP), integrator="implicitfast")
    flag = option.find("flag")
    assert flag is not None
    flag.set("contact", "enable")
    held = next(one for one in root.iter("body") if one.get("name") == "object")
    geoms(root, held, edges, plane)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    if len(chain.grasps):
        model.eq_solref[:] = 2.0 * STEP, 1.0
    if settings == HARD:
        hardened(model, mujoco)
    return model, mujoco.MjData(model)


def mujoco_force(model: Any, data: Any) -> float:
    """Return the net normal force of the plane [N]."""
    mujoco: Any = import_module("mujoco")
    found, total = np.zeros(6), 0.0
    for k in range(data.ncon):
        mujoco.mj_contactForce(model, data, k, found)
        total += float(found[0])
    return total


def by_mujoco(scene: Scene, settings: str) -> Course:
    """Return MuJoCo's steps of a free box."""
    mujoco: Any = import_module("mujoco")
    chain = hf.ClosedChain({}, body(), {})
    turned = hf.Pose(rotation.exp(np.array([0.0, np.arctan2(scene.normal[0], scene.normal[2]), 0.0])), np.zeros(3))
    plane = {"quat": " ".join(map(repr, turned.wxyz_xyz[:4].tolist()))}
    model, data = mujoco_model(chain, EDGES, plane, settings)
    data.qpos[:], data.qvel[:] = coordinates(chain, hf.State([], [], scene.pose, scene.twist))
    poses, twists, forces, spent = [], [], [], 0.0
    for _ in range(round(scene.duration / STEP)):
        begun = time.process_time()
        mujoco.mj_step(model, data)
        spent += time.process_time() - begun
        pose = np.concatenate([data.qpos[3:], data.qpos[:3]])
        poses.append(pose)
        twists.append(np.concatenate([rotation.from_quaternion(pose[:4]) @ data.qvel[3:], data.qvel[:3]]))
        forces.append(mujoco_force(model, data))
    who = f"MuJoCo {mujoco.__version__}, {settings}"
    return course(who, scene, poses, twists, forces, spent)


def by_drake(scene: Scene, settings: str) -> Course:
    """Return the steps of Drake's discrete MultibodyPlant."""
    name = "pydrake.multibody"
    plant_of, tree = import_module(f"{name}.plant"), import_module(f"{name}.tree")
    framework, analysis = import_module("pydrake.systems.framework"), import_module("pydrake.systems.analysis")
    geometry, at = import_module("pydrake.geometry"), import_module("pydrake.math").RigidTransform
    builder = framework.DiagramBuilder()
    plant: Any = plant_of.AddMultibodyPlantSceneGraph(builder, time_step=STEP)[0]
    plant.set_contact_model(plant_of.ContactModel.kPoint)
    if settings == HARD:
        plant.set_penetration_allowance(1e-6)
        plant.set_stiction_tolerance(1e-6)
    rotational = np.diag(body().inertia) / MASS
    inertia = tree.SpatialInertia(MASS, np.zeros(3), tree.UnitInertia(*rotational))
    box, friction = plant.AddRigidBody("box", inertia), plant_of.CoulombFriction(MU, MU)
    for k, p in enumerate(points_of(EDGES)):
        plant.RegisterCollisionGeometry(box, at(p), geometry.Sphere(RADIUS), f"p{k}", friction)
    plane = geometry.HalfSpace.MakePose(scene.normal, np.zeros(3))
    plant.RegisterCollisionGeometry(plant.world_body(), plane, geometry.HalfSpace(), "plane", friction)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyMutableContextFromRoot(context)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scene.pose.R, scene.pose.p
    plant.SetFreeBodyPose(own, box, at(matrix))
    velocity = import_module("pydrake.multibody.math").SpatialVelocity
    plant.SetFreeBodySpatialVelocity(own, box, velocity(scene.twist[:3], scene.twist[3:]))
    simulator = analysis.Simulator(diagram, context)
    simulator.Initialize()
    poses, twists, forces, spent = [], [], [], 0.0
    for k in range(round(scene.duration / STEP)):
        begun = time.process_time()
        simulator.AdvanceTo((k + 1) * STEP)
        spent += time.process_time() - begun
        poses.append(plant.GetPositions(own).copy())
        twists.append(plant.GetVelocities(own).copy())
        found = plant.get_contact_results_output_port().Eval(own)
        pairs = [found.point_pair_contact_info(i) for i in range(found.num_point_pair_contacts())]
        # on body B, which is the plane or the box
        forces.append(sum(abs(float(np.dot(one.contact_force(), scene.normal))) for one in pairs))
    version = import_module("importlib.metadata").version("drake")
    return course(f"Drake {version}, {settings}", scene, poses, twists, forces, spent)


def course(
    who: str, scene: Scene, poses: list[Array], twists: list[Array], forces: list[float], spent: float
) -> Course:
    """Return a course, with its gaps."""
    gap = np.array([gap_of(pose, scene.normal, EDGES) for pose in poses])
    return Course(who, scene.name, np.array(poses), np.array(twists), gap, np.array(forces), spent / len(poses))


LOW = np.array([0.3, 0.3, 0.2])  # m: the box of the arms
TABLE = 0.28  # m
LASTS = 0.8  # s


def landing() -> tuple[hf.ClosedChain, hf.State, Any]:
    """Return two Pandas with a tilted box above a table, and the law that lowers it to `PRESS` below its surface."""
    at, arms, grasps = hf.Pose.translation, {}, {}
    for arm, y in {"left": 1, "right": -1}.items():
        arms[arm] = hf.robots.panda(at(0, 0.35 * y, 0))
        grasps[arm] = hf.Grasp("rigid", hf.contact_frame([0, 0.15 * y, 0], into=[0, -y, 0]))
    box, place = hf.HeldObject.box(3.0, *LOW), hf.Pose.from_rpy(0, 0.06, 0, xyz=[0.55, 0, 0.4])
    chain, state = hf.assemble(arms, box, grasps, object_pose=place)
    path = RestToRest(state.object_frame, [0, 0, -0.02 - PRESS], [0, -0.06, 0], duration=0.5)
    motion = ObjectImpedance(path, np.repeat([20.0, 800.0], 3), np.repeat([8.0, 150.0], 3))
    return chain, state, cooperative_law(chain, motion, InternalForce(30.0))


def arms_by_holdfast() -> Course:
    """Return the steps of a rollout under the law."""
    bare, state, law = landing()
    normal = np.array([0.0, 0.0, 1.0])
    chain = hf.ClosedChain(bare.arms, bare.held_object, bare.grasps, touching=touching(normal, LOW, TABLE))
    return rolled_out("arms", hf.compile_rollout(chain, law), state, LASTS, normal)


def arms_by_mujoco(settings: str) -> Course:
    """Return MuJoCo's steps under the same law; its cost does not include the law."""
    mujoco: Any = import_module("mujoco")
    chain, state, law = landing()
    model, data = mujoco_model(chain, LOW, {"pos": f"0 0 {TABLE}"}, settings)
    data.qpos[:], data.qvel[:] = coordinates(chain, state)
    poses, twists, forces, spent, n = [], [], [], 0.0, chain.joint_count
    for k in range(round(LASTS / STEP)):
        pose, v = np.concatenate([data.qpos[n + 3 :], data.qpos[n : n + 3]]), data.qvel[n:]
        twist = np.concatenate([rotation.from_quaternion(pose[:4]) @ v[3:], v[:3]])
        now = hf.State(data.qpos[:n].copy(), data.qvel[:n].copy(), pose, twist)
        data.qfrc_applied[:n] = law(k * STEP, now, None)[0]
        begun = time.process_time()
        mujoco.mj_step(model, data)
        spent += time.process_time() - begun
        poses.append(np.concatenate([data.qpos[n + 3 :], data.qpos[n : n + 3]]))
        twists.append(twist)
        forces.append(mujoco_force(model, data))
    gap = np.array([gap_of(pose, np.array([0.0, 0.0, 1.0]), LOW, TABLE) for pose in poses])
    who = f"MuJoCo {mujoco.__version__}, {settings}"
    return Course(who, "arms", np.array(poses), np.array(twists), gap, np.array(forces), spent / len(poses))


def rate_on_paper(scene: Scene) -> float:
    """Return the turning rate right after a box strikes with an edge, without restitution [rad/s].

    In the plane, the impulse J at r from C makes the edge's velocity zero, or slips with |J_x| = mu J_z:

        v + J / m + (w x r) = 0,  w = (r_z J_x - r_x J_z) / I.
    """
    at = points_of(EDGES) @ scene.pose.R.T
    x, _, z = at[np.argmin(at[:, 2])] - [0.0, 0.0, RADIUS]
    height = gap_of(scene.pose.wxyz_xyz, scene.normal, EDGES)
    speed, I = np.sqrt(SPEED**2 + 2 * G * height), body().inertia[1, 1]
    admittance = np.array([[1 / MASS + z * z / I, -x * z / I], [-x * z / I, 1 / MASS + x * x / I]])
    J = np.linalg.solve(admittance, [0.0, speed])
    if abs(J[0]) > MU * J[1]:
        side = np.sign(J[0])
        J[1] = speed / (admittance[1] @ [side * MU, 1.0])
        J[0] = side * MU * J[1]
    return float((z * J[0] - x * J[1]) / I)
