"""Sources of URDF text: a string, a file, or a xacro file that is expanded first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path

from holdfast.errors import SceneError
from holdfast.robots.packages import Packages, given_packages
from holdfast.robots.urdf.document import LARGEST_FILE, quoted, shortened
from holdfast.robots.urdf.expansion import expanded
from holdfast.spatial.frozen import FrozenDict


@dataclass(frozen=True)
class Source:
    """The text of a URDF file.

    Attributes:
        name: name in messages.
        text: the XML text; bytes if the encoding is not known yet.
        folder: folder to which relative names of meshes refer; None for a text without a file.
        notes: output and warnings of xacro.
        packages: folders of packages by name, as given or as found by xacro.
    """

    name: str
    text: str | bytes
    folder: Path | None = None
    notes: tuple[str, ...] = ()
    packages: Mapping[str, str] = field(default_factory=FrozenDict)


def read_source(
    path_or_text: str | PathLike[str] | Source,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
    packages: Mapping[str, str | PathLike[str]] | None = None,
) -> Source:
    """Return the text of a URDF from a string, a file or a xacro file; a `Source` is returned unchanged.

    Raises:
        SceneError: the file cannot be read or expanded, it is a .xacro file and `trust_xacro` is False, or `xacro_args`
            are given for another file, or a given package is no folder.
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
    name, folders = shortened(given, 200), given_packages(packages)
    is_text = isinstance(path_or_text, str) and given.lstrip("\ufeff \t\r\n").startswith("<")
    if not is_text and given.endswith(".xacro"):
        _read_bytes(given, name)
        folder = Path(given).resolve().parent
        text, notes, found = expanded(given, name, dict(xacro_args or {}), trust_xacro, Packages(folder, folders))
        return Source(f"{name} (expanded)", text, folder, notes, {**folders, **found})
    if xacro_args:
        raise SceneError(f"{'URDF text' if is_text else name}: xacro_args: expected none, since this is no .xacro file")
    if is_text:
        return Source("URDF text", given.lstrip("\ufeff"), packages=folders)
    return Source(name, _read_bytes(given, name), Path(given).parent, packages=folders)


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
