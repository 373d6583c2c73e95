"""Expansion of xacro files by the package xacrodoc."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import Any

from holdfast.errors import MissingExtra, SceneError
from holdfast.robots.packages import Packages
from holdfast.robots.urdf.document import shortened


def expanded(
    path: str, name: str, xacro_args: dict[str, str], trusted: bool, packages: Packages
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
def _searching(module: Any, packages: Packages, found: dict[str, str]) -> Iterator[None]:
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
