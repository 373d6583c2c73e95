"""A run in Python becomes a folder, tables, a page and figures by methods of its own, and comes back."""

import builtins
import json
import pickle
import webbrowser
from dataclasses import replace

import msgspec
import numpy as np
import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.interop.mcap_writer import write_mcap
from holdfast.io.model_data import model_data, model_of
from holdfast.model.fingerprint import fingerprint
from holdfast.simulation.events import Occurrence
from holdfast.simulation.trajectory import array_names
from holdfast.view import inline
from holdfast.view.link_meshes import meshes_in_files
from tests.systems.bushed import random_bushed
from tests.systems.problems import random_problem
from tests.systems.random_trunks import random_trunk_system
from tests.systems.sprung import with_springs
from tests.systems.trunk_problems import random_on_trunk
from tests.systems.trunk_runs import swaying
from tests.test_newcomer import urdf

VISUAL = '<visual><geometry><mesh filename="{}" scale="0.1 0.1 0.1"/></geometry></visual> <inertial>'
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
WRITES = ("save", "to_csv", "to_parquet", "to_mcap", "page")


def stl(corners) -> str:
    """Return a tetrahedron as an STL file."""
    faces = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]
    vertices = ("".join(f"vertex {x} {y} {z}\n" for x, y, z in face) for face in faces)
    each = "".join(f"facet normal 0 0 0\nouter loop\n{three}endloop\nendfacet\n" for three in vertices)
    return f"solid t\n{each}endsolid t\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with two robots as a newcomer has them, with a mesh on every link."""
    folder = tmp_path_factory.mktemp("mine")
    for name, heavier in (("left", 1.0), ("right", 1.2)):
        (folder / f"{name}.urdf").write_text(urdf(name, heavier).replace("<inertial>", VISUAL.format("link.stl")))
    (folder / "link.stl").write_text(stl(CORNERS))
    return folder


@pytest.fixture(scope="module")
def run(folder):
    """Return a short run of both on one box."""
    at = {"left": [1, 0, 0, 0, -0.55, 0, 0], "right": [0, 0, 0, 1, 0.55, 0, 0]}
    arms = {name: hf.load_urdf(folder / f"{name}.urdf", mount=mount) for name, mount in at.items()}
    sides = {"left": ([-0.15, 0, 0], [1, 0, 0]), "right": ([0.15, 0, 0], [-1, 0, 0])}
    grasps = {name: hf.Grasp("rigid", hf.contact_frame(p, into=into)) for name, (p, into) in sides.items()}
    box = hf.HeldObject.box(3.0, 0.3, 0.2, 0.2)
    chain, state = hf.assemble(arms, box, grasps, object_pose=hf.Pose.translation(0, 0, 0.72))
    return hf.simulate(
        chain, state, hf.control.GravityCompensation(chain, internal_force=20.0), 0.006, 0.002, name="lift"
    )


def moving(run):
    """Return a run of the same chain whose left base sways, and how."""
    chain, state = run.setting.chain, run.state(0)
    motion = {"left": swaying(chain.arms["left"].base)}
    controller = hf.control.GravityCompensation(chain)
    return hf.simulate(chain, state, controller, 0.004, 0.002, base_motion=motion), motion


@pytest.mark.slow
def test_from_two_files_to_everything(run, tmp_path):
    """A folder, tables, an MCAP file, a page and figures, a line each."""
    for extra in ("matplotlib", "viser", "mcap_ros2"):
        pytest.importorskip(extra, reason=f"needs {extra}: pip install -e '.[dev]'")
    assert run.save(tmp_path / "run") == tmp_path / "run"
    assert run.to_csv(str(tmp_path / "run.csv")) == [tmp_path / "run.csv"]
    assert run.to_mcap(tmp_path / "run.mcap").read_bytes().startswith(b"\x89MCAP")
    assert "<title>lift</title>" in run.page(tmp_path / "run.html").read_text(encoding="utf-8")
    figures = run.plot()
    assert {"grasp_wrenches", "joint_torques", "load_share", "closure_and_energy"} == set(figures)
    assert all(type(figure).__name__ == "Figure" for figure in figures.values())
    assert run.summary().samples == 4
    assert repr(run) == "<Trajectory run 'lift' of left, right: 4 samples, 0 to 0.006 s, complete>"


@pytest.mark.slow
def test_comes_back(run, tmp_path):
    """The folder has every bit of arrays and chain; what is read from it writes the same files."""
    result = hf.load_result(run.save(tmp_path / "run"))
    assert result.complete and not result.note and result.meta.scene == "lift"
    for name in array_names():
        assert getattr(result.trajectory, name).tobytes() == getattr(run, name).tobytes(), name
    assert fingerprint(result.setting.chain) == fingerprint(run.setting.chain) == result.meta.model_sha256
    texts = []
    for written in (result, result.trajectory, run):
        written.to_csv(tmp_path / "again.csv")
        written.to_mcap(tmp_path / "again.mcap")
        texts.append([(tmp_path / f"again.{kind}").read_bytes() for kind in ("csv", "mcap")])
    assert texts[0] == texts[1] == texts[2]
    again = hf.load_result(result.save(tmp_path / "copy"))
    assert again.trajectory.q.tobytes() == run.q.tobytes()
    assert "4 samples, complete" in repr(result)


@pytest.mark.slow
def test_pages_show_meshes(run, folder, tmp_path):
    """Arms out of files are drawn with their meshes, after a detour by a folder too; without these with solids."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    result = hf.load_result(run.save(tmp_path / "run"))
    for chain in (run.setting.chain, result.setting.chain):
        link_meshes, missing = meshes_in_files(chain)
        assert not missing
        corners = link_meshes["right"][3][0].mesh.vertices  # of the third link
        assert sorted(map(tuple, np.unique(corners, axis=0))) == sorted(map(tuple, 0.1 * CORNERS))
    assert run.playback().notes == ()
    with_meshes = run.page(tmp_path / "a.html").read_text(encoding="utf-8")
    assert result.page(tmp_path / "b.html").read_text(encoding="utf-8") == with_meshes
    (folder / "link.stl").rename(folder / "gone.stl")
    try:
        link_meshes, missing = meshes_in_files(run.setting.chain)
        assert not link_meshes and "link.stl: no such file" in missing["left"][0]
        page = run.page(tmp_path / "c.html").read_text(encoding="utf-8")
        left, right = run.playback().notes
        assert left.startswith("arm 'left' is drawn with simple solids: ") and "link.stl: no such file" in left
        assert "arm 'right'" in right and "arm 'right' is drawn with simple solids" in page
    finally:
        (folder / "gone.stl").rename(folder / "link.stl")


def test_looks_stay_with_the_arm(run):
    """Another base or tool keeps them; other links drop them; no number and no machine code depends on them."""
    arm = run.setting.chain.arms["left"]
    assert arm.visuals is not None and len(arm.visuals.bodies) == 8
    assert arm.at(hf.Pose.identity()).with_tip(hf.Pose.translation(0, 0, 0.1)).visuals is arm.visuals
    assert replace(arm, joints=arm.joints[:3], links=arm.links[:3]).visuals is None
    assert fingerprint(replace(arm, visuals=None)) == fingerprint(arm)
    with pytest.raises(hf.errors.ModelError, match="visuals: expected"):
        replace(arm, visuals="green")


def test_visuals_that_cannot_be_read():
    """They are no reason to refuse an arm: the notes say what, with its line."""
    text = urdf("odd", 1.0).replace("<inertial>", "<visual><geometry><sphere/></geometry></visual> <inertial>", 1)
    found = hf.robots.urdf_chain(text)
    assert found.arm.visuals is None
    assert any("radius" in note and "simple solids" in note for note in found.notes)


@pytest.mark.parametrize(
    "chain",
    [
        lambda: random_problem(3).chain,
        lambda: random_problem(4, grasps="softfinger").chain,
        lambda: random_trunk_system(5).chain,
        lambda: random_on_trunk(8, 2, floating=True).chain,
        lambda: random_bushed(2).chain,
        lambda: with_springs(random_problem(6).chain),
    ],
)
def test_models_come_back(chain):
    """Chains of every sort pass through JSON without losing a bit."""
    given = chain()
    text = msgspec.json.encode(model_data(given))
    assert fingerprint(model_of(text, "model.json")) == fingerprint(given)


@pytest.mark.slow
def test_bases_that_move(run, tmp_path):
    """A run knows where its bases were, in its folder too, and can be drawn and written without the function."""
    pytest.importorskip("mcap_ros2", reason="needs mcap-ros2-support: pip install 'holdfast[ros]'")
    swayed, motion = moving(run)
    write_mcap(swayed.setting.chain, swayed, tmp_path / "given.mcap", motion)
    result = hf.load_result(swayed.save(tmp_path / "run"))
    for one in (swayed, result, pickle.loads(pickle.dumps(swayed))):
        one.to_mcap(tmp_path / "own.mcap")
        assert (tmp_path / "own.mcap").read_bytes() == (tmp_path / "given.mcap").read_bytes()
    assert np.ptp(result.playback(rate=500.0).base_pose[:, 0, 4:], axis=0).max() > 0
    with pytest.raises(hf.errors.StateError, match="expected the time of a sample"):
        swayed.setting.base_motion["left"](0.0011)


@pytest.mark.slow
def test_the_command_line_reads_it(run, tmp_path, capsys):
    """`holdfast view`, `plot` and `export` take a folder of a Python run as any other."""
    for extra in ("matplotlib", "viser"):
        pytest.importorskip(extra, reason=f"needs {extra}: pip install -e '.[dev]'")
    place = str(run.save(tmp_path / "run"))
    assert main(["view", place, "--export", str(tmp_path / "page.html")]) == 0
    assert main(["plot", place]) == 0
    assert main(["export", place, "--format", "csv"]) == 0
    assert capsys.readouterr().err == ""
    run.page(tmp_path / "own.html")
    assert (tmp_path / "own.html").read_bytes() == (tmp_path / "page.html").read_bytes()


def test_results_of_scenes_have_the_methods(tmp_path, monkeypatch):
    """What `holdfast simulate` wrote does the same; its chain comes from its scene."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hold.toml").write_text(SCENE, encoding="utf-8")
    assert main(["simulate", "hold.toml", "--out", "run", "--no-plots"]) == 0
    result = hf.load_result("run")
    assert result.summary().samples == 3
    assert main(["export", "run", "--format", "csv"]) == 0
    result.to_csv("own.csv")
    assert (tmp_path / "own.csv").read_bytes() == (tmp_path / "run" / "trajectory.csv").read_bytes()
    with pytest.raises(hf.errors.StateError, match="expected one that knows its chain"):
        result.trajectory.save("other")
    assert hf.load_result(result.save("other")).trajectory.tau.tobytes() == result.trajectory.tau.tobytes()


SCENE = """
[[arms]]
name = "left"
robot = "panda"
q = [0.0, -0.6, 0.0, -2.3, 0.0, 3.3, 1.57]
[object]
mass = 1.0
box = [0.1, 0.1, 0.1]
pose = { position = [0.5, 0.0, 0.5] }
[[grasps]]
arm = "left"
kind = "ball"
[controller]
type = "gravity_compensation"
[simulation]
duration = 0.004
step = 0.002
"""


def test_refusals(run, tmp_path):
    """Runs that cannot, places that are taken: an error of the library's own, and nothing is written."""
    empty = replace(run, **{name: getattr(run, name)[:0] for name in array_names()})
    for method in (*WRITES, "plot", "summary", "playback", "show"):
        arguments = [tmp_path / "x"] if method in WRITES else []
        for bad, what in ((replace(run, setting=None), "Setting"), (empty, "expected samples, got none")):
            try:
                with pytest.raises(hf.errors.StateError, match=what):
                    getattr(bad, method)(*arguments)
            except hf.errors.MissingExtra:
                continue
    for method in WRITES:
        for path in (None, 3, b"bytes", "", "a\0b", "x" * 5000, "/proc/nowhere/run", ["a"]):
            with pytest.raises(hf.HoldfastError):
                getattr(run, method)(path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(hf.errors.ModelError, match="name: expected"):
        hf.simulate(run.setting.chain, run.state(0), lambda t, s, m: (s.q, m), 0.1, 0.1, name=3)
    assert repr(empty) == "<Trajectory without samples>"


def test_folders_in_use(run, tmp_path):
    """An earlier result is replaced when asked; anything else is left alone."""
    run.save(tmp_path / "run")
    with pytest.raises(hf.errors.ResultError, match=r"holds an earlier result; try overwrite=True"):
        run.save(tmp_path / "run")
    shorter = replace(run, **{name: getattr(run, name)[:2] for name in array_names()}, stopped="ended by hand")
    shorter.save(tmp_path / "run", overwrite=True)
    result = hf.load_result(tmp_path / "run")
    assert result.samples == 2 and "ended by hand" in result.note
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    with pytest.raises(hf.errors.ResultError, match=r"found 'thesis\.txt' in it"):
        run.save(tmp_path / "mine", overwrite=True)
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "mine"


def test_damaged_models(run, tmp_path):
    """What model.json may have become: every reading is a ResultError that names the file."""
    place = run.save(tmp_path / "run")
    text = (place / "model.json").read_text()
    data = json.loads(text)
    heavier = json.loads(text.replace('"mass":3.0', '"mass":4.0'))
    others = [data | {"arms": 3}, data | {"colour": 1}, data | {"gravity": {"is": "inf"}}]
    parts = [{"is": "Friction", "mu": 1}, {"is": "rm"}, {"is": "mapping", "of": []}]
    for bad in (None, [], 3, heavier, *others, *parts):
        (place / "model.json").write_text(json.dumps(bad))
        with pytest.raises(hf.errors.ResultError, match=r"model\.json"):
            _ = hf.load_result(place).setting
    for bad in (b"", text.encode()[:-40], b"\xff" * 40, b"[" * 100_000):
        (place / "model.json").write_bytes(bad)
        with pytest.raises(hf.errors.ResultError, match=r"model\.json"):
            _ = hf.load_result(place).setting


def test_show(run, monkeypatch):
    """A browser opens the page's file; without one the message names it; in a notebook it is in the cell."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    path = run.show(rate=2.0)
    try:
        assert opened == [path.as_uri()]
        assert path.read_text(encoding="utf-8").rstrip().endswith("</html>")
    finally:
        path.unlink()
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    with pytest.raises(hf.errors.ResultError, match=r"the page is (\S+)\. Try run\.page"):
        inline.shown("<html></html>", "x")
    monkeypatch.setattr(inline, "in_notebook", lambda: True)
    shown = run.show(rate=2.0)
    assert repr(shown) == "<page of 'lift'>"
    assert shown._repr_html_().startswith('<iframe title="lift" srcdoc="&lt;!')


@pytest.mark.slow
def test_in_a_notebook(run, monkeypatch):
    """A run shows its summary and a figure, figures show themselves; without matplotlib the summary is left."""
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")
    assert run._repr_html_().count("<img") == 1
    assert "closure error (position)" in run._repr_html_()
    figures = run.plot()
    assert figures._repr_html_().count("<img") == 4
    assert pickle.loads(pickle.dumps(figures["load_share"]))._repr_png_().startswith(b"\x89PNG")
    assert replace(run, setting=None)._repr_html_() is None
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    assert "<img" not in run._repr_html_()
    with pytest.raises(hf.errors.MissingExtra, match=r"pip install 'holdfast\[plot\]'"):
        run.plot()


def test_an_entry_of_the_log_reads_as_one_line():
    """Its time, its kind and its text; the numbers stay in its attributes."""
    entry = Occurrence(0.25, "lift", "foot/table", "'foot/table' lifts", impulse=(0.0, 0.0, 1.0))
    assert str(entry) == "0.25 s, lift: 'foot/table' lifts"
