"""One HTML file of several playbacks, which shows one of them below a bar with the titles of all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from holdfast.errors import ModelError
from holdfast.view.embedded import data_element, escaped
from holdfast.view.playback import Playback

MOST_PAGES = 12  # browsers draw at most 16 players at once
HERE = Path(__file__).parent


def different_playbacks(given: Any) -> list[Playback]:
    """Return one or several playbacks as a list for a chooser.

    Raises:
        ModelError: a value is not a playback, there are none or too many, or two have the same title.
    """
    playbacks = list(given) if isinstance(given, list | tuple) else [given]
    for one in playbacks:
        if not isinstance(one, Playback):
            raise ModelError(
                f"playback: expected a playback, got a {type(one).__name__}; try playback_of_run(chain, run)"
            )
    if not 1 <= len(playbacks) <= MOST_PAGES:
        raise ModelError(f"playbacks: expected 1 to {MOST_PAGES}, got {len(playbacks)}; try several files")
    titles = [one.title for one in playbacks]
    for k, title in enumerate(titles):
        if title in titles[:k]:
            raise ModelError(
                f"playbacks: expected a title of its own for each, got '{title}' twice; try"
                " dataclasses.replace(playback, title=...)"
            )
    return playbacks


def with_chooser(pages: Sequence[str], titles: Sequence[str]) -> str:
    """Return a page that shows one of several pages; a change of page keeps time and camera.

    Args:
        pages: the result of `page` for each playback.
        titles: titles of the playbacks, all different.
    """
    data = data_element("pages", {"titles": list(titles), "pages": list(pages)})
    style, script = ((HERE / f"chooser.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escaped(", ".join(titles))}</title>'
        f"<style>{style}</style></head><body><nav></nav><main></main>"
        f"{data}<script>{script}</script></body></html>\n"
    )
