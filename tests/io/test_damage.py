"""No damage to a result, a record or a sweep is read as other numbers, and the advised call heals it.

Each folder is compared with what was written: what is read equals it, or its beginning with a note, or is refused by an
error of ours that names a file. Then the call that the message advises is made.
"""

import re
import shutil
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

import holdfast as hf
from holdfast.io.result_folder import ResultWriter
from holdfast.scenario.overrides import toml_text
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Trajectory, array_names, stacked
from tests.control.two_pandas import two_pandas
from tests.io.damages import damage
from tests.io.recorded import SCENE, meta, samples
from tests.io.remembering import Died, dies_at, unlimited
from tests.io.remembering import run as remembering
from tests.longer import mostly_long
from tests.robots.two_armed import TWO_ARMED
from tests.simulation.rollout.problems import elsewhere, problem, swinging

FILE = re.compile(r"[\w]+\.(json|npz|parquet|toml|urdf)")
SOME = 20  # damages of each kind


class Case(NamedTuple):
    """A kind of folder.

    Attributes:
        write: writes the folder; its argument says whether it is another run's.
        read: returns its numbers, with a note; of what is not complete the beginning.
        heal: the call that a message advises.
    """

    write: Callable[[Path, bool], object]
    read: Callable[[Path], tuple[dict[str, Any], str]]
    heal: Callable[[Path], object]


def numbers_of(run: Trajectory) -> dict[str, Any]:
    """Return the arrays of a run, and what happened."""
    return {name: np.asarray(getattr(run, name)) for name in array_names()} | {"occurrences": list(run.occurrences)}


def read_run(folder: Path) -> tuple[dict[str, Any], str]:
    """Return a result's numbers, those of meta.json, and its note."""
    found = hf.load_result(folder)
    own = msgspec.to_builtins(found.meta)
    fixed = {name: own[name] for name in ("model_sha256", "versions", "joints", "units", "duration", "step", "options")}
    return numbers_of(found.trajectory) | {"meta": fixed}, found.note


def write_random(folder: Path, other: bool, overwrite: bool = False) -> None:
    """Write a complete result of random samples."""
    chain, _ = two_pandas()
    writer = ResultWriter(folder, meta(), SCENE, overwrite=overwrite)
    given = samples(6, 100 * other)
    for one in given:
        writer.add(one)
        if one is given[0] or one is given[3]:
            writer.flush()
    writer.finish(summarise(chain, stacked(samples(51))), occurrences=stacked(given).occurrences)


def write_unfinished(folder: Path, other: bool) -> None:
    """Write the beginning of a run, with a checkpoint."""
    with pytest.MonkeyPatch.context() as patched, suppress(Died):
        patched.setattr("holdfast.io.result_folder.CHUNK", 3)
        patched.setattr("holdfast.io.result_folder.LONGEST_WAIT", np.inf)
        if other:
            chain, state = unlimited()
            patched.setattr("tests.io.remembering.unlimited", lambda: (replace(chain, gravity=[0.0, 0.0, -9.0]), state))
        remembering(folder, marked=dies_at(7))


def go_on(folder: Path) -> None:
    """Resume the run, and end it where it is; or do as the refusal says."""
    try:
        remembering(folder, resume=True)
    except hf.errors.ResultError as refusal:
        if "--overwrite" not in str(refusal):
            raise
        remembering(folder, overwrite=True)


def write_bases(folder: Path, other: bool, overwrite: bool = False) -> None:
    """Simulate an arm on a moving base into a folder."""
    chain, state = problem("one")
    up = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    base = chain.arms["arm1"].base

    def heave(t: float) -> tuple[hf.Pose, Any, Any]:
        return hf.Pose(base.R, base.p + 0.5 * t**2 * up[3:]), t * up, up

    def push(t: float, now: hf.State, memory: Any) -> tuple[Any, Any]:
        return np.full(chain.joint_count, 1.0 + other), memory

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("holdfast.io.result_folder.CHUNK", 2)
        how: dict[str, Any] = {"base_motion": {"arm1": heave}, "folder": folder, "overwrite": overwrite}
        hf.simulate(chain, state, push, 0.003, 0.001, **how)


def read_with_bases(folder: Path) -> tuple[dict[str, Any], str]:
    """Return a result's numbers, how its base moved, and its note."""
    found, note = read_run(folder)
    setting = hf.load_result(folder).setting
    moved: Any = setting.base_motion["arm1"]
    return found | {
        "base": [moved.t, moved.p, moved.twist],
        "masses": [x.mass for x in setting.chain.arms["arm1"].links],
    }, note


def write_record(folder: Path, other: bool, overwrite: bool = False) -> None:
    """Let two systems step into a folder."""
    rollout = swinging("one")
    starts = elsewhere(*problem("one"), 3 if other else 2)
    systems = rollout.start(**{name: x[-2:] for name, x in starts.items()})
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("holdfast.io.record_folder.LONGEST_WAIT", 0.0)
        rollout.run(systems, 0.003, 0.001, record=("q", "status"), folder=folder, overwrite=overwrite)


def read_record(folder: Path) -> tuple[dict[str, Any], str]:
    """Return the numbers of a record, its systems and arguments, and its note."""
    found = hf.io.load_record(folder, swinging("one"))
    systems = {name: np.array(x) for name, x in found.systems.arrays.items()}
    assert found.arguments is not None
    begin = {f"first {name}": np.array(x) for name, x in found.arguments.systems.arrays.items()}
    return {
        "t": found.t,
        **found.arrays,
        **systems,
        **begin,
        "stopped": found.stopped,
        "step": found.arguments.step,
    }, found.note


def scene(folder: Path, other: bool) -> Any:
    """Return the scenario of a sweep of a URDF arm."""
    folder.mkdir(exist_ok=True)
    (folder / "two.urdf").write_text(TWO_ARMED)
    arms = [{"name": "left", "urdf": {"file": "two.urdf", "tip": "left_hand", "lock_others": True}, "q": [0.1] * 4}]
    raw = {"arms": arms, "object": {"mass": 1.0, "box": [0.1, 0.1, 0.1]}}
    raw["simulation"] = {"duration": 0.002, "step": 0.001, "on_slip": "record"}
    tau = {"type": "normal", "mean": 0.0, "deviation": 1.0}
    raw["sweep"] = {"count": 8, "chunk": 3, "seed": int(other), "parameters": {"tau": tau}, "outputs": ["q", "qd"]}
    (folder / "scene.toml").write_text(toml_text(raw))
    return hf.load_scene(folder / "scene.toml")


def write_sweep(folder: Path, other: bool = False) -> None:
    """Compute the sweep of a scene."""
    hf.sweeps.sweep_scene(scene(folder.parent / "scene", other), folder)


def read_sweep(folder: Path) -> tuple[dict[str, Any], str]:
    """Return every column of a sweep, and its plan."""
    found = hf.sweeps.load_sweep(folder)
    columns = {title: found.column(title) for title in found.columns}
    return columns | {"plan": found.plan.description(), "rank": found.plan.rollout.generic_rank}, ""


CASES = {
    "result": Case(write_random, read_run, lambda folder: write_random(folder, False, overwrite=True)),
    "unfinished result": Case(write_unfinished, read_run, go_on),
    "result with bases": Case(write_bases, read_with_bases, lambda folder: write_bases(folder, False, overwrite=True)),
    "record": Case(write_record, read_record, lambda folder: write_record(folder, False, overwrite=True)),
    "sweep": Case(write_sweep, read_sweep, write_sweep),
}


def same(found: Any, true: Any, beginning: bool) -> bool:
    """Return whether numbers are those that were written, or the beginning of them."""
    if isinstance(true, np.ndarray):
        x = np.asarray(found)
        head = true[: len(x)] if beginning and true.ndim else true
        same_values = (x == head).all() if x.dtype == object else x.tobytes() == head.tobytes()
        return (x.dtype, x.shape) == (head.dtype, head.shape) and bool(same_values)
    if isinstance(true, list):
        head = true[: len(found)] if beginning else true
        return len(found) == len(head) and all(same(a, b, beginning) for a, b in zip(found, head, strict=True))
    return bool(found == true)


@pytest.fixture(scope="module", autouse=True)
def in_memory():
    """Wait for no disk: nothing here loses power."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("os.fsync", lambda _: None)
        yield


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> dict[str, tuple[Path, Path, dict[str, Any], dict[str, Any]]]:
    """Return folder, another run's folder, the numbers, and those after healing, of each case."""
    pytest.importorskip("pyarrow", reason="needs pyarrow: pip install 'holdfast[parquet]'")
    found = {}
    for name, case in CASES.items():
        place = tmp_path_factory.mktemp(name.replace(" ", "_"))
        case.write(place / "folder", False)
        case.write(place / "twin", True)
        shutil.copytree(place / "folder", place / "healed")
        case.heal(place / "healed")
        found[name] = place / "folder", place / "twin", case.read(place / "folder")[0], case.read(place / "healed")[0]
    return found


def tried(name: str, seed: int, written: Any, place: Path) -> str:
    """Damage a folder and heal it; return what came of it."""
    case, (folder, twin, true, whole) = CASES[name], written[name]
    shutil.copytree(folder, place)
    done, said = damage(place, twin, seed), "note.json"
    try:
        found, note = case.read(place)
        beginning = bool(note)
        assert found.keys() == true.keys(), done
        for title, x in true.items():
            assert same(found[title], x, beginning), (done, title)
        outcome = "read in part" if note and len(found["t"]) < len(true["t"]) else "read"
    except hf.HoldfastError as refusal:
        outcome, said = "refused", str(refusal)
    assert FILE.search(said) and "\n" not in said, (done, said)
    try:
        case.heal(place)
    except hf.HoldfastError as refusal:
        outcome, said = f"{outcome}, not healed", str(refusal)
    if "not" in outcome:
        assert done == f"foreign {MANIFEST[name]}", (done, said)
        return outcome
    found, note = case.read(place)
    assert note == "", (done, note)
    assert all(same(found[title], x, False) for title, x in whole.items()), done
    return f"{outcome}, healed"


MANIFEST = {"sweep": "sweep.json", "unfinished result": "meta.json"}
MANIFEST |= dict.fromkeys(("result", "result with bases"), "meta.json") | {"record": "record.json"}


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(CASES, {*CASES} - {"unfinished result"}))
def test_some_damages(name, written, tmp_path):
    """A hundred of them."""
    for seed in range(SOME):
        tried(name, seed, written, tmp_path / str(seed))


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_2000_damages(written, tmp_path):
    """Two thousand; the counts are printed."""
    counts: dict[str, Counter[str]] = {name: Counter() for name in CASES}
    for seed in range(2000):
        name = list(CASES)[seed % len(CASES)]
        counts[name][tried(name, seed, written, tmp_path / "damaged")] += 1
        shutil.rmtree(tmp_path / "damaged")
    for name, found in counts.items():
        print(f"\n{name}: {dict(sorted(found.items()))}")
