"""A place in a file, for refusals that name it: `scene.toml: $.arms[0].base: expected ...`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from holdfast.errors import HoldfastError, SceneError


@dataclass(frozen=True)
class Place:
    """A path `$.a[0].b` in a file.

    Attributes:
        source: the file's name.
        path: the path inside it.
    """

    source: str
    path: str = "$"

    def __truediv__(self, key: str | int) -> Place:
        return Place(self.source, f"{self.path}[{key}]" if isinstance(key, int) else f"{self.path}.{key}")

    def refuse(self, problem: str) -> SceneError:
        """Return the error that says on one line what is wrong here."""
        return SceneError(" ".join(f"{self.source}: {self.path}: {problem}".split()))

    @contextmanager
    def refusals(self) -> Iterator[None]:
        """Turn a model's refusal 'link: mass: expected ...' into '$.path.mass: expected ...'."""
        try:
            yield
        except SceneError:
            raise
        except HoldfastError as cause:
            _, _, problem = str(cause).partition(": ")
            key, separator, rest = problem.partition(": ")
            text = f".{key}: {rest}" if separator and key.isidentifier() else f": {problem or cause}"
            raise SceneError(f"{self.source}: {self.path}{text}") from cause
