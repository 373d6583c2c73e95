"""A scene becomes the chain it describes, closed and at rest; a bad one is refused on one line."""

from pathlib import Path

import numpy as np
import pytest

from holdfast import ClosureError, SceneError, closure
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.robots import PANDA_HOME
from holdfast.scenario.build import load_scene

EXAMPLE = Path(__file__).parents[2] / "examples" / "two_pandas.toml"
TEXT = EXAMPLE.read_text()

RIGHT_GRASP = TEXT[TEXT.index('[[grasps]]\narm = "right"') : TEXT.index("[controller]")]
LEFT_ARM = TEXT[TEXT.index('[[arms]]\nname = "left"') : TEXT.index('[[arms]]\nname = "right"')]


def changed(old: str, new: str) -> str:
    assert old in TEXT, old
    return TEXT.replace(old, new, 1)


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
    for gap in closure(scenario.chain, scenario.state).values():
        assert np.abs(gap.position).max() < 1e-10
    assert isinstance(scenario.controller, ObjectTracking)
    assert scenario.controller.squeeze == 20.0
    # the two arms mirror each other through the box
    assert scenario.state.q[:7] == pytest.approx(scenario.state.q[7:], abs=1e-9)


def test_defaults(tmp_path):
    """Home posture, no grasp, gravity along -z, gravity compensation: the least one can say."""
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
    assert scenario.state.q == pytest.approx(PANDA_HOME)
    assert scenario.chain.gravity == pytest.approx([0, 0, -9.81])
    assert scenario.chain.grasps == {}
    assert isinstance(scenario.controller, GravityCompensation)


def test_one_sided_contacts_tips_and_tools(tmp_path):
    """Friction, rpy attitudes and tools reach the model."""
    path = tmp_path / "ball.toml"
    text = changed('kind = "rigid"', 'kind = "ball"\ncontact = { mu = 0.6 }')
    text = text.replace('robot = "panda"', 'robot = "panda"\ntip = { position = [0, 0, 0.1], rpy = [0, 0, 1.5] }', 1)
    path.write_text(text)
    chain = load_scene(path).chain
    contact = chain.grasps["left"].contact
    assert contact is not None
    assert contact.mu == 0.6
    assert chain.arms["left"].tip.p == pytest.approx([0, 0, 0.207])
    assert chain.arms["left"].tip.R[:2, 0] == pytest.approx([np.cos(1.5), np.sin(1.5)])


BAD_SCENES = {
    "not TOML": ("mass = 3.0", "mass = = 3.0", "not valid TOML: Invalid value"),
    "unknown key": ("squeeze = 20.0", "squeze = 20.0", "$.controller: Object contains unknown field `squeze`. Did you"
                    " mean 'squeeze'?"),
    "unknown table": ("[simulation]", "[simulations]", "$: Object contains unknown field `simulations`. Did you mean"
                      " 'simulation'?"),
    "unknown key in arm": ("base = { position", "bases = { position", "$.arms[0]: Object contains unknown field"
                           " `bases`. Did you mean 'base'?"),
    "unknown controller": ('"object_tracking"', '"object_trackin"', "Did you mean 'object_tracking'?"),
    "unknown grasp kind": ('kind = "rigid"', 'kind = "rigit"', "$.grasps[0].kind: Invalid enum value 'rigit'. Did you"
                           " mean 'rigid'?"),
    "unknown robot": ('robot = "panda"', 'robot = "pandas"', "$.arms[0].robot: no robot 'pandas'. Did you mean"
                      " 'panda'?"),
    "unknown arm": ('arm = "left"', 'arm = "lefty"', "$.grasps[0].arm: no arm 'lefty'. Did you mean 'left'?"),
    "duplicate arm": ('name = "right"', 'name = "left"', "$.arms[1].name: 'left' stands already at $.arms[0].name"),
    "two grasps of one arm": ('arm = "right"', 'arm = "left"', "$.grasps[1].arm: 'left' stands already at"
                              " $.grasps[0].arm"),
    "nameless arm": ('name = "left"', 'name = ""', "$.arms[0].name: expected letters, digits"),
    "two-line name": ('name = "left"', 'name = "le\\nft"', "$.arms[0].name: expected letters, digits"),
    "missing mass": ("mass = 3.0\n", "", "$.object: Object missing required field `mass`"),
    "negative mass": ("mass = 3.0", "mass = -3.0", "$.object.mass: expected > 0, got -3.0"),
    "mass in words": ("mass = 3.0", 'mass = "3 kg"', "$.object.mass: Expected `float`, got `str`"),
    "NaN": ("mass = 3.0", "mass = nan", "$.object.mass: expected a finite number, got nan"),
    "infinity deep inside": ("[-0.55, 0.0, 0.0]", "[-0.55, 0.0, -inf]", "$.arms[0].base.position[2]: expected a finite"
                             " number, got -inf"),
    "astronomical": ("mass = 3.0", "mass = 1e300", "$.object.mass: expected a number up to 1e+09 in SI units"),
    "number beyond floats": ("mass = 3.0", "mass = 1" + 400 * "0", "$.object.mass: expected a number up to 1e+09"),
    "short vector": ("[-0.55, 0.0, 0.0]", "[-0.55, 0.0]", "$.arms[0].base.position: Expected `array` of length 3"),
    "scalar for vector": ("box = [0.3, 0.2, 0.2]", "box = 0.3", "$.object.box: Expected `array"),
    "flat box": ("box = [0.3, 0.2, 0.2]", "box = [0.3, 0.0, 0.2]", "$.object.box[1]: expected > 0, got 0"),
    "no inertia": ("box = [0.3, 0.2, 0.2]\n", "", "$.object: expected box or inertia, got neither"),
    "box and inertia": ("box = [0.3, 0.2, 0.2]", "box = [1, 1, 1]\ninertia = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
                        "$.object: expected box or inertia, got both"),
    "impossible inertia": ("box = [0.3, 0.2, 0.2]", "inertia = [[1, 0, 0], [0, 1, 0], [0, 0, 5]]",
                           "$.object.inertia: no mass distribution has principal moments 1, 1, 5"),
    "asymmetric inertia": ("box = [0.3, 0.2, 0.2]", "inertia = [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]",
                           "$.object.inertia: expected a symmetric matrix"),
    "non-unit quaternion": ("[0.5, -0.5, 0.5, -0.5]", "[0.5, -0.5, 0.5, -0.4]", "$.grasps[0].quaternion: expected a"
                            " unit quaternion (w, x, y, z), got length 0.9539"),
    "zero quaternion": ("[0.5, -0.5, 0.5, -0.5]", "[0, 0, 0, 0]", "$.grasps[0].quaternion: expected a unit quaternion"),
    "two attitudes": ("quaternion = [0.5, -0.5, 0.5, -0.5]", "quaternion = [1, 0, 0, 0]\nrpy = [0, 0, 0]",
                      "$.grasps[0]: expected quaternion or rpy, got both"),
    "too few joints": ("q = [0.0, -0.6,", "q = [-0.6,", "$.arms[0].q: expected 7 joint positions for a panda, got 6"),
    "contact on a rigid grasp": ('kind = "rigid"', 'kind = "rigid"\ncontact = { mu = 0.5 }', "$.grasps[0]: a rigid"
                                 " grasp is two-sided"),
    "no friction": ('kind = "rigid"', 'kind = "ball"\ncontact = { mu = 0.0 }', "$.grasps[0].contact.mu: expected > 0"),
    "soft finger without radius": ('kind = "rigid"', 'kind = "softfinger"\ncontact = { mu = 0.5 }',
                                   "$.grasps[0]: a softfinger contact needs torsion_radius"),
    "negative duration": ("duration = 2.0", "duration = -2.0", "$.simulation.duration: expected > 0, got -2.0"),
    "zero step": ("step = 0.002", "step = 0", "$.simulation.step: expected > 0, got 0.0"),
    "step beyond duration": ("step = 0.002", "step = 20.0", "$.simulation.step: expected <= the duration 2 s, got 20"),
    "too many steps": ("step = 0.002", "step = 2e-9", "$.simulation.step: expected at most 1000000 steps"),
    "negative squeeze": ("squeeze = 20.0", "squeeze = -20.0", "$.controller.squeeze: expected >= 0, got -20"),
    "path backwards": ("duration = 1.6", "duration = -1.6", "$.controller.path.duration: expected > 0, got -1.6"),
    "path before the start": ("begin = 0.2", "begin = -0.2", "$.controller.path.begin: expected >= 0, got -0.2"),
    "path of two numbers": ("turn = [0.0, 0.0, 0.3]", "turn = [0.0, 0.3]", "$.controller.path.turn: Expected `array`"),
    "date": ("mass = 3.0", "mass = 2020-01-01", "$.object.mass: Expected `float`"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scene_is_refused(case, tmp_path):
    """One line that names the file, the place in it and what is wrong."""
    old, new, message = BAD_SCENES[case]
    path = tmp_path / "bad.toml"
    path.write_text(changed(old, new))
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert message in text
    assert "\n" not in text
    assert len(text) < 400


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "$: Object missing required field `arms`"),
        ("arms = []\n" + TEXT[TEXT.index("[object]") :], "$.arms: expected at least one arm, got none"),
        (TEXT[: TEXT.index("[[grasps]]")] + TEXT[TEXT.index("[controller]") :], "object_tracking needs a grasp"),
        (b"name = '\xff'", "not valid TOML"),
        ("a = " + 3000 * "[" + 3000 * "]", "not valid TOML"),
    ],
)
def test_gutted_scene_is_refused(text, message, tmp_path):
    """Files with whole parts missing, or that are no text."""
    path = tmp_path / "bad.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("what", ["missing.toml", "."])
def test_unreadable_file(what, tmp_path):
    """A file that is not there, a folder."""
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene(tmp_path / what)


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
