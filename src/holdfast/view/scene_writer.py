"""An interface to the 3D viewer viser for drawing: nodes, poses, arrows, labels.

Names are paths; a node moves with its parent in the path.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import HoldfastError, MissingExtra
from holdfast.robots.mesh_files.mesh import TriangleMesh
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

RGB = tuple[int, int, int]
FIELD_OF_VIEW = np.radians(35.0)  # angle between the upper and lower edges of the picture


class Camera(NamedTuple):
    """A view of the scene.

    Attributes:
        name: name of the view.
        position: (3,) position of the camera, world axes [m].
        target: (3,) point at which the camera is aimed [m].
    """

    name: str
    position: Array
    target: Array


class SceneWriter:
    """Draws into a viser server.

    Attributes:
        server: the viser server, for recording and controls.
    """

    def __init__(self, server: Any) -> None:
        """Start an empty scene.

        Args:
            server: the result of `viewer_server`.
        """
        self.server = server
        self._nodes: dict[str, Any] = {}
        self._arrows: dict[str, tuple[Any, float]] = {}  # radius of the shafts, by node
        self._sent: dict[str, Any] = {}  # values that have been sent to viewers

    def set_camera(self, camera: Camera, up: Array) -> None:
        """Set the initial camera and the upward direction (3,)."""
        scene, begin = self.server.scene, self.server.initial_camera
        scene.set_up_direction(up)
        scene.configure_default_lights(True, cast_shadow=False)  # takes half of the time without a graphics card
        begin.position, begin.look_at, begin.fov = camera.position, camera.target, float(FIELD_OF_VIEW)

    def frame(self, name: str, at: Pose, axes: float = 0.0) -> None:
        """Add a frame with axes of the given length [m], which are invisible if it is 0."""
        self._nodes[name] = self.server.scene.add_frame(
            name, show_axes=axes > 0, axes_length=axes, axes_radius=0.04 * axes, origin_radius=0.06 * axes, **_pose(at)
        )

    def mesh(self, name: str, mesh: TriangleMesh, colour: RGB, opacity: float | None = None) -> None:
        """Add a surface, opaque by default; a translucent one is visible from both sides."""
        self._nodes[name] = self.server.scene.add_mesh_simple(
            name, mesh.vertices, mesh.faces, color=colour, opacity=opacity,
            side="front" if opacity is None else "double",
        )  # fmt: skip

    def lines(self, name: str, segments: Array, colour: RGB, thickness: float) -> None:
        """Add straight lines (N, 2, 3) of the given thickness [m]."""
        self._nodes[name] = self.server.scene.add_line_segments(name, segments, colour, thickness=thickness)

    def redraw(self, name: str, segments: Array) -> None:
        """Replace the end points of lines, (N, 2, 3), whose number stays the same [m]."""
        self._nodes[name].points = segments.astype(np.float32)

    def grid(self, name: str, at: Pose, width: float, cell: float) -> None:
        """Add a square grid in the x-y plane of a pose [m]."""
        self.server.scene.add_grid(
            name, width=width, height=width, cell_size=cell, section_size=5 * cell, cell_color=(225, 225, 225),
            section_color=(195, 195, 195), **_pose(at),
        )  # fmt: skip

    def label(self, name: str, text: str, position: Array) -> None:
        """Add a label that always faces the camera."""
        self.server.scene.add_label(name, text, position=position, anchor="bottom-center")

    def arrows(self, name: str, count: int, colour: RGB, shaft: float) -> None:
        """Add arrows of length zero; `point` sets their ends.

        Args:
            name: name of the group of arrows.
            count: number of arrows.
            colour: colour of the arrows.
            shaft: radius of their shafts [m]; short arrows are thinner.
        """
        none = np.zeros((count, 2, 3), dtype=np.float32)
        # viser shows arrows in lighter colours than given, because it assumes linear light
        dark = tuple(round(255 * (channel / 255) ** 2.2) for channel in colour)
        node = self.server.scene.add_arrows(name, none, dark, shaft_radius=0.0, head_radius=0.0, head_length=0.0)
        self._arrows[name] = node, shaft

    def point(self, name: str, segments: Array) -> None:
        """Set tails and tips of the arrows, (count, 2, 3) world axes [m]."""
        node, shaft = self._arrows[name]
        head = 6.0 * shaft
        longest = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).max())
        # a head longer than its arrow would protrude at the tail
        size = int(1000 * min(1.0, 0.5 * longest / head)) / 1000
        if self._sent.get(name) != size:  # viser compares values too, but slowly
            self._sent[name] = size
            node.shaft_radius, node.head_radius, node.head_length = size * shaft, 2.4 * size * shaft, size * head
        node.points = segments.astype(np.float32)

    def place(self, name: str, wxyz: Array, position: Array) -> None:
        """Set the pose of a node relative to its parent."""
        node = self._nodes[name]
        for part, now in (("wxyz", wxyz), ("position", position)):
            # float32 halves the size of a compressed recording, and viewers draw with this precision
            data = now.astype(np.float32).tobytes()
            if self._sent.get(name + part) != data:
                self._sent[name + part] = data
                setattr(node, part, np.frombuffer(data, dtype=np.float32))

    def paint(self, name: str, colour: RGB) -> None:
        """Change the colour of lines."""
        self._nodes[name].colors = np.array(colour, dtype=np.uint8)

    def at_once(self) -> AbstractContextManager[None]:
        """Return a context within which all changes are sent to viewers at the same time."""
        return self.server.atomic()


@contextmanager
def viewer_server(port: int = 0) -> Iterator[Any]:
    """Run a viser server that is reachable from this machine only, and stop it at the end of the context.

    Args:
        port: port of the server; 0 for any free port.

    Raises:
        MissingExtra: viser is not installed.
        HoldfastError: the port is not free.
    """
    try:
        import viser
    except ImportError as cause:
        raise MissingExtra("the viewer needs viser; try pip install 'holdfast[view]'") from cause
    with _silence():  # the banner
        server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    try:
        if port not in (0, server.get_port()):  # viser would silently take the next free port
            raise HoldfastError(f"port {port} is in use; try another --port, or none")
        yield server
    finally:
        with _silence():
            server.stop()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppress output to terminal and notebook within the context."""
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
