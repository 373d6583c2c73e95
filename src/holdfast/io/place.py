"""A place in a file, for refusals that name it: `scene.toml: $.arms[0].base: expected ...`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from holdfast.errors import HoldfastError, SceneError

LONGEST = 600  # characters of a message; names and values that a file says are quoted in it
LONGEST_NAME = 200  # of a file or a path inside it


def one_line(text: str, most: int = LONGEST) -> str:
    """Return a text as messages show it: on one line, printable, cut to at most so many characters."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: most + 1])
    return shown if len(shown) <= most else shown[: most - 3] + "..."


def refusal(source: str, problem: str) -> SceneError:
    """Return the error `source: problem`, on one line."""
    return SceneError(one_line(f"{one_line(source, LONGEST_NAME)}: {problem}"))


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

    def said(self, problem: str) -> str:
        """Return `source: path: problem` on one line."""
        return one_line(": ".join([*(one_line(name, LONGEST_NAME) for name in (self.source, self.path)), problem]))

    def refuse(self, problem: str) -> SceneError:
        """Return the error that says on one line what is wrong here."""
        return SceneError(self.said(problem))

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
            if separator and key.isidentifier():
                raise (self / key).refuse(rest) from cause
            raise self.refuse(problem or str(cause)) from cause
