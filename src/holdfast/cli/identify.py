"""`holdfast identify`: payload, links, friction, drives and sensors of a scene, from recordings of a robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from holdfast.cli.console import is_standard, print_document, refuse_standard, stdout
from holdfast.cli.options import Changes, Folder, Format, Names, PackageOptions, Switch
from holdfast.cli.results import opened_scene, written_page
from holdfast.cli.streams import EXIT_REFUSED
from holdfast.errors import SceneError
from holdfast.identification.assessment import Assessment, assess
from holdfast.identification.load_recording import load_recording
from holdfast.identification.machine.prior import Prior
from holdfast.identification.recording import Recording
from holdfast.io.files import one_line
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.scenario.build import Scenario
from holdfast.view.identification_report import identification_page

RecordingFiles = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING ...")]
OtherRecording = Annotated[Path | None, tyro.conf.arg(metavar="RECORDING")]
SceneOfRecording = Annotated[Path, tyro.conf.arg(metavar="SCENE")]
Deviations = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="KIND=DEVIATION")]
KnownMasses = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="RECORDING=MASS[,X,Y,Z]")]
PREFERRED = ("tau", "current", "wrist_wrench", "wrist_force")
IDENTIFICATION_PAGE = "identification.html"
DENSITY_OF_STEEL = 7850.0  # kg/m^3


def identify(
    recordings: RecordingFiles,
    model: SceneOfRecording,
    by: Literal["tau", "current", "wrist_wrench", "wrist_force"] | None = None,
    unknowns: Names = (),
    prior: Deviations = (),
    added: KnownMasses = (),
    held_out: OtherRecording = None,
    robust: Switch = False,
    out: Folder = None,
    format: Format = "table",
    changes: Changes = (),
    trust_xacro: Switch = False,
    packages: PackageOptions = (),
) -> int:
    """Estimate payload, links, friction, drives or sensors of a scene from recordings, and say how good the fit is.

    Args:
        recordings: .csv, .parquet, .npz, .mcap or result folders; by default that of the scene's [recording] table,
            which says what columns mean.
        model: the scene with the arms, grasps and object, and perhaps a [recording] table.
        by: what is measured; by default the first of tau, current, wrist_wrench, wrist_force that was recorded.
        unknowns: payload, links, armature, damping, friction, friction_offset, friction_asymmetry, drive_gain,
            sensor_offset, sensor_scale, sensor_drift or time_offset; may be repeated; by default payload (if held) and
            friction or sensor offsets.
        prior: standard deviation of a kind of unknowns about the model, such as links=0.1; may be repeated.
        added: a known mass [kg] that was fixed to the object in a recording, a ball of steel at x, y, z in object axes
            [m], its origin by default, such as log2.csv=2.0; may be repeated.
        held_out: a recording that is not used, but predicted; by default the last third of each.
        robust: let samples that are far off count less.
        out: folder for figures and one HTML page.
        format: a table, or one JSON document.
        changes: set a key of the scene, such as recording.cutoff=10; may be repeated.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
        packages: the folder of a package that a robot's file refers to; may be repeated.

    Returns:
        0, or 3 if the fit is bad: the lines `bad fit: ...` say by which criterion.

    Raises:
        SceneError: the scene is invalid.
        ResultError: a recording cannot be read, or a column is wrong.
        StateError: a recording does not match the scene, or shows too little.
    """
    refuse_standard(out)
    scenario = opened_scene(model, trust_xacro, changes, packages)
    files = recordings or _of_scene(scenario, model)
    others = () if held_out is None else (held_out,)
    weights = _added(added, (*files, *others))
    whole = [
        replace(load_recording(file, scenario.chain, columns=scenario.recording), added=weights.get(file))
        for file in (*files, *others)
    ]
    read, later = whole[: len(files)], whole[len(files)] if others else None
    measured = by or next((one for one in PREFERRED if all(getattr(x, one) is not None for x in read)), None)
    if measured is None:
        raise SceneError(f"{files[0]}: expected torques, currents, or forces at wrists; got positions only")
    found = assess(
        scenario.chain,
        read,
        by=measured,
        unknowns=unknowns or _usual(scenario.chain, measured),
        held_out=later,
        prior=_prior(prior),
        loss="huber" if robust else "squares",
    )
    written = written_page(identification_page, found, out, IDENTIFICATION_PAGE, f"Identification of {scenario.name}")
    if format == "json":
        print_document(_as_json(found, read, written))
    else:
        stdout().print("\n".join([str(found), *(f"look at {one}" for one in written)]), soft_wrap=True, markup=False)
    return EXIT_REFUSED if found.criteria else 0


def _of_scene(scenario: Scenario, model: Path) -> tuple[Path, ...]:
    """Return the recording that a scene names."""
    if scenario.recording is None or scenario.recording.file is None:
        raise SceneError("Missing: RECORDING; expected a file, or recording.file in the scene")
    return ((Path() if is_standard(model) else model.parent) / scenario.recording.file,)


def _usual(chain: ClosedChain, by: str) -> tuple[str, ...]:
    """Return what is sought by default."""
    held = ("payload",) if chain.grasps else ()
    if by in ("tau", "current"):
        gains = ("drive_gain",) if by == "current" else ()
        return (*held, "damping", "friction", "friction_offset", *gains)
    return (*held, "sensor_offset")


def _added(given: tuple[str, ...], files: tuple[Path, ...]) -> dict[Path, HeldObject]:
    """Return the bodies in texts `recording=mass,x,y,z` by file, which may be named without its folder."""
    found = dict[Path, HeldObject]()
    for one in given:
        name, _, value = one.rpartition("=")
        named = [file for file in files if name in (str(file), file.name)]
        if len(named) != 1:
            known = [str(file) for file in files]
            said = "is the name of several" if named else f"expected one of {', '.join(known)}"
            raise SceneError(f"--added: '{one_line(name, 60)}': {said}.{checks.did_you_mean(name, known)}")
        try:
            mass, *place = map(float, value.split(","))
        except ValueError as cause:
            raise SceneError(f"--added: {name}: expected MASS or MASS,X,Y,Z, got '{one_line(value, 60)}'") from cause
        if len(place) not in (0, 3):
            raise SceneError(f"--added: {name}: expected MASS or MASS,X,Y,Z, got {1 + len(place)} numbers")
        ball = HeldObject.sphere(mass, float(np.cbrt(mass / (4.0 / 3.0 * np.pi * DENSITY_OF_STEEL))))
        found[named[0]] = replace(ball, com=place or np.zeros(3))
    return found


def _prior(given: tuple[str, ...]) -> Prior:
    """Return the prior in texts `kind=deviation`."""
    known, values = list(Prior.__dataclass_fields__), dict[str, float]()
    for one in given:
        kind, _, value = one.partition("=")
        if kind not in known:
            raise SceneError(f"--prior: no kind '{one_line(kind, 60)}'.{checks.did_you_mean(kind, known)}")
        try:
            values[kind] = float(value)
        except ValueError as cause:
            raise SceneError(f"--prior: {kind}: expected a number, got '{one_line(value, 60)}'") from cause
    return Prior(**values)


def _as_json(found: Assessment, read: list[Recording], files: list[str]) -> dict[str, Any]:
    """Return the document that `--format json` prints; deviations that are infinite are null."""
    made = found.found
    held = None if found.held_out is None else dict(zip(found.channels, found.held_out.tolist(), strict=True))
    return {
        "by": found.by,
        "samples": [len(one) for one in read],
        "values": dict(zip(made.names, made.values.tolist(), strict=True)),
        "deviations": {name: x if np.isfinite(x) else None for name, x in made.deviations.items()},
        "before": dict(zip(made.names, made.before.tolist(), strict=True)),
        "kept": list(made.kept),
        "partly": list(made.partly),
        "undetermined": list(made.undetermined),
        "fitted": dict(zip(found.channels, found.fitted.tolist(), strict=True)),
        "held_out": held,
        "misfit": made.misfit,
        "criteria": list(found.criteria),
        "notes": list(made.notes),
        "files": files,
    }
