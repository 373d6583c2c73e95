"""Sources of URDF text: a string, a file, or a xacro file, which is expanded first by the package xacrodoc."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from importlib import import_module
from io import StringIO
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from holdfast.errors import MissingExtra, SceneError
from holdfast.robots.packages import PackageFolders, given_packages
from holdfast.robots.urdf.document import LARGEST_URDF, quoted, shortened
from holdfast.spatial.frozen import FrozenDict

WHERE_A_ROOT_IS = 1000  # [characters] of a text, in which its outermost element is looked for


@dataclass(frozen=True)
class UrdfSource:
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
    path_or_text: str | PathLike[str] | UrdfSource,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
    packages: Mapping[str, str | PathLike[str]] | None = None,
) -> UrdfSource:
    """Return the text of a URDF from a string, a file or a xacro file; a `UrdfSource` is returned unchanged.

    Raises:
        SceneError: the file cannot be read or expanded, it is a .xacro file and `trust_xacro` is False, or `xacro_args`
            are given for another file, or a given package is no folder.
        MissingExtra: the file is a .xacro file, and xacrodoc is not installed.
    """
    if isinstance(path_or_text, UrdfSource):
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
        text, notes, found = expanded(given, name, dict(xacro_args or {}), trust_xacro, PackageFolders(folder, folders))
        return UrdfSource(f"{name} (expanded)", text, folder, notes, {**folders, **found})
    if is_text:
        name = "SDF text" if "<sdf" in given[:WHERE_A_ROOT_IS] else "URDF text"
    if xacro_args:
        raise SceneError(f"{name}: xacro_args: expected none, since this is no .xacro file")
    if is_text:
        return UrdfSource(name, given.lstrip("\ufeff"), packages=folders)
    return UrdfSource(name, _read_bytes(given, name), Path(given).parent, packages=folders)


def _read_bytes(path: str, name: str) -> bytes:
    """Return the content of a file, at most one byte more than the largest allowed size."""
    try:
        if not Path(path).is_file():  # a directory, or a pipe that might never end
            raise OSError("is not a file" if Path(path).exists() else "no such file")
        with open(path, "rb") as file:
            return file.read(LARGEST_URDF + 1)
    except (OSError, ValueError) as cause:  # ValueError: a path that is not allowed in file systems
        shown = name if isinstance(cause, OSError) else quoted(path)
        raise SceneError(f"{shown}: cannot be read: {getattr(cause, 'strerror', None) or cause}") from cause


def expanded(
    path: str, name: str, xacro_args: dict[str, str], trusted: bool, packages: PackageFolders
) -> tuple[str, tuple[str, ...], dict[str, str]]:
    """Return the text of a xacro file after expansion, notes, and the folders of packages that it asked for, by name.

    Args:
        path: the file.
        name: its name in messages.
        xacro_args: values of its <xacro:arg> elements by name.
        trusted: whether the Python code in it may run.
        packages: the packages that it can refer to; xacrodoc is asked for those that are not found there.

    Raises:
        SceneError: the file is not trusted, or cannot be expanded.
        MissingExtra: xacrodoc is not installed.
    """
    if trusted is not True:  # xacro's own protection does not cover lambdas
        raise SceneError(
            f"{name}: expanding xacro runs the Python code in it and in the files that it includes; if you trust"
            " them all, try trust_xacro=True (--trust-xacro on the command line), or expand it to a .urdf yourself"
        )
    try:
        xacrodoc = import_module("xacrodoc")
    except ImportError as cause:
        raise MissingExtra(f"{name}: xacro files need xacrodoc; try pip install 'holdfast[robots]'") from cause
    printed, found, file = StringIO(), dict[str, str](), Path(path).resolve()
    try:
        with (
            chdir(file.parent),
            _searching(xacrodoc.packages, packages, found),
            redirect_stderr(printed),
            redirect_stdout(printed),
            warnings.catch_warnings(record=True) as warned,
        ):
            warnings.simplefilter("always")  # xacro resolves relative includes from the working directory
            document = xacrodoc.XacroDoc.from_file(file, subargs=xacro_args, resolve_packages=False)
            text = document.to_urdf_string()
    except Exception as cause:  # xacro evaluates expressions, which can raise any error
        reason = shortened(" ".join(f"{printed.getvalue()} {type(cause).__name__}: {cause}".split()), 400)
        missing = [packages.not_found(package) for package, place in found.items() if not place]
        raise SceneError(f"{name}: xacro cannot expand it: {'; '.join(missing) or reason}") from cause
    lines = (*printed.getvalue().splitlines(), *(str(warning.message) for warning in warned))
    notes = tuple(f"{name}: xacro says: {line}" for line in lines if line.strip())
    return text, notes, {package: place for package, place in found.items() if place}


@contextmanager
def _searching(module: Any, packages: PackageFolders, found: dict[str, str]) -> Iterator[None]:
    """Search for packages before xacrodoc does; `found` gets their folders by name, "" if there is none."""
    otherwise = module.get_path

    def folder(name: str) -> str:
        if not found.get(name):
            found[name] = ""
            found[name] = str(packages.find(name) or otherwise(name))
        return found[name]

    module.get_path = folder
    try:
        yield
    finally:
        module.get_path = otherwise
