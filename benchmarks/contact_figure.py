"""Write how contacts of one object come out beside MuJoCo and Drake: a figure, and a table in docs/how_to/contact.md.

    python benchmarks/contact_figure.py [--write docs/how_to/contact.md]

Four scenes with the same bodies, points, friction and steps of 1 ms everywhere; the points are spheres of 5 mm:

slope   a box stands on a slope of 15 degrees, below its angle of friction: it should not move
table   a box falls 20 mm flat onto a table and rests there: no point should be within it
edge    a tilted box strikes the table with an edge, without restitution: the turning rate after that is known
arms    two Pandas under an impedance lower a tilted box onto a table (holdfast and MuJoCo)

MuJoCo and Drake have their defaults, and once hard settings that their manuals suggest for contacts. What is missing of
both is left out: `pip install mujoco-core`, `pip install drake`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.mujoco_peer import mjcf
from holdfast.control import InternalForce, ObjectImpedance, RestToRest, cooperative_law
from holdfast.interop.mjcf_writer import HARDEST, coordinates
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import BLUE, GREEN, ORANGE, SKY, STYLE, VERMILLION
from holdfast.world import HalfSpace, Sphere, Touching

STEP, G, RADIUS, MU, TILT = 1e-3, 9.81, 5e-3, 0.5, np.radians(15.0)
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
    """

    who: str
    scene: str
    pose: Array
    twist: Array
    gap: Array
    force: Array
    cost: float

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
    """Return the run by steps."""
    chain = hf.ClosedChain({}, body(), {}, touching=touching(scene.normal, EDGES))
    start, law = hf.State([], [], scene.pose, scene.twist), lambda t, state, memory: (np.zeros(0), memory)
    begun = time.process_time()
    run = hf.simulate(chain, start, law, scene.duration, STEP, contacts="steps")
    cost = (time.process_time() - begun) / (len(run) - 1)
    force = (run.touch_force[1:].sum(axis=1)) @ scene.normal
    gap = run.touch_gap[1:].min(axis=1)
    return Course("holdfast", scene.name, run.object_pose[1:], run.object_twist[1:], gap, force, cost)


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
    """Return the steps of a rollout; its cost includes the law."""
    bare, state, law = landing()
    normal = np.array([0.0, 0.0, 1.0])
    chain = hf.ClosedChain(bare.arms, bare.held_object, bare.grasps, touching=touching(normal, LOW, TABLE))
    rollout = hf.compile_rollout(chain, law)
    recorded = ("object_pose", "object_twist", "touch_force", "touch_gap")

    def run() -> Any:
        systems = rollout.start(state.q, state.qd, state.object_pose, state.object_twist)
        return rollout.run(systems, LASTS, STEP, record=recorded)

    run()  # compiled
    begun = time.process_time()
    record = run()
    cost = (time.process_time() - begun) / round(LASTS / STEP)
    pose, twist, force, gap = (record[name][1:, 0] for name in recorded)
    return Course("holdfast", "arms", pose, twist, gap.min(axis=1), force[..., 2].sum(axis=1), cost)


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


def courses(report: Callable[[str], None]) -> Iterator[Course]:
    """Yield every course that can be computed here."""
    ways: list[tuple[Callable[..., Course], tuple[object, ...]]] = [(arms_by_holdfast, ())]
    ways += [(by_holdfast, (scene,)) for scene in scenes()]
    for settings in (DEFAULT, HARD):
        ways += [(by, (scene, settings)) for by in (by_mujoco, by_drake) for scene in scenes()]
        ways += [(arms_by_mujoco, (settings,))]
    for way, given in ways:
        try:
            found = way(*given)
        except ImportError as missing:
            report(f"left out: {missing}")
            continue
        report(f"{found.scene}: {found.who}")
        yield found


COLOURS = {"holdfast": (BLUE, "-"), f"MuJoCo {DEFAULT}": (VERMILLION, "-"), f"MuJoCo {HARD}": (ORANGE, "--"),
           f"Drake {DEFAULT}": (GREEN, "-"), f"Drake {HARD}": (SKY, "--")}  # fmt: skip
LEAST = 1e-10  # mm: no creep at all is drawn there
AFTER = 0.003  # s after an impact


def shown(who: str) -> str:
    """Return simulator and settings without its version."""
    name, _, settings = who.partition(", ")
    return f"{name.split()[0]} {settings}".strip()


def creep(one: Course) -> float:
    """Return how fast the box on a slope moves once it has settled [mm/s]."""
    way = np.linalg.norm(one.pose[-1, 4:] - one.pose[round(BEGINS / STEP) - 1, 4:])
    return 1e3 * float(way) / (ENDS - BEGINS)


def after_impact(one: Course) -> float:
    """Return the turning rate shortly after the impact [rad/s]."""
    struck = int(np.argmax(one.force > 0.0))
    return float(one.twist[struck + round(AFTER / STEP), 1])


HEADINGS = ("", "creep on the slope [mm/s]", "deepest when it falls [mm]", "then at rest [mm]", "turning rate [rad/s]",
            "deepest under the arms [mm]", "step of the free box [µs]", "step with two arms [µs]")  # fmt: skip


def table(found: list[Course]) -> str:
    """Return the numbers as a Markdown table."""
    by: dict[str, dict[str, Course]] = {}
    for one in found:
        by.setdefault(one.who, {})[one.scene] = one
    rows = [HEADINGS, ("---",) * len(HEADINGS)]
    for who, of in by.items():
        fall, arms = of["table"], of.get("arms")
        own = depth(fall.gap.min()), depth(fall.gap[-1]), f"{after_impact(of['edge']):.3f}"
        with_arms = ("-", "-") if arms is None else (depth(arms.gap.min()), f"{1e6 * arms.cost:,.0f}")
        rows.append((who, f"{creep(of['slope']):.1e}", *own, with_arms[0], f"{1e6 * fall.cost:,.0f}", with_arms[1]))
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def depth(gap: float) -> str:
    """Return how deep a point is within the plane [mm]."""
    return f"{max(-1e3 * gap, 0.0):.1e}"


def figure(found: list[Course]) -> Any:
    """Return creep, gap, turning rate, and the table's force under the arms."""
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        made = Figure(figsize=(7.0, 4.8), layout="constrained")
        panels = dict(zip(("slope", "table", "edge", "arms"), made.subplots(2, 2).flat, strict=True))
        start = {scene.name: scene.pose.p for scene in scenes()}
        for one in found:
            colour, line = COLOURS[shown(one.who)]
            look: Any = {"color": colour, "linestyle": line, "linewidth": 0.9}
            if one.scene == "slope":
                way = 1e3 * np.linalg.norm(one.pose[:, 4:] - start["slope"], axis=1)
                panels["slope"].semilogy(one.t, np.maximum(way, LEAST), label=shown(one.who), **look)
            elif one.scene == "table":
                panels["table"].plot(one.t, 1e3 * one.gap, **look)
            elif one.scene == "edge":
                panels["edge"].plot(1e3 * one.t, one.twist[:, 1], **look)
            else:
                panels["arms"].plot(one.t, one.force, **look)
        edge = rate_on_paper(next(one for one in scenes() if one.name == "edge"))
        panels["edge"].axhline(edge, color="0.7", linewidth=0.6)
        panels["slope"].set(xlabel="time [s]", title="creep on a slope [mm]")
        panels["table"].set(xlabel="time [s]", title="lowest point of a falling box [mm]")
        panels["table"].set(xlim=(0.05, 0.12), ylim=(-5, 2))
        panels["edge"].set(xlabel="time [ms]", title="turning rate of a box that strikes with an edge [rad/s]")
        panels["edge"].set_xlim(0, 30)
        panels["arms"].set(xlabel="time [s]", title="force of the table under two arms [N]")
        panels["arms"].set(xlim=(0.25, LASTS), ylim=(0, 60))
        made.legend(*panels["slope"].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return made


BEGIN, END = "<!-- peers:begin -->\n", "<!-- peers:end -->\n"


def main() -> None:
    """Compute, print the table, and with `--write` put it into the page and the figure beside it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, help="the page")
    page = parser.parse_args().write
    found = list(courses(lambda text: print(text, file=sys.stderr)))
    made = table(found)
    print(made)
    edge = next(one for one in scenes() if one.name == "edge")
    print(f"on paper it turns at {rate_on_paper(edge):.3f} rad/s right after the impact")
    if page is None:
        return
    before, opened, rest = page.read_text().partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not (opened and closed):
        parser.error(f"{page}: expected {BEGIN.strip()} and after it {END.strip()}")
    page.write_text(f"{before}{BEGIN}{made}{END}{after}")
    figure(found).savefig(Path(__file__).parents[1] / "docs" / "images" / "contact.png", dpi=figure_style.DPI)


if __name__ == "__main__":
    main()
