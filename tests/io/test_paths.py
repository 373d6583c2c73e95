"""Paths are given as text or as path objects; what is neither, and what is no result or run, is refused by name."""

import inspect
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from benchmarks import faulty_recordings

import holdfast as hf
from holdfast.interop.mcap_writer import write_mcap
from holdfast.robots.urdf import read_urdf
from tests.io.recorded import filled
from tests.robots.two_armed import TWO_ARMED
from tests.simulation.rollout.problems import elsewhere, problem, swinging
from tests.surface import PUBLIC
from tests.sweeps.problems import small_sweep
from tests.view.runs import lifted

EXAMPLES = Path(__file__).parents[2] / "examples"
NO_PATHS = [None, 3, b"bytes", ["a", "b"], "", "a\0b", "x" * 5000]


def record():
    """Return a record of one step of one system."""
    rollout = swinging("one")
    return rollout.run(rollout.start(**elsewhere(*problem("one"), 1)), 0.001, 0.001)


def simulated(folder):
    """Simulate one step into a folder."""
    chain, state = problem("one")[:2]
    return hf.simulate(
        chain, state, lambda t, s, memory: (np.zeros(chain.joint_count), memory), 1e-3, 1e-3, folder=folder
    )


def readers(folder: Path) -> dict:
    """Return what reads a path, and a file or folder for it."""
    filled(folder / "run", 2)
    (folder / "two.urdf").write_text(TWO_ARMED)
    body = '<body name="arm"><joint name="j" axis="0 1 0"/><geom size="0.1"/></body>'
    (folder / "arm.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    hands = "".join(
        f'<body name="{name}"><joint name="{name}" axis="1 0 0"/><geom size="0.1"/></body>'
        for name in ("left", "right")
    )
    on_one = body.replace("</body>", f"{hands}</body>")
    (folder / "hands.xml").write_text(f"<mujoco><worldbody>{on_one}</worldbody></mujoco>")
    chain, _ = lifted()
    titles = ["t", *(f"q {joint}" for joint in chain.joint_names())]
    (folder / "run.csv").write_text(f"{','.join(titles)}\n{','.join('0' for _ in titles)}\n")
    torso = {"base": "torso", "lock_others": True}
    return {
        hf.load_result: (folder / "run", {}),
        hf.io.load_record: (record().save(folder / "record"), {}),
        hf.identification.load_recording: (folder / "run.csv", {"chain": chain}),
        hf.calibration.load_postures: (folder / "run.csv", {"chain": chain}),
        hf.io.load_cases: (EXAMPLES.parent / "tests" / "data" / "cases.json", {}),
        hf.load_scene: (EXAMPLES / "two_pandas.toml", {}),
        hf.load_urdf: (folder / "two.urdf", {"tip": "left_grasp", **torso}),
        hf.robots.urdf_chain: (folder / "two.urdf", {"tip": "left_grasp", **torso}),
        hf.load_urdf_arms: (folder / "two.urdf", {"arms": {"left": ("torso", "left_grasp")}, "lock_others": True}),
        hf.load_urdf_trunk: (folder / "two.urdf", {"tips": ["left_grasp", "right_grasp"], "lock_others": True}),
        read_urdf: (folder / "two.urdf", {}),
        hf.interop.load_mjcf: (folder / "arm.xml", {}),
        hf.interop.load_mjcf_arms: (folder / "arm.xml", {"arms": {"one": ("world", "arm")}}),
        hf.interop.load_mjcf_trunk: (folder / "hands.xml", {"tips": ["left", "right"]}),
    }


@cache
def calibrated() -> hf.calibration.Calibration:
    """Return a calibration."""
    chain, state = lifted()[0], lifted()[1].state(0)
    noise = hf.calibration.ClosureNoise(1e-3, 1e-3)
    return hf.calibrate(chain, np.tile(state.q, (3, 1)), noise=noise)


@cache
def identified() -> hf.identification.Assessment:
    """Return an assessed identification."""
    chain = faulty_recordings.arm()[0]
    columns = faulty_recordings.sound(chain, np.random.default_rng(0))
    parts = {name: np.array([columns[f"{name}{k}"] for k in (1, 2, 3)]).T for name in ("q", "qd", "tau")}
    recording = hf.identification.Recording(columns["t"], **parts)
    return hf.identification.assess(chain, recording, by="tau", unknowns=["friction"])


def writers(folder: Path) -> dict:
    """Return what writes to a path, with what comes before the path, and the path's name."""
    filled(folder / "run", 2)
    chain, run = lifted()
    result = hf.load_result(folder / "run")
    return {
        hf.io.export_csv: ((result,), "run.csv"),
        hf.io.export_parquet: ((result,), "run.parquet"),
        hf.plot.export_page: ((hf.plot.playback_of_run(chain, run, rate=2.0),), "page.html"),
        hf.plot.save_plots: ((chain, run), "."),
        write_mcap: ((chain, run), "run.mcap"),
        hf.plot.calibration_page: ((calibrated(),), "calibration.html"),
        hf.plot.identification_page: ((identified(),), "identification.html"),
    }


@pytest.mark.slow
def test_none_is_left_out(tmp_path):
    """Every public function with a path among its arguments is tried here."""
    tried = {function.__name__ for function in (*readers(tmp_path / "a"), *writers(tmp_path / "b"))}
    public = {path.rpartition(".")[2]: x for path, x in PUBLIC.items() if inspect.isfunction(x)}
    takes_a_path = {
        name
        for name, function in public.items()
        if any("path" in f"{p.name} {p.annotation}".lower() for p in inspect.signature(function).parameters.values())
    }
    of_the_object = {"admittance_law", "follow", "time_path"}  # a motion, not a file
    assert takes_a_path <= tried | {"project", "identify", "next_postures", "write_urdf", *of_the_object, *APART}, (
        takes_a_path
    )


APART = {  # what computes for long once it has a path
    "sweep": small_sweep,
    "load_sweep": hf.sweeps.load_sweep,
    "sweep_scene": lambda path: hf.sweeps.sweep_scene(path, "store"),  # a scene is no path
    "export_c": lambda path: hf.codegen.export_c(problem("one")[0], path, functions=["kinetic_energy"]),
    "simulate": lambda path: simulated(0 if path is None else path),  # None keeps a run in memory only
}


@pytest.mark.parametrize("name", APART)
@pytest.mark.parametrize("given", NO_PATHS)
def test_paths_of_what_computes(given, name, tmp_path, monkeypatch):
    """What is no path is refused before anything is computed."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(hf.HoldfastError):
        APART[name](given)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_read_by_text_and_by_path(tmp_path):
    """The same either way; what is no path is refused with an error of the library's own."""
    for read, (path, options) in readers(tmp_path).items():
        assert path.exists()
        assert type(read(str(path), **options)) is type(read(path, **options))
        for given in NO_PATHS:
            with pytest.raises(hf.HoldfastError):
                read(given, **options)


@pytest.mark.slow
def test_written_by_text(tmp_path):
    """A path as text serves, as path objects do everywhere else; what is no path is refused, and nothing is written."""
    for write, (arguments, name) in writers(tmp_path).items():
        folder = tmp_path / write.__name__
        folder.mkdir()
        try:
            write(*arguments, str(folder / name))
        except hf.errors.MissingExtra:
            continue
        assert list(folder.iterdir())
        before = sorted(tmp_path.rglob("*"))
        for given in NO_PATHS[:-1] if write in (hf.plot.save_plots, hf.plot.export_page) else NO_PATHS:
            with pytest.raises(hf.HoldfastError):
                write(*arguments, given)
        assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("export", [hf.io.export_csv, hf.io.export_parquet])
def test_tables_of_what_is_no_result(tmp_path, export):
    """A run that does not know its chain, a folder's name: the message says how to come by one that does."""
    if export is hf.io.export_parquet:
        pytest.importorskip("pyarrow")
    with pytest.raises(
        hf.errors.StateError, match="expected one that knows its chain, as simulate and load_result return it"
    ):
        export(lifted()[1], tmp_path / "run.csv")
    with pytest.raises(hf.errors.ResultError, match=r"got a str\. Try load_result of it"):
        export("run", tmp_path / "run.csv")
    assert not list(tmp_path.iterdir())


def test_pictures_of_what_is_no_run(tmp_path):
    """A result, the run of another chain, an empty one, arguments in another order: each refused by name."""
    chain, run = lifted()
    filled(tmp_path / "run", 2)
    empty = replace(run, **{name: getattr(run, name)[:0] for name in hf.simulation.trajectory.array_names()})
    one_arm = hf.ClosedChain({"left": chain.arms["left"]}, chain.held_object, {})
    uses: list[Any] = [hf.plot.playback_of_run, lambda chain, run: hf.plot.save_plots(chain, run, tmp_path)]
    for use in uses:
        with pytest.raises(hf.errors.StateError, match=r"expected a Trajectory.*got a Result; try its \.trajectory"):
            use(chain, hf.load_result(tmp_path / "run"))
        with pytest.raises(hf.errors.StateError, match="expected one of this chain with 7 joints, got 14"):
            use(one_arm, run)
        with pytest.raises(hf.errors.StateError, match="expected samples, got none"):
            use(chain, empty)
        with pytest.raises(hf.errors.ModelError, match="expected a ClosedChain, got a Trajectory"):
            use(run, chain)
    with pytest.raises(hf.errors.ModelError, match=r"got a Trajectory; try playback_of_run\(chain, run\)"):
        hf.plot.export_page(cast(Any, run), tmp_path / "page.html")
    assert np.array_equal(hf.plot.playback_of_run(chain, run).t, hf.plot.playback_of_run(chain, run, "run").t)
