"""A scene's sweep: the plan that its table says, by the command line and in Python, and whatever the table says."""

import copy
import json
import random
import shutil
import tomllib
from contextlib import suppress
from dataclasses import replace

import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.scenario.build import build_scene, require_sensible
from holdfast.scenario.overrides import overridden, toml_text
from holdfast.scenario.scene import SceneTable
from holdfast.sweeps import load_sweep, sweep_scene
from holdfast.sweeps.of_scene import scene_plan
from tests.cli.conftest import EXAMPLE
from tests.robots.two_armed import TWO_ARMED
from tests.scenario import mutated_scenes
from tests.sweeps.problems import data

pytest.importorskip("pyarrow", reason="needs pyarrow: pip install 'holdfast[parquet]'")

TABLE = """
[sweep]
count = 7
seed = 3
chunk = 3
outputs = ["object_pose", "object_twist"]

[sweep.parameters]
object_mass = { type = "uniform", low = 2.0, high = 4.0 }
object_inertia = "scale"
object_wrench = { type = "normal", mean = 0.0, deviation = [0, 0, 0, 5, 5, 5] }
grasp_pose = { type = "near_pose", turn = 1e-3, shift = 1e-3 }
gravity = [0, 0, -9.8]
"""
TRACKING = EXAMPLE.read_text().replace("duration = 2.0", "duration = 0.008") + TABLE
RAW = tomllib.loads(TRACKING)
TEXT = toml_text({key: x for key, x in RAW.items() if key != "controller"})  # machine code that is made sooner


def scenario(*changes):
    """Return the scene with some of its keys changed."""
    raw = overridden(RAW, changes)
    require_sensible(raw, hf.io.typed.Location("scene"))
    return build_scene(hf.io.typed.convert(raw, SceneTable, "scene"), "scene", toml_text(raw))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of the scene's sweep, as the command line wrote it."""
    place = tmp_path_factory.mktemp("swept")
    (place / "scene.toml").write_text(TEXT)
    assert main(["sweep", str(place / "scene.toml"), "--out", str(place / "store")]) == 0
    return place / "store"


@pytest.mark.long
def test_a_run_is_that_of_simulate(folder):
    """A run's end is what `simulate` finds for the payload and push that were drawn, under the scene's controller."""
    (folder.parent / "held.toml").write_text(TRACKING.replace("grasp_pose =", "#"))
    made = sweep_scene(hf.load_scene(folder.parent / "held.toml"), folder.parent / "held")
    found, scene, drawn = made.run(4), hf.load_scene(folder.parent / "held.toml"), {}
    for title in made.columns:
        drawn[title] = made.column(title)[4]
    held = scene.chain.held_object
    share = drawn["drawn object_mass"] / held.mass
    payload = replace(held, mass=drawn["drawn object_mass"], inertia=share * held.inertia)
    chain = replace(scene.chain, held_object=payload, gravity=[0, 0, -9.8])
    push = hf.Inputs(object_wrench=[drawn[f"drawn object_wrench[{k}]"] for k in range(6)])
    expected = hf.simulate(chain, scene.state, scene.controller, 0.008, 0.002, inputs=push)
    assert found.object_pose[-1] == pytest.approx(expected.object_pose[-1], abs=1e-10)
    assert found.object_twist[-1] == pytest.approx(expected.object_twist[-1], abs=1e-10)


@pytest.mark.slow
def test_again_from_the_folder_alone(folder, tmp_path, cli):
    """Its run is taken again to the bits of its row, as a result that other commands read; missing files come back."""
    expected = data(folder)
    place = json.loads(cli("sweep", folder, "--run", "5", "--json").out)["result"]
    run = hf.load_result(place).trajectory
    row = [load_sweep(folder).column(title)[5] for title in load_sweep(folder).columns if "object_twist" in title]
    assert run.object_twist[-1].tolist() == row
    cli("summary", place)
    (folder / "runs_000001.parquet").unlink()
    found = json.loads(cli("sweep", folder, "--json").out)
    assert data(folder) == expected
    assert (found["runs"], found["statuses"]) == (7, {"RUNNING": 7})
    heights = load_sweep(folder).column("object_pose z [m]")
    assert found["quantiles"]["object_pose z [m]"][::4] == [heights.min(), heights.max()]


@pytest.mark.slow
def test_the_run_is_shown(folder, tmp_path):
    """The viewer's page of a run that was taken again."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    assert main(["sweep", str(folder), "--run", "2"]) == 0
    assert main(["view", str(folder / "run_2"), "--export", str(tmp_path / "page.html")]) == 0
    assert (tmp_path / "page.html").stat().st_size > 100_000


def test_robots_out_of_files_are_kept(tmp_path, cli):
    """The folder needs neither the scene nor its URDF any more."""
    (tmp_path / "two.urdf").write_text(TWO_ARMED)
    arms = [{"name": "left", "urdf": {"file": "two.urdf", "tip": "left_hand", "lock_others": True}, "q": [0.1] * 4}]
    raw = {"arms": arms, "object": {"mass": 1.0, "box": [0.1, 0.1, 0.1]}}
    raw["simulation"] = {"duration": 0.002, "step": 0.001}
    raw["sweep"] = {"count": 2, "parameters": {"tau": {"type": "normal", "mean": 0.0, "deviation": 1.0}}}
    (tmp_path / "scene.toml").write_text(toml_text(raw))
    assert main(["sweep", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "store")]) == 0
    expected = data(tmp_path / "store")
    for name in ("scene.toml", "two.urdf", "store/runs_000000.parquet"):
        (tmp_path / name).unlink()
    assert main(["sweep", str(tmp_path / "store")]) == 0
    assert data(tmp_path / "store") == expected
    (robot,) = (tmp_path / "store").glob("robot_*.urdf")
    robot.write_text(TWO_ARMED.replace('mass value="', 'mass value="1'))
    assert "robot" in cli("sweep", tmp_path / "store", code=2).err


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["sweep.cout=1"], "$.sweep: Object contains unknown field `cout`. Did you mean 'count'?"),
        (["sweep.count=0"], "$.sweep: count"),
        (["sweep.count=2.5"], "$.sweep.count"),
        (["sweep.seed=-1"], "$.sweep: seed"),
        (["sweep.chunk=0"], "$.sweep: chunk"),
        (['sweep.outputs=["object_pos"]'], "Did you mean 'object_pose'?"),
        (["sweep.outputs=[1]"], "$.sweep.outputs[0]"),
        (["sweep.parameters.object_mas=1"], "Did you mean 'object_mass'?"),
        (["sweep.parameters.object_mass.low=5"], "low <= high"),
        (["sweep.parameters.object_mass.low=[1, 2]"], "object_mass: low: expected one number or shape ()"),
        (["sweep.parameters.object_mass.lo=5"], "Did you mean 'low'?"),
        (['sweep.parameters.object_mass.type="gauss"'], "gauss"),
        (['sweep.parameters.object_mass={type="near_pose"}'], "$.sweep.parameters.object_mass: near_pose"),
        (["sweep.parameters.object_wrench.deviation=-1"], "deviation >= 0"),
        (["sweep.parameters.grasp_pose.turn=-1"], "turn and shift >= 0"),
        (["sweep.parameters.tau=0"], "no parameter 'tau'"),
        (['sweep.parameters.gravity="scale"'], "gravity"),
        (["sweep.parameters.gravity=[[1, 2], [3]]"], "gravity"),
        (["simulation.step=0.003"], "whole number of steps"),
        (['simulation.scheme="dop853"'], "$.simulation.scheme: expected 'rk4' or 'midpoint' in a sweep"),
        (['simulation.on_slip="release"'], "$.simulation.on_slip"),
        (['simulation.on_limit="clip"'], "$.simulation.on_limit"),
        (['simulation.on_singular="continue"'], "$.simulation.on_singular"),
        (["simulation.sample_time=0.0015"], "step: expected one that divides the sample time 0.0015 s"),
        (["simulation.breakpoints=[0.003]"], "$.breakpoints"),
        (["wrenches=[{force=[0, 0, 1]}]"], "sweep.parameters.object_wrench"),
        (['events=[{type="release", t=0.004, arm="left"}]'], "$.events"),
        (["arms.left.base_motion={shift={amplitude=[0, 0, 1], frequency=[1, 1, 1]}}"], "left moving"),
        (
            [f'controller={{type="torque_schedule", pieces=[{{begin=0.0, torques={[[0.0, 1.0]] * 14}}}]}}'],
            "torque_schedule that changes",
        ),
    ],
)
def test_refusals(changes, said):
    """What does not fit, or what rollouts do not do, is refused by name."""
    with pytest.raises(hf.errors.HoldfastError) as refused:
        scene_plan(scenario(*changes))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_sampled_controller():
    """A run is that of `simulate` with the scene's sample time and delay, and with the values drawn."""
    scene = scenario("simulation.sample_time=0.004", "simulation.delay=0.002", "simulation.step=0.002")
    plan = scene_plan(scene)
    rows = plan.rows(0, 1)
    systems = plan.rollout.start(**rows)
    found = plan.rollout.run(systems, plan.duration, plan.step).trajectory(0)
    timing = {"sample_time": 0.004, "delay": 0.002}
    push = hf.Inputs(object_wrench=rows["object_wrench"][0])
    chain, start = found.require_setting().chain, systems.state(0)
    run = hf.simulate(chain, start, scene.controller, plan.duration, plan.step, inputs=push, **timing)
    assert len(run) > 5  # both sides of jumps
    for name in ("t", "q", "tau"):
        assert abs(getattr(found, name)[: len(run) - 1] - getattr(run, name)[:-1]).max() <= 1e-9


def test_no_sweep_in_the_scene():
    """A scene without the table says what to write."""
    with pytest.raises(hf.errors.SceneError, match=r"\[sweep\] with count = 100"):
        scene_plan(
            build_scene(hf.io.typed.convert({k: x for k, x in RAW.items() if k != "sweep"}, SceneTable, "scene"))
        )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.toml"], "nowhere.toml"),
        (["scene.toml", "--run", "3"], "expected the folder of a sweep"),
        (["scene.toml", "--workers", "0"], "workers"),
        (["scene.toml", "--workers", "x"], "workers"),
        (["scene.toml", "--workers", "2", "--cluster", "tcp://127.0.0.1:1"], "workers: expected none beside"),
        (["scene.toml", "--out", "-"], "single files only"),
        (["scene.toml", "--out", "a_file"], "a_file"),
        (["scene.toml", "--out", "used"], "other files"),
        (["scene.toml", "--out", "x" * 300], "cannot be written"),
        (["used"], "is this a sweep folder?"),
        (["store", "--run", "7"], "from 0 to 6"),
        (["store", "--run", "-1"], "from 0 to 6"),
        (["store", "--run", "1.5"], "run"),
        (["store", "--run", "1", "--workers", "2"], "without --workers"),
        (["store", "--set", "sweep.count=8"], "--set: expected a scene"),
        (["store", "--out", "other"], "--out: expected a scene"),
        (["scene.toml", "--out", "store", "--set", "sweep.count=8"], "count differ"),
        (["store", "--resume"], "resume"),
    ],
)
def test_misuse(arguments, said, folder, cli, monkeypatch):
    """One line, exit code 2, nothing changed."""
    monkeypatch.chdir(folder.parent)
    (folder.parent / "a_file").touch()
    (folder.parent / "used").mkdir(exist_ok=True)
    (folder.parent / "used" / "notes.txt").touch()
    before = data(folder)
    lines = cli("sweep", *arguments, code=2).err.splitlines()
    assert len([line for line in lines if line.startswith("holdfast: error: ")]) == 1
    assert said in lines[-1]
    assert data(folder) == before


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("robots.json", "{"),
        ("robots.json", '{"left": {"file": "../x", "sha256": "", "folder": ""}}'),
        ("scene.toml", "="),
    ],
)
def test_damaged_folders(name, content, folder, tmp_path, cli):
    """What the folder keeps is checked as any input is."""
    for kept in ("scene.toml", "robots.json", "sweep.json"):
        (tmp_path / kept).write_bytes((folder / kept).read_bytes())
    (tmp_path / name).write_text(content)
    assert name in cli("sweep", tmp_path, "--run", "1", code=2).err


@pytest.mark.parametrize("name", ["sweep.json", "runs_000001.parquet", "robots.json"])
def test_damage_healed_by_the_command(name, folder, tmp_path, cli):
    """One flipped bit of a data page, of the manifest or of the list of robots is named; the command heals it."""
    place = tmp_path / "store"
    shutil.copytree(folder, place)
    content = bytearray((place / name).read_bytes())
    content[len(content) // 4] ^= 1
    (place / name).write_bytes(content)
    with pytest.raises(hf.errors.ResultError, match=rf"{name} is damaged.*call `sweep` again"):
        load_sweep(place).column("object_pose z [m]")
    (tmp_path / "scene.toml").write_text(TEXT)
    cli("sweep", tmp_path / "scene.toml", "--out", place)
    assert data(place) == data(folder)
    assert load_sweep(place).column("run").tolist() == list(range(7))


@pytest.mark.slow
def test_mutated_tables():
    """Of hundreds of spoilt tables each is a plan or refused on one line."""
    kinds = list(mutated_scenes.OF_STRUCTURE)
    sound, said = scenario(), list[str]()
    for seed in range(300):
        dice, raw = random.Random(seed), {"sweep": copy.deepcopy(RAW["sweep"])}
        for spoil in dice.choices(kinds, k=dice.choice([1, 1, 2])):
            with suppress(IndexError, KeyError, TypeError, AttributeError, ValueError):  # nothing is left for this one
                spoil(raw, dice)
        try:
            require_sensible(raw, hf.io.typed.Location("scene"))
            table = hf.io.typed.convert({**RAW, **raw}, SceneTable, "scene").sweep
            scene_plan(replace(sound, sweep=table))
        except hf.errors.HoldfastError as error:
            said.append(str(error))
    assert 100 < len(said) < 300
    assert not [text for text in said if "\n" in text]
