"""An exported page in headless Chromium: off the network, every request and every complaint taken down."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

SETTLE = 400  # ms, for a picture to be drawn
QUIET = ".mantine-Notifications-root { display: none !important }"  # the hint that there is no graphics card


class Browser:
    """A page and what it did.

    Attributes:
        page: playwright's page.
        requests: every address it asked for.
        errors: what it complained about.
    """

    def __init__(self, page: Any) -> None:
        self.page = page
        self.requests: list[str] = []
        self.errors: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda said: self.errors.append(said.text) if said.type == "error" else None)

    def open(self, path: Path) -> None:
        """Open a page from disk, wait for its player, pause it."""
        self.page.goto(path.resolve().as_uri())
        self.page.wait_for_selector("#root [role=slider]", state="attached", timeout=60_000)
        self.page.add_style_tag(content=QUIET)
        self.page.keyboard.press("Space")

    def ask(self, question: str, argument: Any = None) -> Any:
        """Return what a JavaScript function says."""
        return self.page.evaluate(question, argument)

    def go_to(self, t: float) -> None:
        """Go to a time of the player [s]."""
        self.ask("t => document.getElementById('holdfast').goTo(t)", t)
        self.page.wait_for_timeout(SETTLE)

    def player_time(self) -> float:
        """Return the time that the player's slider shows [s]."""
        return float(self.ask("() => document.querySelector('#root [role=slider]').getAttribute('aria-valuenow')"))

    def pose(self, node: str) -> list[float]:
        """Return wxyz and position of a node in the frame it is named under."""
        return self.ask("n => { const p = __viserMutable.nodePoseData[n]; return [...p.wxyz, ...p.position] }", node)

    def arrow(self, node: str) -> list[float]:
        """Return tail and tip of the first arrow of a node, (6,)."""
        return self.ask("n => Array.from(__viserSceneTree.getState()[n].message.props.points.slice(0, 6))", node)


@contextlib.contextmanager
def browser(width: int = 1000, height: int = 600, sharpness: float = 1.0) -> Iterator[Browser]:
    """Start Chromium without network; where there is none, skip the test and say why."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if executable is None:
        pytest.skip("needs a Chromium on the path: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        # --disable-gpu: drawn by the processor, wherever this runs; --no-sandbox: also in containers
        chromium = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox", "--disable-gpu"])
        context = chromium.new_context(
            viewport={"width": width, "height": height}, device_scale_factor=sharpness, offline=True
        )
        try:
            yield Browser(context.new_page())
        finally:
            chromium.close()
