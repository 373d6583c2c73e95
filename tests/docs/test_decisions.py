"""The decisions: each in one room with one status, all in the index, and none named that is not there."""

import re

from tests.docs.pages import DOCS, PAGES

PAGE = (DOCS / "decisions.md").read_text(encoding="utf-8")
DECISION = re.compile(r"^### Decision (\d+)\n\n\*Status: (.+)\.\*\n\n\*\*", re.MULTILINE)
LINK = r"\[(\d+)\]\(#decision-\d+\)"
STATUS = re.compile(rf"accepted(, amended by {LINK}(, {LINK})*)?|superseded by {LINK}")


def test_every_decision_has_a_status():
    """A number is used once, its status is of a known form, and later decisions amend earlier ones."""
    found = DECISION.findall(PAGE)
    numbers = [int(number) for number, _ in found]
    assert len(numbers) == PAGE.count("\n### ") == len(set(numbers))
    for number, status in found:
        assert STATUS.fullmatch(status), (number, status)
        assert all(int(number) < int(later) for later in re.findall(r"\[(\d+)\]", status)), (number, status)


def test_the_index_is_complete():
    """A row for each decision, in the order of numbers, with the room under whose heading it is."""
    rows = re.findall(r"^\| \[(\d+)\]\(#decision-\1\) \| .+ \| \[(.+)\]\(#\2\) \|$", PAGE, re.MULTILINE)
    rooms = {}
    for chapter in PAGE.split("\n## ")[1:]:
        rooms |= {number: chapter.split("\n")[0] for number, _ in DECISION.findall(chapter)}
    assert rows == sorted(rooms.items(), key=lambda row: int(row[0]))


def test_named_decisions_exist():
    """Whoever names a decision names one that is there."""
    numbers = {number for number, _ in DECISION.findall(PAGE)}
    for page in PAGES:
        assert set(re.findall(r"#decision-(\d+)", page.read_text(encoding="utf-8"))) <= numbers, page.name
