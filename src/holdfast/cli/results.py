"""Scenes and result folders as arguments of commands; `holdfast plot`, `holdfast export` and `holdfast summary`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.cli.console import is_standard, print_document, read_input, refuse_standard, stdout, write_stdout
from holdfast.cli.options import Folder, OutFile, ResultFolders, Switch, TableFormat
from holdfast.cli.streams import complain, say
from holdfast.errors import ResultError, SceneError
from holdfast.interop.mcap_writer import write_mcap
from holdfast.io.files import make_folder, require_file
from holdfast.io.result_meta import SCENE, ResultMeta
from holdfast.io.result_reader import Result, load_result
from holdfast.io.result_reader import setting_of as setting_in
from holdfast.io.tables import export_csv, export_parquet, occurrences_path
from holdfast.model.fingerprint import fingerprint
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.robots.packages import given_packages
from holdfast.scenario.build import LARGEST_SCENE, Scenario, parse_scene
from holdfast.scenario.robots import RobotFiles
from holdfast.simulation.setting import Setting
from holdfast.simulation.summary import summarise
from holdfast.view.comparison import MOST_COMPARED, compare_runs
from holdfast.view.plots import save_plots, write_figures
from holdfast.view.summary_table import summary_table

COMPARISON = Path("results") / "comparison"  # folder for the figures of several runs, unless --out names one


def require_one_place(folders: Sequence[Path], out: Path | None) -> None:
    """Refuse a command without a run, or with several runs for one output.

    Raises:
        ResultError: there is no run, or there are several.
    """
    if not folders:
        raise ResultError("Missing: RESULT; expected one result folder or more")
    if out is not None and len(folders) > 1:
        raise ResultError(f"--out: expected one result folder, got {len(folders)}; try without it, or one by one")


def labels(places: Sequence[Path], most: int, what: str = "RESULT") -> list[str]:
    """Return for each place the shortest end of its path that distinguishes it from the others.

    Args:
        places: result folders or scenes.
        most: largest number that can be shown together.
        what: the kind of arguments that the command takes, for messages.

    Raises:
        ResultError: there are none, there are too many, or one is named twice.
    """
    if not places:
        raise ResultError(f"Missing: {what}; expected one or more")
    if len(places) > most:
        raise ResultError(f"{what}: expected at most {most} together, got {len(places)}; try some of them")
    parts = [place.resolve().parts for place in places]
    for i, one in enumerate(parts):
        if one in parts[:i]:
            raise ResultError(f"{what}: expected different ones, got {places[i]} twice; try each once")
    longest = max(map(len, parts))
    length = next(k for k in range(1, longest + 1) if len({one[-k:] for one in parts}) == len(parts))
    return ["/".join(one[-length:]) for one in parts]


def written_page(page: Callable[..., dict[str, Any]], found: Any, out: Path | None, name: str, title: str) -> list[str]:
    """Write figures of what was found and an HTML page of a name into a folder; return their paths, the page first."""
    if out is None:
        return []
    make_folder(out)
    return [str(out / name), *(str(out / one) for one in write_figures(page(found, out / name, title), out))]


def opened_scene(
    path: Path,
    trust_xacro: bool,
    changes: Sequence[str] = (),
    packages: Sequence[str] = (),
    given: bytes | None = None,
) -> Scenario:
    """Return a scene's scenario; print on stderr what in its robot files was changed or ignored.

    Args:
        path: the file; `-` for stdin, for which robot files are relative to the current folder.
        trust_xacro: expand xacro files that the scene names.
        changes: values for keys of the scene, as `key=value`.
        packages: folders of packages, as `name=folder`.
        given: content of stdin, if it was read already.

    Raises:
        SceneError, ClosureError: as for `load_scene`.
    """
    text, source = read_input(path, LARGEST_SCENE) if given is None else (given, "stdin")
    files = RobotFiles(path.parent, trust_xacro, packages=_folders(packages))
    scenario = parse_scene(text, source, scene_name(path), files, changes)
    for note in scenario.notes:
        say(f"note: {note}")
    return scenario


def _folders(packages: Sequence[str]) -> dict[str, str]:
    """Return the folders of packages by name."""
    for one in packages:
        if not all(one.partition("=")):
            raise SceneError(f"--package: expected NAME=FOLDER, got {one[:200]!r}")
    return given_packages(
        {name: folder for name, _, folder in (one.partition("=") for one in packages)}, Path(), "--package"
    )


def scene_name(path: Path) -> str:
    """Return the name of a scene that has none of its own."""
    return "stdin" if is_standard(path) else path.stem


def refuse_scene_options(changes: Sequence[str], packages: Sequence[str], given: str) -> None:
    """Refuse `--set` and `--package` for what is no scene.

    Raises:
        SceneError: one of them is given; the message says for what.
    """
    if changes:
        raise SceneError(f"--set: expected a scene, whose keys it sets, got {given}")
    if packages:
        raise SceneError(f"--package: expected a scene, whose robot files refer to it, got {given}")


def recorded(folder: Path, trust_xacro: bool = False) -> tuple[Setting, Result]:
    """Return setting and result of a folder; print on stderr what is missing if the run is incomplete.

    Raises:
        ResultError, SceneError, ClosureError: as for `setting_of`.
    """
    result = load_result(folder)
    setting = setting_of(result, trust_xacro)
    if result.note:
        complain(f"{folder}: {result.note}")
    return setting, result


def setting_of(result: Result, trust_xacro: bool = False) -> Setting:
    """Return the setting of a run; print on stderr if its scene no longer describes the simulated model.

    Raises:
        ResultError, SceneError, ClosureError: as for `Result.setting`.
    """
    if result.keeps_model:
        return result.setting
    found = setting_in(result.folder, result.meta, trust_xacro)
    if fingerprint(found.chain) != result.meta.model_sha256:
        complain(f"{result.folder / SCENE}: no longer describes the simulated model; has a robot file changed?")
    return found


def chain_for_figures(folder: Path, trust_xacro: bool = False) -> tuple[hf.ClosedChain, Result]:
    """Return the chain of a run and the run; if its robots are not available, the chain has only their names.

    Raises:
        ResultError: there is no result, or its scene.toml describes another chain.
    """
    result = load_result(folder)
    try:
        chain = setting_of(result, trust_xacro).chain
    except SceneError as cause:
        if result.meta.robots or not result.meta.scene_folder:
            raise
        complain(f"{cause}; drawn without the robots' limits")
        chain = _named(result.meta)
    if result.note:
        complain(f"{folder}: {result.note}")
    return chain, result


def _named(meta: ResultMeta) -> hf.ClosedChain:
    """Return a chain with the names and kinds of the arms, joints and grasps of a run, which suffices for figures.

    Raises:
        ResultError: meta.json contradicts itself.
    """
    arms = {}
    for name in meta.arms:
        kinds: list[tuple[str, Any]] = [  # Joint refuses unknown kinds
            (joint.removeprefix(f"{name}/"), kind)
            for joint, kind in zip(meta.joints, meta.joint_kinds, strict=False)
            if joint.startswith(f"{name}/")
        ]
        joints = [hf.Joint(kind, np.array([0.0, 0.0, 1.0]), hf.Pose.identity(), name=joint) for joint, kind in kinds]
        links = [hf.Link(1.0, np.zeros(3), np.eye(3))] * len(joints)
        arms[name] = hf.Arm(joints, links) if joints else hf.Anchor()
    subspace, none = np.eye(6)[:, :1], np.zeros(6)
    needed = ("threaded", "pitch", 1.0), ("by_hand", "motion", subspace), ("compliant", "stiffness", none)
    grasps, grasp_kinds = {}, dict[str, Any](meta.grasps)
    for name, kind in grasp_kinds.items():  # Grasp refuses unknown kinds
        own: dict[str, Any] = {key: value for flag, key, value in needed if getattr(GRASP_KINDS.get(kind), flag, False)}
        grasps[name] = hf.Grasp(kind, hf.Pose.identity(), **own)
    return hf.ClosedChain(arms, hf.HeldObject(1.0, np.eye(3)), grasps)


def plot(results: ResultFolders = (), out: Folder = None, json: Switch = False, trust_xacro: Switch = False) -> int:
    """Draw the figures of a run: wrenches, margins, torques, load share, closure and energy; or compare several runs.

    Args:
        results: the result folder; of several, the runs are drawn over each other.
        out: the folder for the figures; without it the result folder, or results/comparison for several.
        json: print one JSON document instead of lines.
        trust_xacro: expand the xacro files of a result of holdfast 0.1, which does not contain its robots.

    Returns:
        0.

    Raises:
        ResultError: there is no result, a folder is named twice, there are too many, or a folder cannot be written.
        MissingExtra: matplotlib is not installed.
    """
    refuse_standard(out)
    names = labels(results, MOST_COMPARED)
    runs = [chain_for_figures(folder, trust_xacro) for folder in results]
    place = out or (results[0] if len(runs) == 1 else COMPARISON)
    make_folder(place)
    if len(runs) == 1:
        written = save_plots(runs[0][0], runs[0][1].trajectory, place)
    else:
        known = [replace(result.trajectory, setting=Setting(chain)) for chain, result in runs]
        written = write_figures(compare_runs(dict(zip(names, known, strict=True))), place)
    files = [str(place / name) for name in written]
    if json:
        print_document({"results": [str(folder) for folder in results], "files": files})
    for file in () if json else files:
        stdout().print(f"look at {file}", soft_wrap=True)
    return 0


def export(
    results: ResultFolders = (),
    format: TableFormat = "csv",
    out: OutFile = None,
    overwrite: bool = False,
    json: Switch = False,
    trust_xacro: Switch = False,
) -> int:
    """Write runs as tables, for pandas, Excel, Matlab and others, or as ROS 2 messages.

    Args:
        results: the result folders.
        format: csv; parquet (pip install 'holdfast[parquet]'); mcap, ROS 2 messages (pip install 'holdfast[ros]').
        out: the file to write, - for stdout; by default trajectory.csv, .parquet or .mcap in the result folder.
        overwrite: replace existing files.
        json: print one JSON document instead of lines.
        trust_xacro: as for `plot`; only MCAP files need the robots.

    Returns:
        0.

    Raises:
        ResultError: there is no result, or a file exists already.
        MissingExtra: the format is parquet without pyarrow, or mcap without mcap-ros2-support.
    """
    require_one_place(results, out)
    if is_standard(out):
        return _export_to_stdout(results[0], format, trust_xacro, json)
    loaded = [(load_result(folder), folder / f"trajectory.{format}" if out is None else out) for folder in results]
    for _, path in loaded:
        require_file(path)
        present = [one for one in (path, occurrences_path(path)) if os.path.lexists(one)]
        if present and not overwrite:
            raise ResultError(f"{present[0]}: exists already; try --overwrite, or another --out")
    documents = []
    for result, path in loaded:
        written = _write_table(result, format, path, trust_xacro)
        if result.note:
            complain(f"{result.folder}: {result.note}")
        files = [str(one) for one in written]
        documents.append({"result": str(result.folder), "files": files, "samples": result.samples})
        if json:
            continue
        stdout().print(f"{path}: {result.samples} samples", soft_wrap=True)
        for log in written[1:]:
            stdout().print(f"{log}: events", soft_wrap=True)
    if json:
        print_document(documents)
    return 0


def _export_to_stdout(folder: Path, format: str, trust_xacro: bool, as_json: bool) -> int:
    if as_json:
        raise ResultError("--out -: stdout takes the table or, with --json, a report; try one of them")
    result, more = load_result(folder), []
    write_stdout(lambda path: more.extend(_write_table(result, format, path, trust_xacro)[1:]), f"trajectory.{format}")
    if result.note:
        complain(f"{folder}: {result.note}")
    if more:
        say("note: events are a second table, which is written only with --out FILE")
    return 0


def _write_table(result: Result, format: str, path: Path, trust_xacro: bool) -> list[Path]:
    """Write a run in a format, and return the files written."""
    if format == "mcap":
        setting = setting_of(result, trust_xacro)
        write_mcap(setting.chain, result.trajectory, path, setting.base_motion)
        return [path]
    return {"csv": export_csv, "parquet": export_parquet}[format](result, path)


def summary(results: ResultFolders = (), json: Switch = False, trust_xacro: Switch = False) -> int:
    """Print the summaries of runs: closure, energy, momentum, peak wrenches, margins, events.

    Args:
        results: the result folders.
        json: print one JSON document instead of tables.
        trust_xacro: as for `plot`.

    Returns:
        0.

    Raises:
        ResultError, SceneError, ClosureError: as for `setting_of`.
    """
    require_one_place(results, None)
    runs = [(folder, *recorded(folder, trust_xacro)) for folder in results]
    found = [(f, result.complete, summarise(setting.chain, result.trajectory)) for f, setting, result in runs]
    if json:
        print_document([{"result": str(f), "complete": whole, "summary": asdict(one)} for f, whole, one in found])
        return 0
    for folder, _, one in found:
        stdout().print(str(folder), soft_wrap=True)
        stdout().print(summary_table(one))
    return 0
