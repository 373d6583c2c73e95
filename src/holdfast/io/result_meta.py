"""meta.json of a result folder: which run it is, how much of it is there, and which robots it was simulated with."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from holdfast.errors import ResultError
from holdfast.io.files import LONGEST_NAME, one_line, read_bounded, reason_of
from holdfast.robots.urdf.source import Source
from holdfast.simulation.trajectory import Occurrence

FORMAT = "holdfast-result"
FORMAT_VERSION = 2
META, SCENE = "meta.json", "scene.toml"
MODEL, BASES = "model.json", "bases.npz"  # of a run made in Python: its chain, and how bases moved
LARGEST_FILE = 64 * 2**20  # [bytes] of meta.json, scene.toml and a robot; samples lie elsewhere
INTERRUPTED = "interrupted"  # the one `stopped` after which a run can go on


class CheckpointRecord(msgspec.Struct, frozen=True):
    """Where the checkpoint is.

    Attributes:
        file: its name.
        samples: how many samples lie before what it goes on to.
    """

    file: str
    samples: int


class RobotRecord(msgspec.Struct, frozen=True):
    """Where the URDF of an arm is.

    Attributes:
        file: its name in the result folder.
        sha256: of it.
        folder: that relative names of meshes in it start from; empty if it came without one.
        packages: folders of packages that it refers to, by name, as far as they were given or found by xacro.
    """

    file: str
    sha256: str
    folder: str
    packages: dict[str, str] = {}


class ResultMeta(msgspec.Struct, frozen=True, kw_only=True):
    """The content of meta.json.

    Attributes:
        format, format_version: of the folder.
        scene: the scene's name.
        scene_sha256: of scene.toml.
        scene_folder: that names of robot files in scene.toml start from.
        robots: the URDF of each arm that is out of a file, as simulated; nothing in folders of holdfast 0.1.
        model_sha256: of all numbers of the chain, see `fingerprint`; files that a scene names have a part in it.
        versions: of everything that has a part in the last bit.
        arms: their names, in the arrays' order.
        trunk: whether they stand on one.
        grasps: the kind of grasp by arm, at the start.
        joints, joint_kinds: `arm/joint` and revolute or prismatic, in the arrays' order.
        work_terms: the columns of `work`.
        units: by array.
        duration, step: asked for [s].
        options: whatever else was asked for.
        samples: how many are there.
        chunks: how many of each chunk belong to the run, from its first on.
        last_time: of the last sample [s].
        checkpoint: what the run goes on from, while it has not ended.
        no_checkpoint: why there is none, if none can be written.
        complete: whether the run reached its end.
        stopped: what ended it early.
        occurrences: what happened after the last sample, at the instant that ended the run.
    """

    format: str
    format_version: int
    scene: str
    scene_sha256: str = ""
    scene_folder: str = ""
    robots: dict[str, RobotRecord] = {}
    model_sha256: str
    versions: dict[str, str]
    arms: list[str]
    grasps: dict[str, str]
    joints: list[str]
    joint_kinds: list[str]
    work_terms: list[str]
    units: dict[str, str]
    duration: float
    step: float
    options: dict[str, Any]
    samples: int = 0
    chunks: list[int] = []
    last_time: float | None = None
    checkpoint: CheckpointRecord | None = None
    no_checkpoint: str | None = None
    complete: bool = False
    stopped: str | None = None
    occurrences: list[Occurrence] = []
    trunk: bool = False

    @property
    def ended(self) -> bool:
        """Whether nothing can come after: the run is complete, or physics stopped it."""
        return self.complete or self.stopped not in (None, INTERRUPTED)


_PROGRESS = ("samples", "chunks", "last_time", "checkpoint", "no_checkpoint", "complete", "stopped", "occurrences")
_ANYWHERE = ("scene_folder", "robots")  # the files may have moved; what they say is in the model
# A name in meta.json is never a way out of the folder.
_ROBOT_FILE = re.compile(r"robot_[0-9a-f]{16}\.urdf")
_CHECKPOINT_FILE = re.compile(r"checkpoint_[0-9]{4,12}\.npz")


def read_meta(folder: Path) -> ResultMeta:
    """Return the content of meta.json.

    Raises:
        ResultError: there is none, it is damaged, or its format is of another version.
    """
    path = folder / META
    if not os.path.isdir(folder):  # Path.is_dir raises at names that are too long
        raise ResultError(f"{one_line(str(folder), LONGEST_NAME)}: no such folder")
    try:
        found = msgspec.json.decode(read_bytes(path), type=dict)
        here = {"format": found.get("format"), "format_version": found.get("format_version")}
        if here != {"format": FORMAT, "format_version": FORMAT_VERSION}:
            raise ResultError(
                f"{path}: expected format '{FORMAT}' version {FORMAT_VERSION}, got {here['format']!r} version"
                f" {here['format_version']!r}; try the version of holdfast that wrote it"
            )
        meta = msgspec.convert(found, ResultMeta)
    except msgspec.ValidationError as cause:
        raise ResultError(f"{path}: {cause}") from cause
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as cause:
        raise ResultError(f"{path}: not valid JSON: {cause}") from cause
    if min(meta.chunks, default=1) < 1 or sum(meta.chunks) != meta.samples:
        raise ResultError(f"{path}: expected chunks of {meta.samples} samples together, got {meta.chunks}")
    if meta.checkpoint is not None and not 1 <= meta.checkpoint.samples <= meta.samples:
        raise ResultError(f"{path}: expected a checkpoint in {meta.samples} samples, got {meta.checkpoint.samples}")
    if meta.checkpoint is not None and not _CHECKPOINT_FILE.fullmatch(meta.checkpoint.file):
        raise ResultError(f"{path}: checkpoint: expected a file such as 'checkpoint_0000.npz', got another name")
    if not all(_ROBOT_FILE.fullmatch(robot.file) for robot in meta.robots.values()):
        raise ResultError(f"{path}: robots: expected files such as 'robot_0123456789abcdef.urdf', got another name")
    return meta


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes.

    Raises:
        ResultError: it cannot be read.
    """
    try:
        content = read_bounded(path, LARGEST_FILE)
    except OSError as cause:
        raise ResultError(f"{path}: cannot be read: {reason_of(cause)}; is this a result folder?") from cause
    if len(content) > LARGEST_FILE:
        raise ResultError(f"{path}: expected at most {LARGEST_FILE >> 20} MiB, got more")
    return content


def json_text(data: Any) -> bytes:
    """Return data as indented JSON."""
    return msgspec.json.format(msgspec.json.encode(data), indent=2) + b"\n"


def sha256(content: bytes) -> str:
    """Return the SHA-256 of some bytes, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


_DESCRIPTIONS = {"scene_sha256": "the scene's text", "model_sha256": "the model that the scene describes"}


def differences(there: ResultMeta, here: ResultMeta) -> list[str]:
    """Return in words what makes two runs different ones; progress does not, nor do folders."""
    mine, other = (dict(_leaves(msgspec.to_builtins(meta))) for meta in (here, there))
    passed = (*_PROGRESS, *_ANYWHERE)
    found = [key for key in mine | other if key.split(".")[0] not in passed and mine.get(key) != other.get(key)]
    return [_DESCRIPTIONS.get(key) or f"{key} ({other.get(key)!r} there, {mine.get(key)!r} here)" for key in found]


def _leaves(data: dict[str, Any], path: str = "") -> list[tuple[str, Any]]:
    """Return path and value of everything that is not itself a dict."""
    pairs = [(path + key, value) for key, value in data.items()]
    return [leaf for k, v in pairs for leaf in (_leaves(v, k + ".") if isinstance(v, dict) else [(k, v)])]


def kept_files(sources: Mapping[str, Source]) -> tuple[dict[str, RobotRecord], dict[str, bytes]]:
    """Return what meta.json records of the robots, by arm, and the files to write; arms of one robot share one."""
    records, files = {}, {}
    for arm, source in sources.items():
        content = source.text.encode("utf-8") if isinstance(source.text, str) else source.text
        digest = sha256(content)
        folder = "" if source.folder is None else str(source.folder.resolve())
        records[arm] = RobotRecord(f"robot_{digest[:16]}.urdf", digest, folder, dict(source.packages))
        files[records[arm].file] = content
    return records, files


def kept_robots(folder: Path, records: Mapping[str, RobotRecord]) -> dict[str, Source]:
    """Return the URDF of each arm that is out of a file, as it was simulated.

    Raises:
        ResultError: one is missing, or is not the one that was simulated.
    """
    found = {}
    for arm, record in records.items():
        path = folder / record.file
        content = read_bytes(path)
        if sha256(content) != record.sha256:
            raise ResultError(f"{path}: expected the text of the simulated robot, got another text")
        folder_of_meshes = Path(record.folder) if record.folder else None
        found[arm] = Source(str(path), content, folder_of_meshes, packages=record.packages)
    return found
