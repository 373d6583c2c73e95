"""The table of what a step costs has a row for all that is measured, and goes between the markers of its page."""

import re

import pytest
from benchmarks import simulation_cost

from tests.docs.pages import DOCS

PAGE = DOCS / "limitations.md"


def rows(text):
    """Return what is measured, and the numbers [us]."""
    return {
        what: float(cost.replace(",", "")) for what, cost in re.findall(r"^\| (.+?) \| ([\d.,]+) us \|$", text, re.M)
    }


@pytest.mark.long
def test_the_page_has_what_is_measured(monkeypatch, tmp_path):
    """Written into a copy of the page, with fewer steps: the same rows and the same text around them."""
    monkeypatch.setattr(simulation_cost, "STEPS", 2)
    monkeypatch.setattr(simulation_cost, "ROUNDS", 1)
    copy, page = tmp_path / "page.md", PAGE.read_text(encoding="utf-8")
    copy.write_text(page, encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["simulation_cost", "--write", str(copy)])
    simulation_cost.main()
    written = copy.read_text(encoding="utf-8")
    assert list(rows(written)) == list(rows(page))
    assert all(cost > 0.0 for cost in rows(written).values())
    outside = re.compile(r"<!-- cost:begin -->.*<!-- cost:end -->", re.DOTALL)
    assert outside.sub("", written) == outside.sub("", page)


def test_what_the_page_says_of_it():
    """A step takes some ten times a rollout's, under a function a few times that; a cone program some ms."""
    cost = rows(PAGE.read_text(encoding="utf-8"))
    law, alone = cost["`simulate`, a `ControlLaw`"], cost["rollout of 1 system, the same `ControlLaw`"]
    assert 5.0 * alone < law < 20.0 * alone
    assert 2.0 * law < cost["`simulate`, a Python function called at every stage"] < 10.0 * law
    assert 1e3 < cost["one `largest_margin` of the soft fingers, with effort limits"] < 2e4
    assert 1e3 < cost["one `distribute` of the soft fingers"] < 2e4
