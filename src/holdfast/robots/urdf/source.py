"""Sources of URDF text: a string, a file, or a xacro file that is expanded first."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from os import PathLike, fspath
from pathlib import Path

from holdfast.errors import MissingExtra, SceneError
from holdfast.robots.urdf.document import LARGEST_FILE, quoted, shortened


@dataclass(frozen=True)
class Source:
    """The text of a URDF file.

    Attributes:
        name: name in messages.
        text: the XML text; bytes if the encoding is not known yet.
        folder: folder to which relative names of meshes refer; None for a text without a file.
        notes: output and warnings of xacro.
    """

    name: str
    text: str | bytes
    folder: Path | None = None
    notes: tuple[str, ...] = ()


def read_source(
    path_or_text: str | PathLike[str] | Source, xacro_args: Mapping[str, str] | None = None, trust_xacro: bool = False
) -> Source:
    """Return the text of a URDF from a string, a file or a xacro file; a `Source` is returned unchanged.

    Raises:
        SceneError: the file cannot be read or expanded, it is a .xacro file and `trust_xacro` is False, or `xacro_args`
            are given for another file.
        MissingExtra: the file is a .xacro file, and xacrodoc is not installed.
    """
    if isinstance(path_or_text, Source):
        return path_or_text
    if not isinstance(path_or_text, (str, PathLike)):
        raise SceneError(f"URDF: expected a path or the text of a URDF, got {type(path_or_text).__name__}")
    given = fspath(path_or_text)
    if not isinstance(given, str):
        raise SceneError(f"URDF: expected a path of str, got {type(given).__name__}")
    if not isinstance(xacro_args or {}, Mapping):
        raise SceneError(f"URDF: xacro_args: expected values by name, got a {type(xacro_args).__name__}")
    name = shortened(given, 200)
    is_text = isinstance(path_or_text, str) and given.lstrip("\ufeff \t\r\n").startswith("<")
    if not is_text and given.endswith(".xacro"):
        return _expanded(given, dict(xacro_args or {}), trust_xacro)
    if xacro_args:
        raise SceneError(f"{'URDF text' if is_text else name}: xacro_args: expected none, since this is no .xacro file")
    if is_text:
        return Source("URDF text", given.lstrip("\ufeff"))
    return Source(name, _read_bytes(given, name), Path(given).parent)


def _read_bytes(path: str, name: str) -> bytes:
    """Return the content of a file, at most one byte more than the largest allowed size."""
    try:
        if not Path(path).is_file():  # a directory, or a pipe that might never end
            raise OSError("is not a file" if Path(path).exists() else "no such file")
        with open(path, "rb") as file:
            return file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as cause:  # ValueError: a path that is not allowed in file systems
        shown = name if isinstance(cause, OSError) else quoted(path)
        raise SceneError(f"{shown}: cannot be read: {getattr(cause, 'strerror', None) or cause}") from cause


def _expanded(path: str, xacro_args: dict[str, str], trusted: bool) -> Source:
    """Return the expansion of a xacro file, whose lines are counted after expansion."""
    name = shortened(path, 200)
    _read_bytes(path, name)
    if trusted is not True:  # xacro's own protection does not cover lambdas
        raise SceneError(
            f"{name}: expanding xacro runs the Python code in it and in the files that it includes; if you trust"
            " them all, try trust_xacro=True (--trust-xacro on the command line), or expand it to a .urdf yourself"
        )
    try:
        xacro_document = import_module("xacrodoc").XacroDoc
    except ImportError as cause:
        raise MissingExtra(f"{name}: xacro files need xacrodoc; try pip install 'holdfast[robots]'") from cause
    printed = StringIO()
    try:
        folder, file = Path(path).resolve().parent, Path(path).name
        with (
            chdir(folder),
            redirect_stderr(printed),
            redirect_stdout(printed),
            warnings.catch_warnings(record=True) as warned,
        ):
            warnings.simplefilter("always")  # xacro resolves relative includes from the working directory
            document = xacro_document.from_file(folder / file, subargs=xacro_args, resolve_packages=False)
            text = document.to_urdf_string()
    except Exception as cause:  # xacro evaluates expressions, which can raise any error
        reason = " ".join(f"{printed.getvalue()} {type(cause).__name__}: {cause}".split())
        advice = "; try xacrodoc.packages.update_package_cache({name: folder})" if "Package not found" in reason else ""
        raise SceneError(f"{name}: xacro cannot expand it: {shortened(reason, 400)}{advice}") from cause
    lines = (*printed.getvalue().splitlines(), *(str(warning.message) for warning in warned))
    notes = tuple(f"{name}: xacro says: {line}" for line in lines if line.strip())
    return Source(f"{name} (expanded)", text, folder, notes)
