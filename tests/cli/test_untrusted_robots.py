"""Opening a scene or a result never runs what came with it: xacro is Python, expanded on the user's word only."""

import hashlib
import json
import shutil

import pytest

from holdfast import load_result, load_scene, load_urdf
from holdfast.cli import main
from holdfast.errors import SceneError
from tests.io.signing import as_0_1, resigned, signed
from tests.robots.two_armed import TWO_ARMED
from tests.scenario.test_robot import scene

pytest.importorskip("xacrodoc", reason="needs xacrodoc: pip install 'holdfast[robots]'")

# xacro refuses names with two underscores, but does not look into a lambda
ESCAPE = (
    "${{(lambda: [c for c in ().__class__.__base__.__subclasses__() if c.__name__ == 'catch_warnings'][0]()"
    "._module.__builtins__['open']('{proof}', 'w'))() and 'two_armed'}}"
)


def hostile(proof):
    """Return a robot that is as good as any, and makes a file when xacro expands it."""
    assert TWO_ARMED.count('<robot name="') == 1
    head, _, rest = TWO_ARMED.partition('<robot name="')
    _, _, rest = rest.partition('"')
    name = ESCAPE.format(proof=proof)
    return f'{head}<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="{name}"{rest}'


@pytest.fixture
def folder(tmp_path):
    """A scene of both arms of a hostile xacro file, and where its proof would be."""
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "two.urdf.xacro").write_text(hostile(tmp_path / "proof"))
    (tmp_path / "two.toml").write_text(scene().replace("two.urdf", "two.urdf.xacro"))
    return tmp_path


@pytest.fixture
def result(folder):
    """A result of that scene, made by someone who trusts it; without the proof."""
    out = str(folder / "result")
    assert main(["simulate", str(folder / "two.toml"), "--out", out, "--no-plots", "--trust-xacro"]) == 0
    assert (folder / "proof").exists()  # so the robot is as hostile as it is meant to be
    (folder / "proof").unlink()
    return folder / "result"


def test_a_scene_expands_xacro_on_a_word_only(folder, cli):
    """`simulate` and `view` name the file and what to say; in Python it is the same."""
    scene = folder / "two.toml"
    for command in ("simulate", "view"):
        said = cli(command, scene, code=2).err
        assert "two.urdf.xacro: expanding xacro runs the Python code" in said and "--trust-xacro" in said
    with pytest.raises(SceneError, match="trust_xacro=True"):
        load_scene(scene)
    with pytest.raises(SceneError, match="trust_xacro=True"):
        load_urdf(folder / "robots" / "two.urdf.xacro")
    assert not (folder / "proof").exists()
    assert load_scene(scene, trust_xacro=True).chain.names == ("left", "right")


@pytest.mark.slow
def test_a_result_is_opened_without_expanding(folder, result, cli):
    """`plot`, `view` and `export` draw the model that the result keeps, wherever the folder was moved."""
    shutil.move(folder / "robots", folder / "gone")
    for command in (["plot", "--out", folder / "plots"], ["view", "--export", folder / "page.html"]):
        assert "another model" not in cli(*command, result).err
    assert "another model" not in cli("export", result, "--format", "mcap").err
    assert not (folder / "proof").exists()


@pytest.mark.slow
def test_a_result_that_keeps_no_robot(folder, result, cli):
    """A folder as 0.1 wrote it: its figures are drawn without the robot, and nothing is expanded without a word."""
    for record in json.loads((result / "meta.json").read_text())["robots"].values():
        (result / record["file"]).unlink(missing_ok=True)
    as_0_1(result, robots=None)
    assert load_result(result).samples == 5
    said = cli("view", result, "--export", folder / "page.html", code=2).err
    assert "two.urdf.xacro" in said and "--trust-xacro" in said
    said = cli("plot", result)
    assert "two.urdf.xacro" in said.err and "drawn without the robots' limits" in said.err
    assert said.out.count("look at") == 4
    assert not (folder / "proof").exists()
    assert main(["view", str(result), "--export", str(folder / "page.html"), "--trust-xacro"]) == 0
    assert (folder / "proof").exists()


@pytest.mark.slow
def test_a_result_names_files_of_its_own_only(result, cli):
    """A meta.json cannot make anyone read, or remove, a file elsewhere."""
    meta = json.loads((result / "meta.json").read_text())
    for file in ("../two.toml", "/etc/hostname", ""):
        resigned(result, robots=meta["robots"] | {"left": {"file": file, "sha256": "", "folder": ""}})
        assert f"{file} is not {'named by the manifest' if file else 'a file'}" in cli("plot", result, code=2).err
    for file in ("../two.toml", "/etc/hostname", "notes.txt", "robot_/../../two.urdf"):
        (result / "notes.txt").touch()
        empty = hashlib.sha256(b"").hexdigest()
        (result / "meta.json").write_text(signed(meta | {"files": meta["files"] | {file: empty}}))
        assert f"names '{file}', no file of a result" in cli("plot", result, code=2).err


@pytest.mark.slow
def test_a_robot_exchanged_in_a_result(result, cli):
    """A kept robot that is another one than was simulated is refused by name."""
    (kept,) = result.glob("robot_*.urdf")
    kept.write_text(TWO_ARMED.replace('<mass value="3"/>', '<mass value="4"/>'))
    assert f"{kept.name} is damaged, or another file" in cli("plot", result, code=2).err
    kept.unlink()
    assert f"{kept.name} is missing" in cli("plot", result, code=2).err
