"""The files of a result folder: meta.json, chunks of samples, and the robots that were simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import ResultError
from holdfast.io.store import (
    Damage,
    FolderKind,
    Manifest,
    arrays_text,
    read_arrays,
    read_manifest,
    sha256,
    stored,
)
from holdfast.robots.urdf.source import UrdfSource
from holdfast.simulation.events import Occurrence
from holdfast.simulation.trajectory import EMPTY_FIELDS, Trajectory, array_names, joined

META, SCENE, SUMMARY = "meta.json", "scene.toml", "summary.json"
MODEL, BASES, PLANNED = "model.json", "bases.npz", "bases_planned.npz"  # of a run made in Python
WAS_INTERRUPTED = "interrupted"  # the only `stopped` after which a run can be resumed
RESULT = FolderKind(
    name="result",
    manifest=META,
    versions=(3, 2),
    chunk="chunk_{:04d}.npz",
    data=("chunk_[0-9]*.npz", "checkpoint_[0-9]*.npz", SUMMARY),
    others=(SCENE, "robot_*.urdf", MODEL, BASES, PLANNED, "trajectory*.csv", "trajectory*.parquet", "*.png"),
    again="the same command with --overwrite, or the same call with overwrite=True, computes the run again",
)


class CheckpointRecord(msgspec.Struct, frozen=True):
    """The checkpoint of an unfinished run.

    Attributes:
        file: its name.
        samples: number of samples stored before the checkpoint.
    """

    file: str
    samples: int


class RobotRecord(msgspec.Struct, frozen=True):
    """The URDF file of an arm.

    Attributes:
        file: its name in the result folder.
        sha256: SHA-256 of the file.
        folder: folder to which the file's mesh names are relative; empty if unknown.
        packages: folders of packages that it refers to, by name, as far as they were given or found by xacro.
    """

    file: str
    sha256: str
    folder: str
    packages: dict[str, str] = {}


class ResultMeta(Manifest, frozen=True, kw_only=True):
    """The content of meta.json.

    Attributes:
        scene: the scene's name.
        scene_sha256: SHA-256 of scene.toml.
        scene_folder: folder to which names of robot files in scene.toml are relative.
        robots: the simulated URDF of each arm from a file; empty in folders of holdfast 0.1.
        model_sha256: digest of all numbers of the chain, see `fingerprint`, those from robot files included.
        versions: versions of the libraries that affect results.
        arms: names of the arms, in the order of the arrays.
        trunk: whether the chain has a trunk.
        grasps: kind of grasp at the start, by arm, or by "arm/frame".
        rows: names of the rows of wrenches and margins, if these are not the arms.
        touches: names of the contacts with the world, "point/shape".
        joints, joint_kinds: `arm/joint` and revolute or prismatic, in the arrays' order.
        work_terms: the columns of `work`.
        units: shape, meaning and unit of each array, as documentation.
        duration, step: as requested [s].
        options: further settings on which the results depend; "record" lists the arrays if not all are there.
        samples: number of samples in the folder.
        chunks: number of samples of each chunk that belong to the run, from its first on.
        last_time: time of the last sample [s].
        checkpoint: the checkpoint from which an unfinished run is resumed.
        no_checkpoint: why no checkpoint can be written, if none can.
        complete: whether the run reached its end.
        stopped: reason why the run ended early.
        occurrences: occurrences after the last sample, at the instant that ended the run.
    """

    scene: str
    scene_sha256: str = ""
    scene_folder: str = ""
    robots: dict[str, RobotRecord] = msgspec.field(default_factory=dict)
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
    chunks: list[int] = msgspec.field(default_factory=list)
    last_time: float | None = None
    checkpoint: CheckpointRecord | None = None
    no_checkpoint: str | None = None
    complete: bool = False
    stopped: str | None = None
    occurrences: list[Occurrence] = msgspec.field(default_factory=list)
    trunk: bool = False
    rows: list[str] = msgspec.field(default_factory=list)
    touches: list[str] = msgspec.field(default_factory=list)

    @property
    def ended(self) -> bool:
        """Whether the run cannot be resumed, because it is complete or the physics stopped it."""
        return self.complete or self.stopped not in (None, WAS_INTERRUPTED)


_PROGRESS = ("samples", "chunks", "last_time", "checkpoint", "no_checkpoint", "complete", "stopped", "occurrences")
_ANYWHERE = ("scene_folder", "robots", "files", "sha256")  # files may have moved; what they say is in the model
_WORDING = ("units",)  # of the documentation


def read_meta(folder: Path) -> ResultMeta:
    """Return the content of meta.json.

    Raises:
        ResultError: there is none, it is damaged, or its format is of another version.
    """
    meta = read_manifest(folder, RESULT, ResultMeta)
    if min(meta.chunks, default=1) < 1 or sum(meta.chunks) != meta.samples:
        raise ResultError(f"{folder / META}: expected chunks of {meta.samples} samples together, got {meta.chunks}")
    return meta


_DESCRIPTIONS = {"scene_sha256": "the scene's text", "model_sha256": "the model that the scene describes"}


def differences(there: ResultMeta, here: ResultMeta) -> list[str]:
    """Return the differences between two runs in words; progress, folders and wording do not count."""
    mine, other = (dict(_leaves(msgspec.to_builtins(meta))) for meta in (here, there))
    passed = (*_PROGRESS, *_ANYWHERE, *_WORDING)
    found = [key for key in mine | other if key.split(".")[0] not in passed and mine.get(key) != other.get(key)]
    return [_DESCRIPTIONS.get(key) or f"{key} ({other.get(key)!r} there, {mine.get(key)!r} here)" for key in found]


def _leaves(data: dict[str, Any], path: str = "") -> list[tuple[str, Any]]:
    """Return path and value of everything that is not itself a dict."""
    pairs = [(path + key, value) for key, value in data.items()]
    return [leaf for k, v in pairs for leaf in (_leaves(v, k + ".") if isinstance(v, dict) else [(k, v)])]


def kept_files(sources: Mapping[str, UrdfSource]) -> tuple[dict[str, RobotRecord], dict[str, bytes]]:
    """Return the robots' entries in meta.json, by arm, and the files to write; arms of one robot share a file."""
    records, files = {}, {}
    for arm, source in sources.items():
        content = source.text.encode("utf-8") if isinstance(source.text, str) else source.text
        digest = sha256(content)
        folder = "" if source.folder is None else str(source.folder.resolve())
        records[arm] = RobotRecord(f"robot_{digest[:16]}.urdf", digest, folder, dict(source.packages))
        files[records[arm].file] = content
    return records, files


def kept_robots(folder: Path, records: Mapping[str, RobotRecord]) -> dict[str, UrdfSource]:
    """Return the URDF of each arm that is from a file, as it was simulated.

    Raises:
        Damage: one is missing, or is not the one that was simulated.
    """
    found = {}
    for arm, record in records.items():
        content = stored(folder, record.file, {record.file: record.sha256})
        meshes = Path(record.folder) if record.folder else None
        found[arm] = UrdfSource(str(folder / record.file), content, meshes, packages=record.packages)
    return found


def chunk_name(k: int) -> str:
    """Return the file name of chunk k."""
    return RESULT.chunk.format(k)


def chunk_text(parts: Sequence[Trajectory]) -> bytes:
    """Return parts of a run as the bytes of a chunk; what has happened belongs to the last sample of a part."""
    chunk, ends = joined(parts), np.cumsum([len(part) for part in parts]).tolist()
    log = [{"sample": k - 1, **asdict(line)} for k, part in zip(ends, parts, strict=True) for line in part.occurrences]
    return arrays_text({name: getattr(chunk, name) for name in chunk.recorded}, "occurrences", log)


def read_chunk(folder: Path, k: int, meta: ResultMeta) -> Trajectory:
    """Return the samples of chunk k that belong to the run.

    Raises:
        Damage: samples are missing or damaged.
    """
    count = meta.chunks[k]
    arrays, log = read_arrays(folder, chunk_name(k), meta.files, "occurrences")
    names = meta.options.get("record", array_names())
    if lacking := [name for name in names if name not in (*arrays, *EMPTY_FIELDS)]:
        raise Damage(f"{chunk_name(k)} lacks {', '.join(lacking)}")
    for name, array in arrays.items():
        if array.shape[:1] < (count,):
            raise Damage(f"{chunk_name(k)} holds shape {array.shape} of '{name}', expected {count} samples")
    try:
        lines = msgspec.convert(log, list[dict[str, Any]])
        occurrences = msgspec.convert([line for line in lines if line["sample"] < count], tuple[Occurrence, ...])
    except (msgspec.ValidationError, KeyError, TypeError) as cause:
        raise Damage(f"{chunk_name(k)}: occurrences: {cause}") from cause
    ours: dict[str, Any] = {name: arrays[name][:count] for name in array_names() if name in arrays}
    return Trajectory(**ours, every=meta.options.get("every", 1), occurrences=occurrences)
