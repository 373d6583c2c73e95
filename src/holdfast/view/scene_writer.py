"""The little that drawing needs of a 3D viewer: nodes, poses, arrows, labels. Behind it stands viser.

Names are paths: a node moves with the node it is named under.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import HoldfastError, MissingExtra
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.view.meshes import Mesh

Colour = tuple[int, int, int]
FIELD_OF_VIEW = np.radians(35.0)  # from the picture's upper to its lower edge


class Camera(NamedTuple):
    """A place to look from.

    Attributes:
        name: what the view is called.
        position: (3,) of the eye, world axes [m].
        target: (3,) what it looks at [m].
    """

    name: str
    position: Array
    target: Array


class SceneWriter:
    """Draws into a viser server.

    Attributes:
        server: the viser server, for what only it can do (recording, controls).
    """

    def __init__(self, server: Any) -> None:
        """Start an empty scene.

        Args:
            server: of `viewer_server`.
        """
        self.server = server
        self._nodes: dict[str, Any] = {}
        self._arrows: dict[str, tuple[Any, float]] = {}  # node, radius of its shafts
        self._sent: dict[str, Any] = {}  # what viewers have already

    def set_camera(self, camera: Camera, up: Array) -> None:
        """Set where a viewer begins, and which way is up (3,)."""
        scene, begin = self.server.scene, self.server.initial_camera
        scene.set_up_direction(up)
        scene.configure_default_lights(True, cast_shadow=False)  # half of the time without a graphics card
        begin.position, begin.look_at, begin.fov = camera.position, camera.target, float(FIELD_OF_VIEW)

    def frame(self, name: str, at: Pose, axes: float = 0.0) -> None:
        """Add a frame, its axes drawn so long [m] or, at 0, invisible."""
        self._nodes[name] = self.server.scene.add_frame(
            name, show_axes=axes > 0, axes_length=axes, axes_radius=0.04 * axes, origin_radius=0.06 * axes, **_pose(at)
        )

    def mesh(self, name: str, mesh: Mesh, colour: Colour, opacity: float | None = None) -> None:
        """Add a surface, opaque by default; a translucent one is seen from both sides."""
        self._nodes[name] = self.server.scene.add_mesh_simple(
            name, mesh.vertices, mesh.faces, color=colour, opacity=opacity,
            side="front" if opacity is None else "double",
        )  # fmt: skip

    def lines(self, name: str, segments: Array, colour: Colour, thickness: float) -> None:
        """Add straight lines (N, 2, 3) so thick [m]."""
        self._nodes[name] = self.server.scene.add_line_segments(name, segments, colour, thickness=thickness)

    def redraw(self, name: str, segments: Array) -> None:
        """Let lines go elsewhere, as many as there were, (N, 2, 3) [m]."""
        self._nodes[name].points = segments.astype(np.float32)

    def grid(self, name: str, at: Pose, width: float, cell: float) -> None:
        """Add a square grid in the x-y plane of a pose [m]."""
        self.server.scene.add_grid(
            name, width=width, height=width, cell_size=cell, section_size=5 * cell, cell_color=(225, 225, 225),
            section_color=(195, 195, 195), **_pose(at),
        )  # fmt: skip

    def label(self, name: str, text: str, position: Array) -> None:
        """Add a text that always faces the viewer."""
        self.server.scene.add_label(name, text, position=position, anchor="bottom-center")

    def arrows(self, name: str, count: int, colour: Colour, shaft: float) -> None:
        """Add arrows of no length yet; `point` says where they go.

        Args:
            name: of them all.
            count: how many.
            colour: of them all.
            shaft: radius of their shafts [m]; short arrows are made thinner.
        """
        none = np.zeros((count, 2, 3), dtype=np.float32)
        # viser shows the colours of arrows lighter than they are given: it takes them for linear light
        dark = tuple(round(255 * (channel / 255) ** 2.2) for channel in colour)
        node = self.server.scene.add_arrows(name, none, dark, shaft_radius=0.0, head_radius=0.0, head_length=0.0)
        self._arrows[name] = node, shaft

    def point(self, name: str, segments: Array) -> None:
        """Let arrows go from tail to tip, (count, 2, 3) world axes [m]."""
        node, shaft = self._arrows[name]
        head = 6.0 * shaft
        longest = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).max())
        # a head that is longer than its arrow would stand out at the tail
        size = int(1000 * min(1.0, 0.5 * longest / head)) / 1000
        if self._sent.get(name) != size:  # viser compares too, but slowly
            self._sent[name] = size
            node.shaft_radius, node.head_radius, node.head_length = size * shaft, 2.4 * size * shaft, size * head
        node.points = segments.astype(np.float32)

    def place(self, name: str, wxyz: Array, position: Array) -> None:
        """Move a node to a pose in the frame it is named under."""
        node = self._nodes[name]
        for part, now in (("wxyz", wxyz), ("position", position)):
            # float32 halves what a recording compresses to; a viewer draws no finer
            data = now.astype(np.float32).tobytes()
            if self._sent.get(name + part) != data:
                self._sent[name + part] = data
                setattr(node, part, np.frombuffer(data, dtype=np.float32))

    def paint(self, name: str, colour: Colour) -> None:
        """Give lines another colour."""
        self._nodes[name].colors = np.array(colour, dtype=np.uint8)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let a viewer see everything that is done inside at the same time."""
        with self.server.atomic():
            yield


@contextmanager
def viewer_server(port: int = 0) -> Iterator[Any]:
    """Run a viser server that only this machine can reach, and stop it in the end.

    Args:
        port: to listen at; 0 for any that is free.

    Raises:
        MissingExtra: viser is not installed.
        HoldfastError: the port is not free.
    """
    try:
        import viser
    except ImportError as cause:
        raise MissingExtra("the viewer needs viser; try pip install 'holdfast[view]'") from cause
    with _silence():  # its banner
        server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    try:
        if port not in (0, server.get_port()):  # viser takes the next free one silently
            raise HoldfastError(f"port {port} is in use; try another --port, or none")
        yield server
    finally:
        with _silence():
            server.stop()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep from terminal and notebook what is printed meanwhile."""
    from rich import get_console

    console = get_console()  # in a notebook it does not write to stdout
    before, console.quiet = console.quiet, True
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        console.quiet = before


def _pose(at: Pose) -> dict[str, Array]:
    wxyz_xyz = at.wxyz_xyz
    return {"wxyz": wxyz_xyz[:4], "position": wxyz_xyz[4:]}
