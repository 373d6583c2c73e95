"""The laws of a scene are those that its keys describe in Python, and what cannot be is refused with its place."""

from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli import main
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
    cooperative_law,
    observed,
)
from holdfast.control.timed_path import TimedPath
from holdfast.forces import ForceCost, ForceLimits
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.scenario import controller_tables
from holdfast.scenario.controllers import MAKERS
from holdfast.scenario.table import KeyTable
from tests.scenario.test_build import changed, loaded, refusal

LIFT = (Path(__file__).parents[2] / "examples" / "box_lift.toml").read_text()
K, D = np.repeat([20.0, 400.0], 3), np.repeat([8.0, 100.0], 3)
TYPE, LIMITS, STEP = 'type = "cooperative_law"', "limits = { effort = 0.8, least_margin = 2.0 }", "step = 0.002"
POSTURE = 'posture = { rest = "start", clearance = 0.1 }'
SAMPLED = f"{STEP}\nsample_time = 0.002"


def law_with(keys: str, *, sampled: bool = False) -> str:
    """Return the example's text whose law has these keys beside its motion."""
    text = changed(LIMITS, "", changed(POSTURE, keys, LIFT))
    return changed(STEP, SAMPLED, text) if sampled else text


def motion_of(state: hf.State, **more) -> ObjectImpedance:
    """Return the motion of the example."""
    return ObjectImpedance(RestToRest(state.object_frame, displacement=[0, 0, 0.2], duration=0.8), K, D, **more)


def alike(law, other) -> None:
    """Both are made of the same numbers, and have the same memory and parameters."""
    assert exact_fingerprint(law.torque) == exact_fingerprint(other.torque) is not None
    assert law.memory.tolist() == other.memory.tolist() and law.parameters == other.parameters


RAMP = """{ type = "ramped_forces", begin = 0.1, duration = 0.3, before = { type = "internal_force", force = [30, 30] },
 after = { type = "load_share", shares = { left = 1.0 }, force = 40 } }""".replace("\n", "")
SPRINGS = """{ type = "internal_impedance", stiffness = [1, 1, 1, 90, 90, 90], damping = 3.0,
 around = { type = "internal_force", force = [[0, 0, 0, 0, 0, 30.0], [0, 0, 0, 0, 0, 20.0]] } }""".replace("\n", "")
FORCES = {
    "push": ('{ type = "internal_force", force = 20 }', lambda _: InternalForce(20.0)),
    "share": ('{ type = "load_share" }', lambda _: LoadShare()),
    "ramp": (RAMP, lambda _: RampedForces(InternalForce([30.0, 30.0]), LoadShare({"left": 1.0}, 40.0), 0.1, 0.3)),
    "springs": (
        SPRINGS,
        lambda _: InternalImpedance(np.repeat([1.0, 90.0], 3), 3.0, InternalForce(np.outer([30, 20], np.eye(6)[5]))),
    ),
    "integral": (
        f'{{ type = "hybrid_force", gain = 100, limit = 15, late = true, around = {RAMP} }}',
        lambda chain: HybridForce(100.0, 0.002, FORCES["ramp"][1](chain), 15.0, True, chain),
    ),
}


@pytest.mark.parametrize("name", FORCES)
def test_forces(name, tmp_path):
    """Grasp forces of every type are those of the class with the same arguments."""
    written, forces = FORCES[name]
    scene = loaded(tmp_path, law_with(f"forces = {written}", sampled=name == "integral"))
    alike(scene.controller, cooperative_law(scene.chain, motion_of(scene.state), forces(scene.chain)))


def test_limits_cost_and_posture(tmp_path):
    """So are posture, limits and cost; `joint_limits` are those of the simulation's samples."""
    keys = """posture = { rest = "start", frequency = 4.0, clearance = 0.2 }
limits = { effort = 0.7, least_margin = { left = 2 }, most_normal = 90, joint_limits = true, braking = 8.0,\
 acceleration = { "left/joint4" = [-5, 6] } }
cost = { wrench = 2.0, price = 1e4 }"""
    scene = loaded(tmp_path, law_with(keys, sampled=True))
    limits = ForceLimits(
        effort=0.7,
        least_margin={"left": 2.0},
        most_normal=90.0,
        acceleration={"left/joint4": (-5.0, 6.0)},
        sample_time=0.002,
        braking=8.0,
    )
    cost = ForceCost(wrench=2.0, acceleration=1.0, price=1e4)
    posture = PostureControl(scene.state.q, 4.0, 0.2)
    law = cooperative_law(scene.chain, motion_of(scene.state), posture=posture, limits=limits, cost=cost)
    alike(scene.controller, law)
    usual = loaded(tmp_path, law_with(LIMITS)).controller
    alike(usual, cooperative_law(scene.chain, motion_of(scene.state), limits=ForceLimits(0.8, 2.0)))


@pytest.mark.slow
def test_a_push_is_observed(tmp_path):
    """An observer finds the push; with an inertia of its own the box gives way to it as a mass on a spring does."""
    text = law_with("observer = { gain = 100.0, threshold = 4.0 }", sampled=True)
    text = changed("damping = [8.0", "inertia = [0.2, 0.2, 0.2, 5.0, 5.0, 5.0]\ndamping = [8.0", text)
    text = changed("displacement = [0.0, 0.0, 0.2]", "displacement = [0, 0, 0]", text).replace("softfinger", "rigid")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("contact"))
    scene = loaded(tmp_path, text + "\n[[wrenches]]\nforce = [0, 8.0, 0]\n")
    mass = np.repeat([0.2, 5.0], 3)
    still = ObjectImpedance(RestToRest(scene.state.object_frame, duration=0.8), K, D, mass)
    law = observed(cooperative_law(scene.chain, still), scene.chain, gain=100.0, sample_time=0.002, threshold=4.0)
    alike(scene.controller, law)
    run = hf.simulate(scene.chain, scene.state, scene.controller, 0.2, 0.002, **scene.options)
    t = run.t[-1]
    decay, turning = D[5] / (2 * mass[5]), np.sqrt(K[5] / mass[5] - (D[5] / (2 * mass[5])) ** 2 + 0j)
    shift = 8.0 / K[5] * (1 - np.exp(-decay * t) * (np.cos(turning * t) + decay / turning * np.sin(turning * t))).real
    # the observer takes some 10 ms to find the push, and the box is lighter until then
    assert run.object_pose[-1, 5] - run.object_pose[0, 5] == pytest.approx(shift, rel=0.05)


@pytest.mark.slow
def test_fastest_path(tmp_path):
    """A path is timed within its limits; the law follows it, and steps end where its acceleration jumps."""
    fastest = "fastest = { effort = 0.5, least_margin = 2.0, nodes = 9 }"
    text = changed("[0.0, 0.0, 0.2], duration = 0.8", f"[0.0, 0.0, 0.1], {fastest}", LIFT)
    text = changed("duration = 1.0", "duration = 0.4", changed(STEP, "step = 0.01", text))
    scene = loaded(tmp_path, changed('rest = "start"', 'rest = "path"', text))
    timed = scene.controller.torque.motion.path.__self__
    assert isinstance(timed, TimedPath) and 0.3 < timed.duration < 0.4
    assert scene.controller.breakpoints == tuple(timed.t)
    run = hf.simulate(scene.chain, scene.state, scene.controller, scene.duration, scene.step, **scene.options)
    assert run.stopped is None
    assert run.object_pose[-1, 6] == pytest.approx(0.72, abs=1e-4)
    limits = np.array([joint.effort_limit for joint in scene.chain.all_joints])
    assert 0.45 < np.abs(run.tau / limits).max() < 0.51  # of the law, whose limit is 0.8; the path's is 0.5
    assert run.margin.min() > 2.0 - 1e-5
    planned = np.array([timed.joints_at(float(t))[0] for t in run.t])
    assert np.abs(run.q - planned).max() < 2e-3  # the joints do what they were timed for
    through = "through = [{ t = 1, position = [0, 0, 0.66] }, { t = 2, position = [0, 0.05, 0.72] }]"
    tracked = f"""[controller]
type = "object_tracking"
internal_force = 40.0
path = {{ {through}, fastest = {{ nodes = 9 }} }}
"""
    scene = loaded(tmp_path, LIFT[: LIFT.index("[controller]")] + tracked + LIFT[LIFT.index("[simulation]") :])
    assert isinstance(scene.controller, ObjectTracking)
    path = scene.controller.path.__self__
    assert np.allclose(path.at(path.duration).pose.p, [0, 0.05, 0.72], atol=1e-12)


@pytest.mark.slow
def test_from_file_to_folder_and_back(tmp_path, cli):
    """A run with memory is the same in one go, and interrupted and resumed; its folder has the scene's law again."""
    keys = f"{POSTURE}\n{LIMITS}\nobserver = {{ gain = 100.0 }}\nforces = {{ type = 'hybrid_force', gain = 50.0 }}"
    path = tmp_path / "law.toml"
    path.write_text(changed("duration = 1.0", "duration = 0.02", law_with(keys, sampled=True)))
    assert main(["simulate", str(path), "--out", str(tmp_path / "run")]) == 0
    scene, run = hf.load_scene(path), hf.load_result(tmp_path / "run").trajectory
    again = hf.simulate(scene.chain, scene.state, scene.controller, scene.duration, scene.step, **scene.options)
    assert (again.tau == run.tau).all()
    kept = hf.load_scene(tmp_path / "run" / "scene.toml")
    alike(kept.controller, scene.controller)


BAD_LAWS = {
    "unknown key": (law_with("limits = { effrot = 0.8 }"), "$.controller.limits: Object contains unknown field"
                    " `effrot`. Did you mean 'effort'?"),
    "unknown type": (law_with("forces = { type = 'internal_forse' }"), "Did you mean 'internal_force'?"),
    "unknown grasp": (law_with("limits = { least_margin = { lefty = 2 } }"),
                      "$.controller.limits.least_margin: no grasp 'lefty'. Did you mean 'left'?"),
    "unknown joint": (law_with('limits = { acceleration = { "left/joint9" = [-1, 1] } }'), "left/joint9"),
    "unknown arm": (law_with("forces = { type = 'load_share', shares = { lefty = 1 } }"),
                    "$.controller.forces: no arm 'lefty' holds the object. Did you mean 'left'?"),
    "shares": (law_with("forces = { type = 'load_share', shares = { left = 0.6 } }"),
               "$.controller.forces.shares: expected the sum 1, got 0.6"),
    "pushes": (law_with("forces = { type = 'internal_force', force = [1, 2, 3] }"), "$.controller.forces: expected a"),
    "stiffness": (changed("stiffness = [20.0, 20.0,", "stiffness = [20.0,", LIFT), "$.controller.motion.stiffness: "),
    "unstable": (law_with("forces = { type = 'hybrid_force', gain = 2000 }", sampled=True),
                 "$.controller.forces.gain: "),
    "integral in continuous time": (law_with("forces = { type = 'hybrid_force', gain = 20 }"),
                                    "$.controller.forces: expected a sampled controller"),
    "integral inside": (law_with("forces = { type = 'internal_impedance', stiffness = 1, damping = 1, around = { type ="
                                 " 'hybrid_force', gain = 20 } }", sampled=True),
                        "$.controller.forces.around: expected grasp forces without memory, got HybridForce"),
    "joint limits in continuous time": (law_with("limits = { joint_limits = true }"),
                                        "$.controller.limits.joint_limits: expected a sampled controller"),
    "observer in continuous time": (law_with("observer = { gain = 20 }"),
                                    "$.controller.observer: expected a sampled controller"),
    "fast observer": (law_with("observer = { gain = 600 }", sampled=True), "$.controller.observer.gain: "),
    "inertia without observer": (changed("stiffness = [20", "inertia = 1.0\nstiffness = [20", LIFT),
                                 "$.controller.motion.inertia: expected controller.observer beside it"),
    "cost without limits": (law_with("cost = { wrench = 1 }"), "$.controller: expected limits with a cost, got none"),
    "weights": (law_with(f"{LIMITS}\ncost = {{ effort = [1.0] }}"), "$.controller.cost.effort: "),
    "rest": (law_with("posture = { rest = [1.0] }"), "$.controller.posture.rest: expected shape (14,), got (1,)"),
    "no joint path": (law_with("posture = { rest = 'path' }"),
                      "$.controller.posture.rest: expected a path that is timed by `fastest`, whose joints are known"),
    "word": (law_with("posture = { rest = 'strat' }"), "$.controller.posture.rest: Invalid enum value 'strat'"),
    "no grasp": (LIFT[: LIFT.index("[[grasps]]")] + LIFT[LIFT.index("[controller]") :],
                 "$.controller: expected arms that hold the object"),
    "late and fastest": (changed("duration = 0.8 }", "begin = 0.1, fastest = {} }", LIFT),
                         "$.controller.motion.path.begin: expected 0, as the fastest timing begins at once, got 0.1"),
    "too fast": (changed("duration = 0.8 }", "fastest = { nodes = 2 } }", LIFT),
                 "$.controller.motion.path.fastest.nodes: "),
    "too weak": (changed("duration = 0.8 }", "fastest = { effort = 0.05 } }", LIFT),
                 "$.controller.motion.path.fastest: at s = 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_LAWS)
def test_bad_law_is_refused(case, tmp_path):
    """One line that names the file, the place in it and what is wrong."""
    text, message = BAD_LAWS[case]
    assert message in refusal(tmp_path / "bad.toml", text, 800)


def test_every_table_has_a_maker():
    """Each table of controllers and their parts is made by one row, but for those that their own table reads."""
    tables = {one for one in vars(controller_tables).values() if isinstance(one, type) and issubclass(one, KeyTable)}
    read = {"KeyTable", "_Limits", "PoseTable", "ViaTable", "PieceTable", "ObserverTable"}
    assert {one.__name__ for one in tables - set(MAKERS)} == read
