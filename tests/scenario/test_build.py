"""A scene becomes the chain it describes, closed and at rest; a bad one is refused on one line."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from msgspec import convert

from holdfast import Friction, HeldObject
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.dynamics import closure
from holdfast.errors import ClosureError, SceneError
from holdfast.io.typed import Location
from holdfast.robots import HOME
from holdfast.scenario.build import Scenario, load_scene
from holdfast.scenario.joints import body
from holdfast.scenario.scene import BodyTable
from holdfast.simulation.runge_kutta import SCHEMES
from holdfast.spatial import rotation
from tests.systems.problems import largest_gaps

EXAMPLE = Path(__file__).parents[2] / "examples" / "two_pandas.toml"
TEXT = EXAMPLE.read_text()
SPRINGS = """
[[springs]]
a = { body = "left", link = 6, point = [0, 0, 0.1] }
b = { body = "object" }
stiffness = 40
length = 0.2
damping = 1.5

[[springs]]
a = { body = "world", point = [0, 0, 2] }
b = { body = "object", point = [0, 0, 0.1] }
stiffness = 5
"""

LEFT_ARM = TEXT[TEXT.index('[[arms]]\nname = "left"') : TEXT.index('[[arms]]\nname = "right"')]


def changed(old: str, new: str, text: str = TEXT) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


def loaded(folder: Path, text: str) -> Scenario:
    """Return the scenario of a text."""
    path = folder / "scene.toml"
    path.write_text(text)
    return load_scene(path)


def refusal(path: Path, text: str | bytes, longest: int = 600) -> str:
    """Return the one line that refuses a scene of this text."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said
    assert len(said) <= longest
    return said


def test_example_is_what_it_says():
    """Two Pandas, rigid grasps, closed with the box where the scene has it, at rest."""
    scenario = load_scene(EXAMPLE)
    assert scenario.name == "two pandas lift a box"
    assert scenario.text == TEXT
    assert scenario.chain.names == ("left", "right")
    assert [grasp.kind for grasp in scenario.chain.grasps.values()] == ["rigid", "rigid"]
    assert scenario.chain.held_object.mass == 3.0
    assert scenario.state.object_pose == pytest.approx([1, 0, 0, 0, 0, 0, 0.72])
    assert not scenario.state.qd.any()
    assert largest_gaps(closure(scenario.chain, scenario.state))[0] < 1e-10
    assert isinstance(scenario.controller, ObjectTracking)
    assert scenario.controller.internal_force == 20.0
    # the two arms mirror each other through the box
    assert scenario.state.q[:7] == pytest.approx(scenario.state.q[7:], abs=1e-9)


def test_defaults(tmp_path):
    """Home configuration, no grasp, gravity along -z, gravity compensation: the least one can say."""
    path = tmp_path / "short.toml"
    path.write_text(
        """
        arms = [{ name = "a", robot = "panda" }]
        object = { mass = 2, inertia = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], com = [0, 0, 0.1] }
        controller = { type = "gravity_compensation" }
        simulation = { duration = 1, step = 0.5 }
        """
    )
    scenario = load_scene(path)
    assert scenario.name == "short"
    assert scenario.state.q == pytest.approx(HOME["panda"])
    assert scenario.chain.gravity == pytest.approx([0, 0, -9.81])
    assert scenario.chain.grasps == {}
    assert isinstance(scenario.controller, GravityCompensation)


def test_springs(tmp_path):
    """Between link, object and world as said; an impossible one is refused with its place."""
    first, second = loaded(tmp_path, TEXT + SPRINGS).chain.springs
    assert (first.a.body, first.a.link, first.b.body, first.b.link) == ("left", 6, "object", None)
    assert (first.stiffness, first.length, first.damping) == (40.0, 0.2, 1.5)
    assert second.a.body == "world" and (second.a.point == [0, 0, 2]).all() and second.length == second.damping == 0.0
    said = refusal(tmp_path / "bad.toml", TEXT + SPRINGS.replace("link = 6", "link = 7"))
    assert "$.springs[0]: arm 'left': link: expected a number from 0 to 6, got 7" in said
    assert "$.springs[1]" in refusal(tmp_path / "bad.toml", TEXT + SPRINGS.replace('"world"', '"wall"'))


def test_one_sided_contacts_tips_and_tools(tmp_path):
    """Friction, rpy attitudes and tools reach the model."""
    text = changed('kind = "rigid"', 'kind = "ball"\ncontact = { mu = 0.6 }')
    text = text.replace('robot = "panda"', 'robot = "panda"\ntip = { position = [0, 0, 0.1], rpy = [0, 0, 1.5] }', 1)
    chain = loaded(tmp_path, text).chain
    contact = chain.grasps["left"].contact
    assert contact is not None
    assert contact.mu == 0.6
    assert chain.arms["left"].tip.p == pytest.approx([0, 0, 0.207])
    assert chain.arms["left"].tip.R[:2, 0] == pytest.approx([np.cos(1.5), np.sin(1.5)])


def test_a_sole(tmp_path):
    """The two half lengths of a sole reach the model; one without them is refused with its place."""
    sole = 'kind = "sole"\ncontact = { mu = 0.6, half_lengths = [0.1, 0.06] }'
    contact = loaded(tmp_path, changed('kind = "rigid"', sole)).chain.grasps["left"].contact
    assert contact == Friction(0.6, half_lengths=(0.1, 0.06))
    said = refusal(tmp_path / "bad.toml", changed('kind = "rigid"', 'kind = "sole"\ncontact = { mu = 0.6 }'))
    assert "a sole contact needs half_lengths" in said


def test_normal_in_place_of_a_quaternion(tmp_path):
    """The contact frame is that of `hf.contact_frame`."""
    text = changed("quaternion = [0.5, -0.5, 0.5, -0.5]", "into = [2, 0, 0]")
    frame = loaded(tmp_path, text).chain.grasps["left"].frame
    assert np.allclose(frame.wxyz_xyz, loaded(tmp_path, TEXT).chain.grasps["left"].frame.wxyz_xyz, atol=1e-15)


MORE = """
[[events]]
type = "attach"
t = 1.0
arm = "right"
kind = "ball"
here = true
position = [0.15, 0.0, 0.0]
quaternion = [0.5, -0.5, -0.5, 0.5]
contact = { mu = 0.4 }
wrench_limits = { force = 80 }

[[events]]
type = "release"
t = 0.5
arm = "right"

[[wrenches]]
force = [0.0, 1.0, 0.0]
begin = 0.3
end = 0.4
"""


def test_everything_that_can_be_said(tmp_path):
    """Events, moving bases, wrenches, policies, scheme and tolerances reach `simulate`'s options."""
    text = TEXT.replace(
        "step = 0.002", 'step = 0.002\nscheme = "dop853"\nrtol = 1e-6\non_slip = "release"\nbreakpoints = [0.7]'
    )
    sway = "base_motion = { shift = { amplitude = [0.01, 0, 0], frequency = [1, 0, 0] }, smooth_start = 0.2 }\n"
    text = text.replace("[object]", sway + "\n[object]", 1) + MORE
    options = loaded(tmp_path, text).options
    release, attach = options["events"]
    assert (release.t, release.arm) == (0.5, "right")
    assert (attach.t, attach.arm, attach.here, attach.grasp.kind) == (1.0, "right", True, "ball")
    assert attach.grasp.wrench_limits.force == 80
    assert attach.grasp.contact.mu == 0.4
    assert options["breakpoints"] == [0.7, 0.3, 0.4, 0.2]
    assert options["inputs"](0.35).object_wrench.tolist() == [0, 0, 0, 0, 1, 0]
    assert list(options["base_motion"]) == ["right"]
    assert options["base_motion"]["right"](0.45)[1][3] != 0
    assert [options[k] for k in ("scheme", "rtol", "atol", "on_slip", "on_limit")] == [
        "dop853", 1e-6, None, "release", "record"]  # fmt: skip


SCHEDULE = """
[controller]
type = "torque_schedule"
beside = { type = "gravity_compensation", internal_force = 20.0 }

[[controller.pieces]]
begin = 0.5
torques = [[1.0, 2.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0], [3.0]]
"""


def with_schedule(old="", new=""):
    return TEXT[: TEXT.index("[controller]")] + changed(old, new, SCHEDULE) + TEXT[TEXT.index("[simulation]") :]


def test_schedule(tmp_path):
    """A torque schedule, added to gravity compensation."""
    scenario = loaded(tmp_path, with_schedule())
    before, after = (scenario.controller(t, scenario.state, None)[0] for t in (0.4, 0.6))
    assert after - before == pytest.approx([1.2, *12 * [0.0], 3.0])


BAD_SCENES = {
    "unknown policy": ("step = 0.002", 'step = 0.002\non_slip = "relase"', "$.simulation.on_slip: Invalid enum value"
                       " 'relase'. Did you mean 'release'?"),
    "negative tolerance": ("step = 0.002", "step = 0.002\nrtol = -1e-6", "$.simulation.rtol: expected >= 1e-15, got"
                           " -1e-06"),
    "base that jumps": ("[object]", "base_motion = { smooth_start = 0 }\n[object]",
                        "$.arms[1].base_motion.smooth_start: expected >= 1e-06, got 0.0"),
    "base that shakes": ("[object]", "base_motion = { turn = { amplitude = [1, 1, 1], frequency = [0, -1e9, 0] } }\n"
                         "[object]", "$.arms[1].base_motion.frequency: expected at most 10000 Hz, got 1e+09"),
    "name that clears the screen": ('name = "two pandas', 'name = "\\u001b[2J',
                                    r"$.name: expected up to 200 printable characters on one line, got '\x1b[2J"),
    "name without end": ('name = "left"', f'name = "{"x" * 300_000}"', "'-' and '.', got 'xxxxx"),
    "key without end": ("internal_force = 20.0", f"{'internal_force' * 50_000} = 20.0",
                        "unknown field `internal_forceinternal"),
    "key of another program": ("internal_force", '"\\u0000\\u2028"', r"unknown field `\x00\u2028`"),
    "not TOML": ("mass = 3.0", "mass = = 3.0", "not valid TOML: Invalid value"),
    "unknown key": ("internal_force = 20.0", "internal_forse = 20.0", "$.controller: Object contains unknown field"
                    " `internal_forse`. Did you mean 'internal_force'?"),
    "key of before": ("internal_force = 20.0", "squeeze = 20.0", "$.controller: Object contains unknown field"
                      " `squeeze`. Did you mean 'internal_force'?"),
    "unknown controller": ('"object_tracking"', '"object_trackin"', "Did you mean 'object_tracking'?"),
    "unknown grasp kind": ('kind = "rigid"', 'kind = "rigit"', "$.grasps[0].kind: Invalid enum value 'rigit'. Did you"
                           " mean 'rigid'?"),
    "unknown robot": ('robot = "panda"', 'robot = "pandas"', "$.arms[0].robot: no robot 'pandas'. Did you mean"
                      " 'panda'?"),
    "unknown arm": ('arm = "left"', 'arm = "lefty"', "$.grasps[0].arm: no arm 'lefty'. Did you mean 'left'?"),
    "duplicate arm": ('name = "right"', 'name = "left"', "$.arms[1].name: 'left' is already used at $.arms[0].name"),
    "two grasps of one arm": ('arm = "right"', 'arm = "left"', "$.grasps[1].arm: 'left' is already used at"
                              " $.grasps[0].arm"),
    "nameless arm": ('name = "left"', 'name = ""', "$.arms[0].name: expected 1 to 64 letters"),
    "missing mass": ("mass = 3.0\n", "", "$.object: Object missing required field `mass`"),
    "negative mass": ("mass = 3.0", "mass = -3.0", "$.object.mass: expected > 0, got -3.0"),
    "mass in words": ("mass = 3.0", 'mass = "3 kg"', "$.object.mass: Expected `float`, got `str`"),
    "NaN": ("mass = 3.0", "mass = nan", "$.object.mass: expected a finite number, got nan"),
    "infinity deep inside": ("[-0.55, 0.0, 0.0]", "[-0.55, 0.0, -inf]", "$.arms[0].base.position[2]: expected a finite"
                             " number, got -inf"),
    "astronomical": ("mass = 3.0", "mass = 1e300", "$.object.mass: expected a number up to 1e+09 in SI units"),
    "number beyond floats": ("mass = 3.0", "mass = 1" + 400 * "0", "$.object.mass: expected a number up to 1e+09"),
    "short vector": ("[-0.55, 0.0, 0.0]", "[-0.55, 0.0]", "$.arms[0].base.position: Expected `array` of length 3"),
    "flat box": ("box = [0.3, 0.2, 0.2]", "box = [0.3, 0.0, 0.2]", "$.object.box[1]: expected > 0, got 0"),
    "no inertia": ("box = [0.3, 0.2, 0.2]\n", "", "$.object: expected box, sphere, cylinder or inertia, got none"),
    "box and inertia": ("box = [0.3, 0.2, 0.2]", "box = [1, 1, 1]\ninertia = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
                        "$.object: expected box, sphere, cylinder or inertia, got box and inertia"),
    "impossible inertia": ("box = [0.3, 0.2, 0.2]", "inertia = [[1, 0, 0], [0, 1, 0], [0, 0, 5]]",
                           "$.object.inertia: no mass distribution has principal moments 1, 1, 5"),
    "asymmetric inertia": ("box = [0.3, 0.2, 0.2]", "inertia = [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]",
                           "$.object.inertia: expected a symmetric matrix"),
    "non-unit quaternion": ("[0.5, -0.5, 0.5, -0.5]", "[0.5, -0.5, 0.5, -0.4]", "$.grasps[0].quaternion: expected a"
                            " unit quaternion (w, x, y, z), got length 0.9539"),
    "two attitudes": ("quaternion = [0.5, -0.5, 0.5, -0.5]", "quaternion = [1, 0, 0, 0]\nrpy = [0, 0, 0]",
                      "$.grasps[0]: expected quaternion or rpy, got both"),
    "normal and attitude": ("quaternion = [0.5, -0.5, 0.5, -0.5]", "into = [1, 0, 0]\nrpy = [0, 0, 0]",
                            "$.grasps[0]: expected one of into, quaternion and rpy, got into and another"),
    "no normal": ("quaternion = [0.5, -0.5, 0.5, -0.5]", "into = [0, 0, 0]", "$.grasps[0].into: expected a"
                  " direction"),
    "too few joints": ("q = [0.0, -0.6,", "q = [-0.6,", "$.arms[0].q: expected 7 joint positions for a panda, got 6"),
    "contact on a rigid grasp": ('kind = "rigid"', 'kind = "rigid"\ncontact = { mu = 0.5 }', "$.grasps[0]: a rigid"
                                 " grasp is two-sided"),
    "no friction": ('kind = "rigid"', 'kind = "ball"\ncontact = { mu = 0.0 }', "$.grasps[0].contact.mu: expected > 0"),
    "soft finger without radius": ('kind = "rigid"', 'kind = "softfinger"\ncontact = { mu = 0.5 }',
                                   "$.grasps[0]: a softfinger contact needs torsion_radius"),
    "negative duration": ("duration = 2.0", "duration = -2.0", "$.simulation.duration: expected > 0, got -2.0"),
    "zero step": ("step = 0.002", "step = 0", "$.simulation.step: expected > 0, got 0.0"),
    "step beyond duration": ("step = 0.002", "step = 20.0", "$.simulation.step: expected <= the duration 2 s, got 20"),
    "too many steps": ("step = 0.002", "step = 2e-9", "$.simulation.step: expected at most 10000000 steps"),
    "negative internal force": ("internal_force = 20.0", "internal_force = -20.0",
                                "$.controller.internal_force: expected >= 0, got -20"),
    "path backwards": ("duration = 1.6", "duration = -1.6", "$.controller.path.duration: expected > 0, got -1.6"),
    "path before the start": ("begin = 0.2", "begin = -0.2", "$.controller.path.begin: expected >= 0, got -0.2"),
    "date": ("mass = 3.0", "mass = 2020-01-01", "$.object.mass: Expected `float`"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scene_is_refused(case, tmp_path):
    """One line that names the file, the place in it and what is wrong."""
    old, new, message = BAD_SCENES[case]
    assert message in refusal(tmp_path / "bad.toml", changed(old, new), 400)


@pytest.mark.parametrize("spelt", [b"\xef\xbb\xbf" + TEXT.encode(), TEXT.replace("\n", "\r\n").encode()])
def test_editors(spelt, tmp_path):
    """A byte order mark and other line ends change nothing, and the text stays as it was."""
    path = tmp_path / "edited.toml"
    path.write_bytes(spelt)
    scenario = load_scene(path)
    assert scenario.text.encode() == spelt
    assert (scenario.state.q == load_scene(EXAMPLE).state.q).all()


@pytest.mark.parametrize("what", ["missing.toml", ".", "/dev/zero", "pipe", "two\nlines", "\0", 3000 * "long"])
def test_unreadable_file(what, tmp_path):
    """A file that is not there, a folder, what would never end, names that no file has."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(SceneError, match=": cannot be read: ") as caught:
        load_scene(tmp_path / what)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) <= 600


def test_unreachable_object(tmp_path):
    """A box that no arm reaches: the error names file, place and every arm's miss."""
    path = tmp_path / "far.toml"
    path.write_text(changed("[0.0, 0.0, 0.72]", "[0.0, 0.0, 2.0]"))
    with pytest.raises(ClosureError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: $.object.pose: cannot close the chains: arm 'left' misses its grasp by")
    assert "arm 'right'" in text
    assert "\n" not in text


THROUGH = """through = [
  {{ t = 0.5, position = [0, 0.1, 0.8], rpy = [0, 0, 0.2] }},
  {{ t = {t}, position = [0.05, 0, 0.75]{more} }},
]"""
PATH = TEXT[TEXT.index("[controller.path]") : TEXT.index("[simulation]")]


def through(t: str = "1.5", more: str = "", beside: str = "") -> str:
    """Return the example with a path through poses in the place of its own."""
    return TEXT.replace(PATH, f"[controller.path]\n{beside}{THROUGH.format(t=t, more=more)}\n")


def test_a_path_through_poses(tmp_path):
    """The object begins where it is, passes the poses at their times, and rests at the last."""
    scenario = loaded(tmp_path, through(beside="begin = 0.2\n"))
    assert isinstance(scenario.controller, ObjectTracking)
    at = scenario.controller.path
    assert at(0.1).pose.p == pytest.approx([0, 0, 0.72], abs=1e-12)
    assert at(0.5).pose.p == pytest.approx([0, 0.1, 0.8], abs=1e-12)
    assert rotation.log(at(0.5).pose.R) == pytest.approx([0, 0, 0.2], abs=1e-12)
    assert np.abs(at(0.5).twist).max() > 0.1
    assert at(3.0).pose.p == pytest.approx([0.05, 0, 0.75], abs=1e-12)
    assert not at(1.5).twist.any()


@pytest.mark.parametrize(
    ("solid", "expected"),
    [
        ("sphere = 0.1", HeldObject.sphere(3.0, 0.1)),
        ("cylinder = [0.1, 0.3]", HeldObject.cylinder(3.0, 0.1, 0.3)),
    ],
)
def test_round_objects(tmp_path, solid, expected):
    """Solids of uniform density, drawn as what they are where their middle is the origin; links too."""
    held = loaded(tmp_path, changed("box = [0.3, 0.2, 0.2]", solid)).chain.held_object
    assert np.array_equal(held.inertia, expected.inertia)
    assert held.shape == expected.shape
    aside = loaded(tmp_path, changed("box = [0.3, 0.2, 0.2]", f"{solid}\ncom = [0, 0, 0.01]")).chain.held_object
    assert np.array_equal(aside.inertia, expected.inertia)
    assert aside.shape is None
    link = body(convert({"mass": 3.0} | tomllib.loads(solid), BodyTable), Location("link"))
    assert np.array_equal(link.inertia, expected.inertia)


def test_every_scheme(tmp_path):
    """Each scheme that a run knows can be asked for in a scene."""
    for scheme in SCHEMES:
        text = changed("[simulation]", f'[simulation]\nscheme = "{scheme}"')
        assert loaded(tmp_path, text).options["scheme"] == scheme


BAD_SCHEDULES = [
    ("[1.0, 2.0], [0.0], ", "[1.0, 2.0], ", "$.controller.pieces[0].torques: expected one list for each of 14 joints"),
    ("[1.0, 2.0]", "[]", "$.controller.pieces[0].torques[0]: expected at least one coefficient"),
    ("internal_force = 20.0", "internal_force = -1.0", "$.controller.beside.internal_force: expected >= 0"),
    ("begin", "begins", "$.controller.pieces[0]: Object contains unknown field `begins`. Did you mean 'begin'?"),
]
BAD_EVENTS = [
    ('type = "release"', 'type = "relase"', "Did you mean 'release'?"),
    ('t = 0.5\narm = "right"', 't = 0.5\narm = "rigth"', "$.events[1]: no such arm. Did you mean 'right'?"),
    ("t = 0.5", "t = 1.5", "$.events[0]: the arm has a grasp already; try a release before it"),
    ("t = 1.0", "t = 3.0", "$.events[0]: expected a time within the run of 2 s"),
    ("t = 0.5", "t = 0.0", "$.events[1].t: expected > 0"),
    ("mu = 0.4", "mu = -0.4", "$.events[0].contact.mu: expected > 0"),
    ("force = 80", "force = 0", "$.events[0].wrench_limits.force: expected > 0"),
    ("end = 0.4", "end = 0.2", "$.wrenches[0].end: expected a time after the begin at 0.3 s, got 0.2"),
    ("begin = 0.3", "beginn = 0.3", "$.wrenches[0]: Object contains unknown field `beginn`. Did you mean 'begin'?"),
]
BAD_SOLIDS = [
    ("sphere = 0.0", "object.sphere: expected > 0, got 0"),
    ("cylinder = [0.1, -0.3]", "object.cylinder[1]: expected > 0, got -0.3"),
    ("sphere = 0.1\nbox = [0.3, 0.2, 0.2]", "object: expected box, sphere, cylinder or inertia, got box and sphere"),
]
BAD_PATHS = [
    (through(t="0.5"), "controller.path.through[1].t: expected a time after the pose before it at 0.5 s, got 0.5"),
    (through(beside="begin = 0.5\n"), "controller.path.through[0].t: expected a time after the begin at 0.5 s"),
    (through(beside="duration = 1.0\n"), "controller.path.duration: expected none, as the path goes through poses"),
    (through(beside="turn = [1, 0, 0]\n"), "controller.path.turn: expected none, as the path goes through poses"),
    (through(more=", rpy = [3.141592653589793, 0, 3.341592653589793]"),
     "controller.path.through[1]: expected less than half a turn from where it was"),
    (through(more=", quaternion = [1, 0, 0, 1]"), "controller.path.through[1].quaternion"),
    (TEXT.replace(PATH, "[controller.path]\nthrough = []\n"), "controller.path.through: expected one pose or more"),
    (TEXT.replace(PATH, "[controller.path]\n"), "controller.path.duration: expected a duration, or poses"),
]  # fmt: skip
GUTTED = [  # whole parts are missing, or it is no text
    ("", "$: Object missing required field `arms`"),
    ("arms = []\n" + TEXT[TEXT.index("[object]") :], "$.arms: expected at least one arm, or shapes in [[world]]"),
    (TEXT[: TEXT.index("[[grasps]]")] + TEXT[TEXT.index("[controller]") :], "object_tracking needs a grasp"),
    (b"name = '\xff'", "not valid TOML"),
    (TEXT.encode("utf-16"), "not valid TOML: 'utf-8' codec"),
    ("a = " + 3000 * "[" + 3000 * "]", "not valid TOML: nested too deeply"),
    ("\n" + 20_000 * "a." + "a = 1", "not valid TOML: expected a key of fewer than 100 parts (at line 2)"),
    ("a = " + 100 * ("{" + 90 * "a." + "a =") + "1" + 100 * "}", "expected at most 20 levels of tables and arrays"),
    ("a = " + 5000 * "9", "not valid TOML: an integer of more than 4300 digits"),
    (3_000_000 * "#", "expected at most 2 MiB, got more"),
    (TEXT.replace(LEFT_ARM, "".join(LEFT_ARM.replace("left", f"left{k}") for k in range(64))),
     "$.arms: expected at most 64 arms, got 65"),
    (with_schedule("[1.0, 2.0]", "[" + 3000 * "0.1," + "]"),
     "$.controller.pieces[0].torques[0]: expected at most 20 coefficients, got 3000"),
]  # fmt: skip
REFUSED = [
    *((with_schedule(old, new), message) for old, new, message in BAD_SCHEDULES),
    *((TEXT + changed(old, new, MORE), message) for old, new, message in BAD_EVENTS),
    *((changed("box = [0.3, 0.2, 0.2]", solid), message) for solid, message in BAD_SOLIDS),
    *BAD_PATHS,
    *GUTTED,
]


@pytest.mark.parametrize("k", range(len(REFUSED)), ids=[message for _, message in REFUSED])
def test_refused(k, tmp_path):
    """Each fault on one line that names its place."""
    text, message = REFUSED[k]
    assert message in refusal(tmp_path / "bad.toml", text)
