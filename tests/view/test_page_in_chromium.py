"""An exported page opens from disk, off the network: the slider moves the arms and the arrows, nothing complains.

`make pictures` sets HOLDFAST_PICTURE and HOLDFAST_RESULT: then the same page, of that result, is README's picture.
"""

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.cli import main
from holdfast.view.cameras import cameras
from holdfast.view.page import export_page
from holdfast.view.playback import playback_of_run, torque_shares
from tests.view.chromium import browser
from tests.view.runs import lifted, played

pytestmark = pytest.mark.slow

pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
WRIST = "/arms/left/joint1/joint2/joint3/joint4"


@pytest.fixture(scope="module")
def at_times(tmp_path_factory):
    """The page of a run, and what it shows at the first and at the last moment, and back at the first."""
    folder = tmp_path_factory.mktemp("page")
    playback = played()
    export_page(playback, folder / "page.html")
    with browser(720, 400) as chromium:  # small: the processor draws it
        chromium.open(folder / "page.html")
        seen = []
        for t in (0.0, 1.0, 0.0):
            chromium.go_to(t)
            seen.append(
                {
                    "time": chromium.player_time(),
                    "cursor": chromium.ask("() => document.querySelector('.cursor').getAttribute('x1')"),
                    "text": chromium.page.inner_text("#holdfast"),
                    "times": chromium.ask("() => [...document.querySelectorAll('#root .mantine-NumberInput-root')]"
                                          ".map(of => getComputedStyle(of).display)"),
                    "veil": chromium.ask("() => [...document.querySelectorAll('#root canvas')].map(of => {"
                                         " of.style.opacity = 0.05; return getComputedStyle(of).opacity })"),
                    "wrist": chromium.pose(WRIST),
                    "object": chromium.pose("/object"),
                    "bars": chromium.ask("() => [...document.querySelectorAll('.bars:first-of-type .used')]"
                                         ".map(of => Number(of.getAttribute('height')))"),
                    "force": chromium.arrow("/forces/left"),
                    "cone": chromium.ask("() => [...__viserSceneTree.getState()['/object/cones/left']"
                                         ".message.props.colors.slice(0, 3)]"),
                    "picture": chromium.page.screenshot(path=folder / f"{len(seen)}.png"),
                }
            )  # fmt: skip
        where = "() => __viserMutable.camera.position.toArray()"
        cameras = [chromium.ask(where)]
        chromium.page.click("#holdfast button:has-text('top')")
        chromium.page.wait_for_timeout(1000)
        cameras.append(chromium.ask(where))
        chromium.ask("() => window.dispatchEvent(new KeyboardEvent('keydown', {code: 'Space'}))")
        chromium.page.wait_for_timeout(500)
        playing = chromium.player_time()
    return playback, seen, cameras, playing, chromium


def test_slider_moves_the_arms(at_times):
    """Joints and object go where the run has them, and back."""
    playback, (first, last, again), *_ = at_times
    assert [seen["time"] for seen in (first, last, again)] == pytest.approx([0.0, 1.0, 0.0])
    assert np.abs(np.array(first["wrist"]) - last["wrist"]).max() > 1e-2
    for seen, k in ((first, 0), (last, -1)):
        pose = playback.object_pose[k]
        assert seen["object"] == pytest.approx(pose, abs=1e-6)
    assert again["wrist"] == first["wrist"]
    assert again["object"] == first["object"]


def test_bars_change(at_times):
    """The left arm's bars are as high as its shares of the torque limits, and its grip, on 35 pixels for 100 %."""
    playback, (first, last, _), *_ = at_times
    for seen, k in ((first, 0), (last, -1)):
        shares = torque_shares(playback.chain, "left", playback.tau[[k]])[0]
        expected = 35.0 * np.minimum(np.r_[shares, playback.grip_use("left")[k]], 1.2)  # further up there is no room
        assert seen["bars"] == pytest.approx(expected, abs=0.2)
    assert first["bars"] != last["bars"]


def test_arrows_and_cones_change(at_times):
    """The force's arrow is the force, from the contact; the cone turns red."""
    playback, (first, last, _), *_ = at_times
    for seen, k in ((first, 0), (last, -1)):
        tail, tip = np.array(seen["force"]).reshape(2, 3)
        assert tail == pytest.approx(playback.tip[k, 0], abs=1e-6)
        cosine = (tip - tail) @ playback.wrench[k, 0, 3:]
        assert cosine == pytest.approx(np.linalg.norm(tip - tail) * np.linalg.norm(playback.wrench[k, 0, 3:]), rel=1e-6)
    assert first["cone"] != last["cone"] == [213, 94, 0]


def test_panel_follows(at_times):
    """The panel's numbers and cursor are those of the player's time."""
    playback, (first, last, _), *_ = at_times
    assert "t = 0.00 s" in first["text"]
    assert first["times"] == ["none"], "the player shows no time of its own beside the panel's"
    assert set(first["veil"]) == {"1"}, "the picture does not fade in"
    assert "t = 1.00 s" in last["text"]
    assert f"left {np.linalg.norm(playback.wrench[0, 0, 3:]):.1f}" in first["text"]
    assert float(last["cursor"]) > float(first["cursor"]) + 200


def test_cameras_and_play(at_times):
    """A camera button moves the camera; space plays on."""
    _, _, (overview, top), playing, _ = at_times
    assert np.linalg.norm(np.array(overview) - top) > 0.5
    assert 0.05 < playing <= 1.0


def test_nothing_is_asked_for_and_nothing_complains(at_times):
    """Off the network: the file itself, and what is inside it; no error on the console."""
    *_, chromium = at_times
    assert not chromium.errors
    assert [url for url in chromium.requests if not url.startswith(("data:", "blob:"))] == chromium.requests[:1]
    assert chromium.requests[0].startswith("file://")


def test_something_is_to_be_seen(at_times):
    """The picture is of many colours, and another at another time."""
    _, (first, last, _), *_ = at_times
    assert len(first["picture"]) > 25_000
    assert first["picture"] != last["picture"]


@pytest.mark.skipif("HOLDFAST_PICTURE" not in os.environ, reason="made by `make pictures`")
def test_readme_picture(tmp_path):
    """The demo in the middle of its motion, as the exported page shows it."""
    assert main(["view", os.environ["HOLDFAST_RESULT"], "--export", str(tmp_path / "page.html")]) == 0
    with browser(860, 610, sharpness=1.6) as chromium:
        chromium.open(tmp_path / "page.html")
        chromium.go_to(1.0)
        chromium.page.wait_for_timeout(3000)
        chromium.page.screenshot(path=Path(os.environ["HOLDFAST_PICTURE"]), timeout=120_000)
    assert not chromium.errors


@pytest.mark.long
def test_a_minute_of_two_arms(tmp_path):
    """60 s, 30 moments a second: at most 20 MB; the player keeps time, and goes anywhere."""
    chain, run = lifted(samples=31)
    playback = playback_of_run(chain, run, "a minute")
    t = np.linspace(0.0, 60.0, 1801)
    to_and_fro = 0.5 - 0.5 * np.cos(2 * np.pi * t / 6.0)
    rng = np.random.default_rng(0)

    def stretched(values: np.ndarray) -> np.ndarray:
        columns = values.reshape(len(playback), -1).T
        return np.stack([np.interp(to_and_fro, playback.t, c) for c in columns], axis=1).reshape(-1, *values.shape[1:])

    names = ("q", "base_pose", "object_pose", "tip", "wrench", "internal", "margin", "condition", "strength", "tau")
    minute = replace(playback, t=t, **{name: stretched(getattr(playback, name)) for name in names})
    # so that it compresses no better than real runs do
    minute = replace(minute, q=minute.q + 1e-4 * rng.normal(size=minute.q.shape))
    begin = time.monotonic()
    export_page(minute, tmp_path / "page.html")
    written, size = time.monotonic() - begin, (tmp_path / "page.html").stat().st_size
    with browser() as chromium:
        begin = time.monotonic()
        chromium.open(tmp_path / "page.html")
        loaded = time.monotonic() - begin
        seeks = []
        for t_wanted in (50.0, 5.0, 30.0):
            begin = time.monotonic()
            chromium.ask("t => document.getElementById('holdfast').goTo(t)", t_wanted)
            seeks.append(time.monotonic() - begin)
            assert chromium.player_time() == pytest.approx(t_wanted)
        chromium.page.keyboard.press("Space")
        clock, ticks = chromium.ask(WATCH)
    print(f"\n60 s of two arms: {size / 1e6:.2f} MB, written in {written:.1f} s, loaded in {loaded:.1f} s, "
          f"seeks of {max(seeks):.1f} s at most; {ticks:.1f} pictures a second drawn without a graphics card, "
          f"{clock:.3f} s a second")  # fmt: skip
    assert size <= 20e6
    assert clock == pytest.approx(1.0, abs=0.15)
    assert not chromium.errors


# plays for 8 s: the player's seconds in a second, and the pictures drawn in one
WATCH = """() => new Promise(done => {
  const time = () => Number(document.querySelector('#root [role=slider]').getAttribute('aria-valuenow'));
  const from = performance.now(), first = time();
  let ticks = 0;
  (function tick() {
    ticks++;
    const passed = (performance.now() - from) / 1000;
    if (passed < 8) requestAnimationFrame(tick); else done([(time() - first) / passed, ticks / passed]);
  })();
})"""


@pytest.mark.long
def test_a_narrow_picture_and_equal_curves(tmp_path):
    """The eye goes as far away as the width asks for, and back with the window; of equal curves both are seen."""
    playback = played()
    export_page(playback, tmp_path / "page.html")
    first, root = cameras(playback)[0], "__viserMutable.camera.position.toArray()"
    near = np.linalg.norm(first.position)
    with browser(800, 1000) as chromium:
        chromium.open(tmp_path / "page.html")
        chromium.page.wait_for_function(f"far => Math.hypot(...{root}) > far", arg=1.3 * near)
        chromium.page.set_viewport_size({"width": 1400, "height": 600})
        chromium.page.wait_for_function(f"far => Math.hypot(...{root}) < far", arg=1.1 * near)
        curves = "#holdfast :not(.bars) > svg"
        widths = chromium.ask(f"() => [...document.querySelector('{curves}').querySelectorAll('polyline')]"
                              ".map(line => Number(line.getAttribute('stroke-width')))")  # fmt: skip
        ticks = chromium.ask(
            "() => [...document.querySelectorAll('#holdfast :not(.bars) > svg text')].map(of => of.textContent)"
        )
    assert np.all(np.diff(widths) < 0.0)
    force = np.linalg.norm(playback.wrench[..., 3:], axis=2)
    assert float(ticks[1]) <= force.min() and force.max() <= float(ticks[0]) < 1.5 * force.max()


@pytest.mark.long
def test_a_page_of_several(tmp_path):
    """Whoever chooses another run, by mouse or by its number, sees it at the same time from the same camera."""
    first = played("first")
    export_page([first, replace(first, title="second", object_pose=first.object_pose[::-1])], tmp_path / "page.html")
    with browser(480, 300) as chromium:
        chromium.page.goto((tmp_path / "page.html").resolve().as_uri())

        def shown():
            frame = chromium.page.query_selector("iframe.shown").content_frame()
            frame.wait_for_selector("#root [role=slider]", state="attached", timeout=60_000)
            return frame

        def seen(frame):
            return frame.evaluate("() => document.getElementById('holdfast').seen()")

        frame = shown()
        frame.wait_for_function("() => document.getElementById('holdfast').see({time: 0.6})")
        frame.click("#holdfast button:has-text('top')")
        chromium.page.wait_for_timeout(1000)
        before = seen(frame)
        for choose, title in ((lambda: chromium.page.click("nav button:has-text('second')"), "second"),
                              (lambda: chromium.page.keyboard.press("1"), "first")):  # fmt: skip
            choose()
            frame = shown()
            same = "t => Math.abs(document.getElementById('holdfast').seen().time - t) < 5e-3"
            frame.wait_for_function(same, arg=before["time"])
            chromium.page.wait_for_timeout(300)
            assert title in frame.inner_text("#holdfast h1")
            assert seen(frame)["eye"] == pytest.approx(before["eye"], abs=1e-6)
            assert seen(frame)["target"] == pytest.approx(before["target"], abs=1e-6)
    assert not chromium.errors
