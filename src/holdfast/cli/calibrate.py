"""`holdfast calibrate`: where bases, grasps and joints of a scene really are, from a table of closed postures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from holdfast.calibration.calibrate import Calibration
from holdfast.calibration.calibrate import calibrate as calibration_of
from holdfast.calibration.noise import ClosureNoise
from holdfast.calibration.postures import load_postures
from holdfast.cli.console import print_document, refuse_standard, stdout
from holdfast.cli.options import Changes, Folder, Format, Names, PackageOptions, Switch
from holdfast.cli.results import opened_scene, written_page
from holdfast.cli.streams import EXIT_REFUSED
from holdfast.errors import SceneError
from holdfast.view.calibration_report import calibration_page

PostureFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POSTURES")]
OtherFile = Annotated[Path | None, tyro.conf.arg(metavar="POSTURES")]
SceneOfPostures = Annotated[Path, tyro.conf.arg(metavar="SCENE")]
CALIBRATION_PAGE = "calibration.html"


def calibrate(
    postures: PostureFile,
    model: SceneOfPostures,
    seek: Names = (),
    noise: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="TURN SHIFT JOINTS")] = None,
    held_out: OtherFile = None,
    robust: Switch = False,
    out: Folder = None,
    format: Format = "table",
    changes: Changes = (),
    trust_xacro: Switch = False,
    packages: PackageOptions = (),
) -> int:
    """Estimate where bases, grasps and joints are, from postures in which the grasps of a scene are closed.

    Args:
        postures: joint positions, .csv or .parquet, with columns such as `q left/joint1 [rad]`.
        model: the scene with the arms, grasps and object.
        seek: bases, grasps, tips, offsets, geometry or loops, or a part as `offsets:left`; may be repeated; bases and
            grasps by default.
        noise: standard deviations of closed angles [rad], closed lengths [m] and joints [rad or m]; estimated without.
        held_out: postures that are not used, but predicted.
        robust: let postures that fit badly count less.
        out: folder for figures and one HTML page.
        format: a table, or one JSON document.
        changes: set a key of the scene, such as simulation.step=0.001; may be repeated.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
        packages: the folder of a package that a robot's file refers to; may be repeated.

    Returns:
        0, or 3 if the fit is bad: its notes say why.

    Raises:
        SceneError: the scene is invalid.
        ResultError: a table cannot be read.
        StateError: the postures do not match the scene, or show too little.
    """
    refuse_standard(out)
    scenario = opened_scene(model, trust_xacro, changes, packages)
    chain = scenario.chain
    given = None if noise is None else ClosureNoise(*noise)
    later = None if held_out is None else load_postures(held_out, chain)
    sought = seek or ("bases", "grasps")
    if any(one.partition(":")[0] in ("markers", "sensors") for one in sought):
        raise SceneError("--seek: markers and sensors need measured poses, which tables do not have; try hf.calibrate")
    found = calibration_of(chain, load_postures(postures, chain), sought, noise=given, held_out=later, robust=robust)
    written = written_page(calibration_page, found, out, CALIBRATION_PAGE, f"Calibration of {scenario.name}")
    if format == "json":
        print_document(_as_json(found, written))
    else:
        shown = "\n".join([str(found), *(f"look at {one}" for one in written)])
        stdout().print(shown, soft_wrap=True, markup=False, highlight=False)
    return EXIT_REFUSED if found.notes else 0


def _as_json(found: Calibration, files: list[str]) -> dict[str, object]:
    """Return the document that `--format json` prints; deviations that are infinite are null."""
    deviations = {name: x if np.isfinite(x) else None for name, x in found.deviations.items()}
    return {
        "values": dict(zip(found.names, found.values.tolist(), strict=True)),
        "deviations": deviations,
        "undetermined": list(found.undetermined),
        "open": {str(name): list(pair) for name, pair in found.errors.items()},
        "held_out": {str(name): list(pair) for name, pair in (found.held_out or {}).items()},
        "misfit": found.misfit,
        "notes": list(found.notes),
        "files": files,
    }
