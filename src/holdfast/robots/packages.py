"""Where packages are: one search for `$(find name)` in xacro files and for `package://name` in names of meshes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

from holdfast.errors import SceneError

MANIFEST = "package.xml"
LARGEST_MANIFEST = 2**20  # [bytes]
MOST_FOLDERS = 5000  # that are looked at below one folder
DEPTH = 3  # levels from a workspace to its packages
ROS_PATH, PREFIXES = "ROS_PACKAGE_PATH", ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH")


@dataclass(frozen=True)
class PackageFolders:
    """The packages that a robot's file can refer to.

    Attributes:
        folder: folder of the file, an absolute path; None for a text without a file.
        given: folders of packages by name, which come first.
    """

    folder: Path | None = None
    given: Mapping[str, str] = field(default_factory=dict)

    @property
    def own(self) -> Path | None:
        """The file's package: the nearest folder at or above it with a package.xml, or else the folder's parent."""
        if self.folder is None:
            return None
        return next((at for at in self._upwards() if (at / MANIFEST).is_file()), self.folder.parent)

    @property
    def within(self) -> list[Path]:
        """The folders from that of the file up to its package."""
        own = self.own
        return [] if own is None else [at for at in self._upwards() if at.is_relative_to(own)]

    def _upwards(self) -> tuple[Path, ...]:
        return () if self.folder is None else (self.folder, *self.folder.parents)

    def find(self, name: str) -> Path | None:
        """Return the folder of a package; None if it is not found."""
        return next((place for place in self.places(name) if place.is_dir()), None)

    def places(self, name: str) -> Iterator[Path]:
        """Yield the folders that may be a package, the likeliest first.

        A package has the name in its package.xml or, second, that of its folder. It may be given, be the file's own or
        lie in it, lie beside it or beside a folder above, be in the same workspace (below a folder `src`), in `share`
        of the prefixes in AMENT_PREFIX_PATH and COLCON_PREFIX_PATH, or below the folders in ROS_PACKAGE_PATH.
        """
        if name in self.given:
            yield Path(self.given[name])
        yield from (at for at in self.within if _stated(at) == name)
        others = []
        if (own := self.own) is not None:
            for place in (at / name for at in self._upwards()):
                if place.is_relative_to(own) or (place / MANIFEST).is_file():
                    if _stated(place) in (None, name):
                        yield place
                    else:
                        others.append(place)
            workspace = [at for at in own.parents if at.name == "src"][:1]
            for at, levels in [*((at, 1) for at in (*self.within, own.parent)), *((at, DEPTH) for at in workspace)]:
                yield from (found for found in _packages_below(at, levels) if _stated(found) == name)
        for prefix in (at for variable in PREFIXES for at in _paths_in(variable)):
            yield from (prefix / "share" / name, prefix / name / "share" / name)
        for at in _paths_in(ROS_PATH):
            yield from (found for found in (at, *_packages_below(at, DEPTH)) if (_stated(found) or found.name) == name)
        yield from others

    def not_found(self, name: str) -> str:
        """Return where a package was looked for, and how to say where it is."""
        beside = "" if self.own is None else f"beside {self.own} and the folders above, "
        searched = ", ".join(f"{one} ({'set' if os.environ.get(one) else 'not set'})" for one in (ROS_PATH, *PREFIXES))
        return (
            f"no package {name[:60]!r} {beside}in {searched}; try --package {name}=FOLDER on the command line,"
            f" packages = {{ {name} = 'FOLDER' }} in a scene, packages={{'{name}': 'FOLDER'}} in Python"
        )


def given_packages(packages: Any, at: Path = Path(), what: str = "packages") -> dict[str, str]:
    """Return the folders of packages by name as absolute paths.

    Args:
        packages: folders by name; None for none.
        at: folder to which they are relative.
        what: where they are given, for messages.

    Raises:
        SceneError: `packages` is not a mapping from names to folders that exist.
    """
    if packages is not None and not isinstance(packages, Mapping):
        raise SceneError(f"{what}: expected folders by name, got a {type(packages).__name__}")
    found = {}
    for name, folder in (packages or {}).items():
        if not isinstance(name, str) or not isinstance(folder, str | PathLike):
            raise SceneError(f"{what}: expected the name of a package and its folder, got {name!r:.60}: {folder!r:.60}")
        try:
            place = Path(os.path.abspath(at / os.fsdecode(folder)))
            exists = place.is_dir()
        except (OSError, ValueError):  # a name that is not allowed in file systems
            place, exists = Path(ascii(folder)[:200]), False
        if not exists:
            raise SceneError(f"{what}: {name[:60]!r}: expected a folder, got {place}, which is none")
        found[name] = str(place)
    return found


def _paths_in(variable: str) -> list[Path]:
    """Return the folders that an environment variable lists."""
    return [Path(os.path.abspath(at)) for at in os.environ.get(variable, "").split(os.pathsep) if at]


def _packages_below(folder: Path, levels: int) -> Iterator[Path]:
    """Yield the packages below a folder in the order of their names, without those within packages."""
    level, looked_at = [folder], 0
    for _ in range(levels):
        level, above = [], level
        for at in above:
            try:
                below = sorted(entry.path for entry in os.scandir(at) if entry.is_dir() and entry.name[:1] != ".")
            except OSError:
                continue
            looked_at += len(below)
            if looked_at > MOST_FOLDERS:
                return
            for place in map(Path, below):
                if (place / MANIFEST).is_file():
                    yield place
                else:
                    level.append(place)


def _stated(folder: Path) -> str | None:
    """Return the name in a folder's package.xml; None without one."""
    try:
        with (folder / MANIFEST).open("rb") as file:
            text = file.read(LARGEST_MANIFEST)
    except (OSError, ValueError):  # ValueError: a name that is not allowed in file systems
        return None
    found = re.search(rb"<name>([^<]+)</name>", re.sub(rb"<!--.*?-->", b"", text, flags=re.DOTALL))
    return found[1].decode("utf-8", "replace").strip() if found else None
