"""Folders of results, records and sweeps: their files, and a manifest that names each file with its SHA-256.

A file that is read is compared with its digest, and the manifest with its own, so that nothing is read as other numbers
after a flipped bit or a truncation, or where files were exchanged with each other or with those of another folder.
Files that the manifest does not name do not count. A folder can be read at any moment while it is written, and after
any death of its writer: files are written under new names, then a manifest that names them is moved over the old one,
and that move is the commit.
"""

from __future__ import annotations

import hashlib
import io
import os
import sys
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from holdfast.errors import ResultError
from holdfast.io.files import (
    LONGEST_NAME,
    make_folder,
    names_in,
    one_line,
    read_bounded,
    reason_of,
    remove,
    write_atomically,
)
from holdfast.spatial.scalar import Array

UNSIGNED = "0" * 64
LARGEST_STORED = 64 * 2**20  # [bytes] of a manifest, a scene, a model and a robot; arrays lie elsewhere
UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)
CHANGED = "changed while it was read; try again"


class FolderKind(NamedTuple):
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


def read_manifest(folder: Path, kind: FolderKind, what: type[M]) -> M:
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
    kind: FolderKind, counts: Sequence[int], read: Callable[[int], tuple[Array, Mapping[str, Array]]]
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


class StoreWriter:
    """Writes the files of one folder.

    Attributes:
        folder: the folder.
        kind: its kind.
        files: SHA-256 of each file that the next commit names.
        started: whether the folder is that of this writer.
    """

    def __init__(self, folder: Path, kind: FolderKind, files: Mapping[str, str | None] | None = None) -> None:
        self.folder, self.kind, self.files = folder, kind, dict(files or {})
        self.started = files is not None
        self._texts: tuple[bytes, ...] = ()  # of the manifest, as this writer left it or was about to

    def begin(self, manifest: Manifest, files: Mapping[str, bytes]) -> None:
        """Create the folder without chunks at the first call; later, refuse it if another process has written to it.

        What an earlier result left there is removed.

        Args:
            manifest: the manifest without chunks.
            files: further files.

        Raises:
            ResultError: a file cannot be written or removed, or another process has written to the folder.
        """
        if self.started:
            if self.kind.text(self.folder) not in self._texts:
                raise ResultError(f"{self.folder}: another process has written to it; nothing more is added")
            return
        make_folder(self.folder)
        self.files.clear()
        self.commit(manifest)  # first, so that the folder is known as ours before anything else is in it
        self.remove_unnamed((*self.kind.data, *self.kind.others, "*.part"))
        self.keep(files)
        self.started = True

    def keep(self, files: Mapping[str, bytes]) -> None:
        """Write those of some files that are missing or damaged.

        Raises:
            ResultError: a file cannot be written.
        """
        for name, content in files.items():
            self.files[name] = sha256(content)
            try:
                stored(self.folder, name, self.files)
            except Damage:
                self.write(name, content)

    def write(self, name: str, content: bytes) -> None:
        """Write a file, which counts from the next commit on.

        Raises:
            ResultError: it cannot be written.
        """
        write_atomically(self.folder / name, content)
        self.files[name] = sha256(content)

    def commit(self, manifest: Manifest, drop: Collection[str] = ()) -> None:
        """Move a manifest with the names of all files into place, then remove the files that it drops.

        Costs two waits for the disk, as each file does. A commit that was broken off can be repeated.

        Raises:
            ResultError: a file cannot be written or removed.
        """
        kept = {name: digest for name, digest in sorted(self.files.items()) if name not in drop}
        text = manifest_text(replace(manifest, files=kept))
        self._texts = (*self._texts[-1:], text)
        write_atomically(self.folder / self.kind.manifest, text)
        self.files = kept
        remove(*(self.folder / name for name in drop))

    def remove_unnamed(self, patterns: Collection[str]) -> None:
        """Delete files of these patterns that the manifest does not name.

        Raises:
            ResultError: one cannot be removed.
        """
        found = {path for pattern in patterns for path in self.folder.glob(pattern)}
        remove(*(path for path in found if path.name not in self.files and not path.is_dir()))


def require_free(folder: Path, kind: FolderKind, overwrite: bool, advice: str) -> None:
    """Refuse a folder that is not empty, unless it is an earlier one of its kind, whole or damaged, to be replaced.

    Args:
        folder: the folder.
        kind: its kind.
        overwrite: whether an earlier one may be replaced.
        advice: what to try if there is an earlier one.

    Raises:
        ResultError: saying what is there.
    """
    names = names_in(folder, f"a {kind.name} folder")
    if names in ([], [f"{kind.manifest}.part"]):  # a writer died before it wrote anything
        return
    marked = kind.manifest in names and kind.format.encode() in kind.text(folder)
    if not marked and not kind.strays(folder, 0):
        raise ResultError(
            f"{folder}: expected a new or empty folder, or an earlier {kind.name}; found '{names[0]}' in it"
        )
    if not overwrite:
        raise ResultError(f"{folder}: holds an earlier {kind.name}; try {advice}")


class Damage(ResultError):
    """A file is missing, damaged, or in the place of another one; the message names it."""


def stored(folder: Path, name: str, files: Mapping[str, str | None], most: int = LARGEST_STORED) -> bytes:
    """Return the bytes of a file, compared with its digest.

    Args:
        folder: the folder.
        name: name of the file.
        files: digests by name, of the manifest.
        most: largest number of bytes.

    Raises:
        Damage: it is missing, damaged, too large or another file.
    """
    path = folder / name
    try:
        if name not in files or os.path.basename(name) != name:
            raise Damage(f"{one_line(name, LONGEST_NAME)} is not named by the manifest")
        if not path.is_file():
            raise Damage(f"{name} is {'not a file' if path.exists() else 'missing'}")
        if (size := path.stat().st_size) > most:
            raise Damage(f"{name}: expected at most {most >> 20} MiB, got more")
        content = read_bounded(path, size)
    except OSError as cause:
        raise Damage(f"{name} cannot be read: {reason_of(cause)}") from cause
    if files[name] not in (None, sha256(content)):
        raise Damage(f"{name} is damaged, or another file: its SHA-256 is not that in the manifest")
    return content


@contextmanager
def advising(folder: Path, advice: str) -> Iterator[None]:
    """Add the folder and an advice to the message of damage."""
    try:
        yield
    except Damage as damage:
        raise Damage(f"{folder}: {damage}; {advice}") from damage


def arrays_text(arrays: Mapping[str, Array], name: str, data: Any) -> bytes:
    """Return arrays by name, and plain data as an array of JSON text under `name`, as the bytes of an .npz file."""
    file = io.BytesIO()
    np.savez(file, **arrays, **{name: np.array(msgspec.json.encode(data).decode())})  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def read_arrays(folder: Path, name: str, files: Mapping[str, str | None], data: str) -> tuple[dict[str, Array], Any]:
    """Return the arrays of an .npz file by name, and the plain data under the name `data`.

    Raises:
        Damage: the file is missing or damaged, or lacks the plain data.
    """
    content = stored(folder, name, files, most=sys.maxsize)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            # our arrays are not compressed; a file that unpacks to more than its size was made to fill the memory
            if sum(part.file_size for part in archive.infolist()) > len(content):
                raise Damage(f"{name} is damaged: it unpacks to more than the size of the file")
            if files[name] is None and (torn := archive.testzip()):  # checked before any header is trusted
                raise Damage(f"{name} is damaged at '{torn}'")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            held = {title: file[title] for title in file.files}
        return held, msgspec.json.decode(held.pop(data).item())
    except Damage:
        raise
    except UNREADABLE as cause:
        raise Damage(f"{name} is damaged") from cause


def json_text(data: Any) -> bytes:
    """Return data as indented JSON."""
    return msgspec.json.format(msgspec.json.encode(data), indent=2) + b"\n"


def sha256(content: bytes) -> str:
    """Return the SHA-256 of some bytes, hexadecimal."""
    return hashlib.sha256(content).hexdigest()
