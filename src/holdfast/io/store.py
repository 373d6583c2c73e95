"""Folders of results, records and sweeps: their files, and a manifest that names each file with its SHA-256.

A file that is read is compared with its digest, and the manifest with its own, so that nothing is read as other numbers
after a flipped bit or a truncation, or where files were exchanged with each other or with those of another folder.
Files that the manifest does not name do not count. `store_writer` writes such folders.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec

from holdfast.errors import ResultError
from holdfast.io.files import LONGEST_NAME, one_line
from holdfast.io.stored_file import Damage, advising, json_text, sha256, stored
from holdfast.spatial.scalar import Array

UNSIGNED = "0" * 64


class Kind(NamedTuple):
    """A kind of folder.

    Attributes:
        name: what is in it, such as "result".
        manifest: name of the manifest.
        versions: version of the format that is written, then those that can be read, whose manifests have no digests.
        chunk: name of chunk k, as a format string.
        data: patterns of the files with the numbers, chunks first; those that the manifest does not name are removed.
        others: patterns of the further files that belong to such a folder.
        again: what computes its content again.
    """

    name: str
    manifest: str
    versions: tuple[int, ...]
    chunk: str
    data: tuple[str, ...]
    others: tuple[str, ...]
    again: str

    @property
    def format(self) -> str:
        """Name of the format in the manifest."""
        return f"holdfast-{self.name}"

    def owns(self, name: str) -> bool:
        """Return whether a file of this name belongs to such a folder."""
        patterns = (self.manifest, *self.data, *self.others, "*.part")
        return os.path.basename(name) == name and any(fnmatchcase(name, pattern) for pattern in patterns)

    def text(self, folder: Path) -> bytes:
        """Return the manifest of a folder as it stands there.

        Raises:
            Damage: it is missing, or too large.
        """
        return stored(folder, self.manifest, {self.manifest: None})

    def strays(self, folder: Path, chunks: int) -> list[str]:
        """Return the names of chunks beyond the first `chunks`."""
        known = {self.chunk.format(k) for k in range(chunks)}
        return sorted(path.name for path in folder.glob(self.data[0]) if path.name not in known)


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """What every manifest contains.

    Attributes:
        format, format_version: format of the folder.
        sha256: SHA-256 of the manifest, see `manifest_text`.
        files: SHA-256 of each file by name; None in folders of holdfast 0.1, whose files are not checked.
    """

    format: str
    format_version: int
    sha256: str = ""
    files: dict[str, str | None] = {}


M = TypeVar("M", bound=Manifest)


def read_manifest(folder: Path, kind: Kind, what: type[M]) -> M:
    """Return the manifest of a folder.

    Raises:
        ResultError: there is no folder.
        Damage: it is damaged or missing, or its format is another one.
    """
    if not os.path.isdir(folder):  # Path.is_dir raises at names that are too long
        raise ResultError(f"{one_line(str(folder), LONGEST_NAME)}: no such folder")
    name = kind.manifest
    with advising(folder, kind.again if kind.strays(folder, 0) else f"is this a {kind.name} folder?"):
        content = kind.text(folder)
        try:  # holdfast 0.1 wrote infinities, which are texts here
            found = msgspec.json.decode(content.replace(b": -Infinity", b': "-Infinity"'), type=dict[str, Any])
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as cause:
            raise Damage(f"{name} is damaged: not valid JSON: {cause}") from cause
        signed = found.get("sha256")
        if signed is not None and signed != sha256(content.replace(str(signed).encode(), UNSIGNED.encode(), 1)):
            raise Damage(f"{name} is damaged: its content does not match its digest")
        form, version = found.get("format"), found.get("format_version")
        if form != kind.format or version not in kind.versions:
            got = one_line(f"got {form!r} version {version!r}", LONGEST_NAME)
            expected = f"expected format '{kind.format}' version {kind.versions[0]}"
            raise Damage(f"{name}: {expected}, {got}; try the version of holdfast that wrote it")
        if version != kind.versions[0]:
            found["files"] = {path.name: None for path in folder.iterdir() if kind.owns(path.name)}
        elif signed is None:
            raise Damage(f"{name} is damaged: it has no digest")
        try:
            manifest = msgspec.convert(found, what)
        except msgspec.ValidationError as cause:
            raise Damage(f"{name} is damaged: {cause}") from cause
        if foreign := [one for one in manifest.files if not kind.owns(one)]:
            raise Damage(
                f"{name} is damaged: it names '{one_line(foreign[0], LONGEST_NAME)}', no file of a {kind.name}"
            )
    return manifest


def manifest_text(manifest: Manifest) -> bytes:
    """Return a manifest as JSON text with its own digest: that of this text with 64 zeros in its place."""
    text = json_text(msgspec.structs.replace(manifest, sha256=UNSIGNED))
    return text.replace(UNSIGNED.encode(), sha256(text).encode(), 1)


def times_of_chunks(
    kind: Kind, counts: Sequence[int], read: Callable[[int], tuple[Array, Mapping[str, Array]]]
) -> tuple[list[Array], str]:
    """Return the times in the chunks before the first damage, and that damage in words.

    One chunk is in memory at a time.

    Args:
        kind: kind of the folder.
        counts: number of rows in each chunk.
        read: what returns times and arrays of chunk k.
    """
    times, before = list[Array](), None
    for k in range(len(counts)):
        try:
            t, arrays = read(k)
            here = {name: x.shape[1:] for name, x in arrays.items()}
            if here != (before or here) or (times and t[0] < times[-1][-1]):
                raise Damage(f"{kind.chunk.format(k)} does not continue the previous chunks")
        except Damage as damage:
            return times, str(damage)
        times.append(t)
        before = here
    return times, ""
