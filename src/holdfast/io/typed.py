"""Typed reading of JSON and TOML: every refusal names the location as a path `$.a[0].b`."""

from __future__ import annotations

import json
import math
import re
import tomllib
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from holdfast.errors import HoldfastError, SceneError
from holdfast.io.files import LONGEST_NAME, one_line, read_bounded, reason_of
from holdfast.model import checks

Typed = TypeVar("Typed")

LARGEST_TEXT = 32 * 2**20  # [bytes]
# Keys of a path `a.b.c`: tomllib takes memory by the square of their number, and a scene needs seven.
_PATH_OF_KEYS = re.compile(r"""(?<![\w-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){100}""")


def refusal(source: str, problem: str) -> SceneError:
    """Return the error `source: problem`, on one line."""
    return SceneError(one_line(f"{one_line(source, LONGEST_NAME)}: {problem}"))


@dataclass(frozen=True)
class Location:
    """A path `$.a[0].b` inside a file, for refusals that name it: `scene.toml: $.arms[0].base: expected ...`.

    Attributes:
        source: the file's name.
        path: the path inside it.
    """

    source: str
    path: str = "$"

    def __truediv__(self, key: str | int) -> Location:
        return Location(self.source, f"{self.path}[{key}]" if isinstance(key, int) else f"{self.path}.{key}")

    def message(self, problem: str) -> str:
        """Return `source: path: problem` on one line."""
        return one_line(": ".join([*(one_line(name, LONGEST_NAME) for name in (self.source, self.path)), problem]))

    def refuse(self, problem: str) -> SceneError:
        """Return the error for a problem at this location, on one line."""
        return SceneError(self.message(problem))

    @contextmanager
    def refusals(self) -> Iterator[None]:
        """Convert errors of the model, 'link: mass: expected ...', to '$.path.mass: expected ...'."""
        try:
            yield
        except SceneError:
            raise
        except HoldfastError as cause:
            _, _, problem = str(cause).partition(": ")
            key, separator, rest = problem.partition(": ")
            if separator and key.isidentifier():
                raise (self / key).refuse(rest) from cause
            raise self.refuse(problem or str(cause)) from cause


def read_bytes(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """Return a file's bytes.

    Args:
        path: the file.
        most: the largest number of bytes.

    Raises:
        SceneError: it cannot be read, or is larger.
    """
    try:
        content = read_bounded(path, most)
    except OSError as cause:
        raise refusal(str(path), f"cannot be read: {reason_of(cause)}") from cause
    if len(content) > most:
        raise refusal(str(path), f"expected at most {most / 2**20:g} MiB, got more")
    return content


def parse_json(text: bytes, source: str) -> Any:
    """Return plain data from JSON text.

    Raises:
        SceneError: It is not valid JSON, or it contains NaN or an infinity, of which the message names the path.
    """
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as cause:
        raise refusal(source, _json_fault(text) or f"not valid JSON: {cause}") from cause


def _json_fault(text: bytes) -> str:
    """Return what is wrong with JSON text in the words of the standard library, which says more, or nothing."""
    try:
        for path, value in _leaves(json.loads(text), "$"):  # it takes NaN, infinities and 1e999
            if isinstance(value, float) and not math.isfinite(value):
                return f"{path}: expected a finite number, got {value!r}"
    except json.JSONDecodeError as fault:
        where = f"line {fault.lineno}, column {fault.colno}"
        return f"not valid JSON: {fault.msg} ({where})" if text.strip() else "is empty"
    except (ValueError, RecursionError):
        pass
    return ""


def _leaves(data: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield path and value of everything that is neither a list nor an object."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{path}.{key}")
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from _leaves(value, f"{path}[{i}]")
    else:
        yield path, data


def parse_toml(text: bytes, source: str) -> Any:
    """Return plain data from TOML text.

    Raises:
        SceneError: it is not valid TOML (the message gives line and column), or is nested too deeply.
    """
    try:
        decoded = text.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        raise refusal(source, f"not valid TOML: {cause}; try saving it as UTF-8") from cause
    if found := _PATH_OF_KEYS.search(decoded):
        line = decoded.count("\n", 0, found.start()) + 1
        raise refusal(source, f"not valid TOML: expected a key of fewer than 100 parts (at line {line})")
    try:
        return tomllib.loads(decoded)
    except RecursionError as cause:
        raise refusal(source, "not valid TOML: nested too deeply") from cause
    except ValueError as cause:
        fault = cause if isinstance(cause, tomllib.TOMLDecodeError) else "an integer of more than 4300 digits"
        raise refusal(source, f"not valid TOML: {fault}") from cause


def convert(data: Any, kind: type[Typed], source: str, root: str = "$") -> Typed:
    """Return plain data as a typed structure, nothing unknown, nothing missing.

    Args:
        data: dicts, lists, numbers and strings.
        kind: a msgspec Struct type.
        source: the file's name, for messages.
        root: the path of `data` inside the file.

    Raises:
        SceneError: `source: $.path: what is wrong`, with a hint for a misspelt name.
    """
    try:
        return msgspec.convert(data, kind, strict=True)
    except (msgspec.ValidationError, RecursionError) as cause:
        text = str(cause)
        found = re.search(r" - at `(?:key in )?(\$[^`]*)`", text)
        path = found[1] if found else "$"
        problem = re.sub(r" - at `[^`]*`", "", text)
        problem = re.sub(r"(?<=[`'])([^`']{57})[^`']{4,}(?=[`'])", r"\1...", problem)
        raise Location(source, root + path[1:]).refuse(problem + _hint(kind, path, problem)) from cause


def _structs(kind: Any) -> typing.Iterator[type[msgspec.Struct]]:
    """Yield the Struct classes inside a type such as `list[Arm]` or `Fixed | Moving`."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        yield kind
    for argument in typing.get_args(kind):
        yield from _structs(argument)


def _fields(kinds: list[Any]) -> list[msgspec.structs.FieldInfo]:
    """Return the fields of all Struct classes inside types."""
    return [field for kind in kinds for struct in _structs(kind) for field in msgspec.structs.fields(struct)]


def _types_at(kind: Any, path: str) -> list[Any]:
    """Return the declared types at a path such as `$.arms[0].grasp`."""
    current = [kind]
    for key in re.findall(r"\.(\w+)", path):
        values = [value for t in current if typing.get_origin(t) is dict for value in typing.get_args(t)[1:]]
        current = [field.type for field in _fields(current) if field.encode_name == key] or values
    return current


def _hint(kind: Any, path: str, problem: str) -> str:
    """Return ' Did you mean ...?' for an unknown field or value, or nothing."""
    if found := re.search(r"unknown field `([^`]*)`", problem):
        pool = [field.encode_name for field in _fields(_types_at(kind, path))]
    elif found := re.search(r"[Ii]nvalid (?:enum )?value '([^']*)'", problem):
        parent, _, leaf = path.rpartition(".")
        configs = [struct.__struct_config__ for t in _types_at(kind, parent) for struct in _structs(t)]
        pool = [v for t in _types_at(kind, path) for v in _literals(t)]
        pool += [str(config.tag) for config in configs if config.tag_field == leaf]
    else:
        return ""
    known = pool and found[1] not in pool  # a field of another kind of table is there, under this very name
    return "." + checks.did_you_mean(found[1], dict.fromkeys(pool)) if known else ""


def _literals(kind: Any) -> list[str]:
    """Return the values of every Literal inside a type."""
    if typing.get_origin(kind) is typing.Literal:
        return [str(v) for v in typing.get_args(kind)]
    return [v for argument in typing.get_args(kind) for v in _literals(argument)]
