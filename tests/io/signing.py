"""Manifests rewritten as their writer would have, by the format's text: digests of files, then of the manifest."""

import hashlib
import json
from pathlib import Path

MANIFESTS = ("meta.json", "record.json", "sweep.json")


def resigned(folder: Path, **changes) -> None:
    """Change entries of a manifest, and make all digests those of the files that are there."""
    (path,) = (folder / name for name in MANIFESTS if (folder / name).exists())
    data = json.loads(path.read_text()) | changes
    there = {name: folder / name for name in data["files"] if (folder / name).is_file()}
    data["files"] = {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in there.items()}
    path.write_text(signed(data))


def signed(data: dict) -> str:
    """Return a manifest as text with its digest, that of the text with zeros in its place."""
    text = json.dumps(data | {"sha256": "0" * 64})
    return json.dumps(data | {"sha256": hashlib.sha256(text.encode()).hexdigest()})


def as_0_1(folder: Path, **changes) -> None:
    """Make a result folder one of holdfast 0.1, whose manifest had no digests; None takes an entry out."""
    path = folder / "meta.json"
    data = json.loads(path.read_text()) | {"format_version": 2, "files": None, "sha256": None} | changes
    path.write_text(json.dumps({key: value for key, value in data.items() if value is not None}))
