"""The little that we ask of viser, asked of viser itself."""

import socket

import numpy as np
import pytest

from holdfast import HoldfastError, Pose
from holdfast.view import meshes
from holdfast.view.scene_writer import SceneWriter, viewer_server

pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")


@pytest.fixture(scope="module")
def writer():
    with viewer_server() as server:
        yield SceneWriter(server)


def test_only_this_machine(writer, capfd):
    """The server listens on the loopback address only, and says nothing."""
    assert writer.server.get_host() == "127.0.0.1"
    with viewer_server():
        pass
    assert capfd.readouterr() == ("", "")


def test_short_arrows_are_thin(writer):
    """Heads are at most half of an arrow; what has no length cannot be seen."""
    writer.arrows("/forces", 2, (0, 114, 178), 0.01)
    node = writer.server.scene.get_handle_by_name("/forces")
    for length, whole in ((1.0, True), (0.05, False), (0.0, False)):
        writer.point("/forces", np.array([[[0, 0, 0], [0, 0, length]], [[0, 0, 0], [0, 0, 0.8 * length]]]))
        assert node.head_length <= max(0.5 * length, 1e-9) or whole
        assert (node.shaft_radius == 0.01) == whole
        assert node.points[0, 1] == pytest.approx([0, 0, length])
    assert node.shaft_radius == node.head_radius == node.head_length == 0.0


def test_nodes(writer):
    """Poses, colours and surfaces arrive."""
    at = Pose.translation(0.1, 0.2, 0.3)
    writer.frame("/object", at)
    writer.mesh("/object/body", meshes.box((1, 1, 1)), (1, 2, 3), 0.5)
    writer.lines("/object/edges", np.zeros((3, 2, 3)), (4, 5, 6), 0.01)
    writer.place("/object", np.array([0.0, 1.0, 0.0, 0.0]), np.array([1.0, 2.0, 3.0]))
    writer.paint("/object/edges", (7, 8, 9))
    of = writer.server.scene.get_handle_by_name
    assert of("/object").position == pytest.approx([1, 2, 3])
    assert of("/object").wxyz == pytest.approx([0, 1, 0, 0])
    assert of("/object/body").opacity == 0.5
    assert of("/object/edges").colors.tolist() == [7, 8, 9]


def test_port_in_use():
    """A port that someone has is refused instead of the next one taken silently."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(HoldfastError, match=f"port {port} is in use"), viewer_server(port):
            pass
