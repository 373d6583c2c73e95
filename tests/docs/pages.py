"""The pages of the documentation, and the parts of them that tests look at."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)]

FENCE = re.compile(r"^(?P<fence>`{3,})(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=fence)$", re.MULTILINE | re.DOTALL)


def name(page: Path) -> str:
    """Return a page's name as tests show it."""
    return page.relative_to(ROOT).as_posix()


def fences(page: Path) -> list[tuple[str, str]]:
    """Return language and text of every fenced block of a page."""
    found = FENCE.finditer(page.read_text(encoding="utf-8"))
    return [(match["language"].strip(), match["text"]) for match in found]
