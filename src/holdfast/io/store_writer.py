"""Writing of a folder with a manifest, which can be read at any moment and after any death of its writer.

Files are written under new names; then a manifest that names them is moved over the old one: that move is the commit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from msgspec.structs import replace

from holdfast.errors import ResultError
from holdfast.io.files import make_folder, names_in, remove, write_atomically
from holdfast.io.store import Kind, Manifest, manifest_text
from holdfast.io.stored_file import Damage, sha256, stored


class StoreWriter:
    """Writes the files of one folder.

    Attributes:
        folder: the folder.
        kind: its kind.
        files: SHA-256 of each file that the next commit names.
        started: whether the folder is that of this writer.
    """

    def __init__(self, folder: Path, kind: Kind, files: Mapping[str, str | None] | None = None) -> None:
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


def require_free(folder: Path, kind: Kind, overwrite: bool, advice: str) -> None:
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
