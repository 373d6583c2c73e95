"""The live viewer's clock and numbers, on a server that nobody looks at."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.view import live
from holdfast.view.live import Controls, readout, watch
from holdfast.view.markers import ArrowScale, arrow_scale
from holdfast.view.scene_writer import viewer_server
from tests.view.runs import played

pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")


@pytest.fixture(scope="module")
def playback():
    return played()


@pytest.fixture
def controls(playback):
    with viewer_server() as server:
        yield Controls(server, playback, ArrowScale(0.01, 0.1))


def test_clock(controls):
    """It stands until it is told to play, runs at the speed chosen, begins anew at the end, and obeys the slider."""
    now = controls._before
    assert [controls.frame(now + t) for t in (0.0, 1.0)] == [0, 0]
    controls._play(True)
    assert [controls.frame(now + 1.0 + t) for t in (0.25, 0.45, 0.85)] == [1, 2, 4]
    assert controls._slider.value == pytest.approx(0.85)
    assert controls.frame(now + 2.1) == 0, "past the end: from the beginning"
    controls._speed.value = "0.5x"
    assert controls.frame(now + 3.1) == 2
    controls._slider.value = 0.9
    assert controls.frame(now + 3.2) == 4
    controls._play(False)
    assert controls.frame(now + 9.0) == 4


def test_arrow_length(controls):
    """The slider multiplies the usual scale."""
    controls._length.value = 2.0
    assert controls.scale == pytest.approx((0.02, 0.2))


def test_readout(playback, controls):
    """A row for each arm with its force, internal force, moment, margin and torque; the needle within the meter."""
    text = readout(playback, 0)
    force = np.linalg.norm(playback.wrench[0, 1, 3:])
    for number in (f"{force:.3g}", f"{playback.margin[0, 1]:.3g}", f"{100 * playback.torque_use('right')[0]:.3g}"):
        assert f">{number}<" in text
    assert text.count("<tr>") == 3
    controls.show_numbers(0)
    assert controls._numbers.content == text


def test_watch_ends_with_ctrl_c(playback):
    """The address is told while it can be opened; after Ctrl-C the port is free again."""
    import socket

    found = []

    def opened(address):
        found.append(int(address.rpartition(":")[2]))
        assert address.startswith("http://127.0.0.1:")
        with socket.create_connection(("127.0.0.1", found[0]), timeout=5):
            pass
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        watch(playback, opened)
    with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", found[0]), timeout=5):
        pass


def test_of_several_one_is_chosen(playback, monkeypatch):
    """The first is shown first; a choice puts up the other's scene and controls, at the time that was shown."""
    later, seen = replace(playback, title="later", wrench=3.0 * playback.wrench), []

    class Watched(Controls):
        def frame(self, now):
            found = super().frame(now)
            seen.append((self.chosen, found, self.scale))
            if len(seen) == 1:
                self._slider.value = 0.6
            elif len(seen) == 2:
                self._choice.value = "later"
            elif self.chosen == "later":
                raise KeyboardInterrupt
            return found

    monkeypatch.setattr(live, "Controls", Watched)
    addresses = []
    with pytest.raises(KeyboardInterrupt):
        watch([playback, later], addresses.append)
    assert len(addresses) == 1
    assert [one[:2] for one in seen] == [("lifted", 0), ("lifted", 3), ("later", 3)]
    assert seen[0][2] == seen[2][2] == arrow_scale(later), "one scale for both, that of the larger forces"
