"""One HTML file that plays a film: opens from disk, without network, without this program."""

from __future__ import annotations

from os import PathLike

from holdfast.errors import ModelError
from holdfast.io.files import file_path, write_atomically
from holdfast.view.chain_scene import ChainScene
from holdfast.view.film import Film
from holdfast.view.page_panel import with_panel
from holdfast.view.scene_writer import SceneWriter, viewer_server

PAUSE = 0.8  # the last moment stays so long before the player begins again [s]


def export_page(film: Film, path: str | PathLike[str]) -> None:
    """Write a film as one HTML file, whole or not at all.

    The player begins at once and repeats; space pauses it. A film of one moment stands still.

    Args:
        film: what to show.
        path: the file.

    Raises:
        MissingExtra: viser is not installed.
        ModelError: what is no film.
        ResultError: the file cannot be written.
    """
    if not isinstance(film, Film):
        raise ModelError(f"film: expected a film, got a {type(film).__name__}; try film_of_run(chain, run)")
    place = file_path(path, "path")
    write_atomically(place, page(film).encode("utf-8"))


def page(film: Film) -> str:
    """Return the text of the HTML file; the same film gives the same text.

    Raises:
        MissingExtra: viser is not installed.
    """
    with viewer_server() as server:
        scene = ChainScene(SceneWriter(server), film)
        recording = server.get_scene_serializer()
        for k in range(1, len(film)):
            recording.insert_sleep(float(film.t[k] - film.t[k - 1]))
            scene.show(k)
        if len(film) > 1:
            recording.insert_sleep(PAUSE)
        return with_panel(recording.as_html(), film, scene.scale)
