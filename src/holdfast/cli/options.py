"""The types of the commands' arguments and options, as the parser needs them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

CaseFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
Diagnosed = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|FILE")]
SceneFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]
Folder = Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")]
Name = Annotated[str, tyro.conf.arg(metavar="NAME")]
ResultFolders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RESULT ...")]
Changes = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="set", metavar="KEY=VALUE")]
PackageOptions = Annotated[
    tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="package", metavar="NAME=FOLDER")
]
Swept = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|FOLDER")]
Targets = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RESULT|SCENE ...")]
OutFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Seconds = Annotated[float | None, tyro.conf.arg(metavar="SECONDS")]
OptionalName = Annotated[str | None, tyro.conf.arg(metavar="NAME")]
Names = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME")]
SchedulerAddress = Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")]
RunNumber = Annotated[int | None, tyro.conf.arg(metavar="NUMBER")]
Format = Literal["table", "json"]
TableFormat = Literal["csv", "parquet", "mcap"]
Switch = tyro.conf.FlagCreatePairsOff[bool]
