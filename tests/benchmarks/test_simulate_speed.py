"""The table of what a step costs has a row for every bar, and says which are missed."""

import re

import pytest
from benchmarks import simulate_speed
from benchmarks.bench.clock import Effort


@pytest.mark.long
def test_rows(monkeypatch):
    """With few steps, and first runs that were timed before: all is measured, and compared with its bar."""
    monkeypatch.setattr(simulate_speed, "first_runs", lambda count: (0.06, 0.06))
    lines = simulate_speed.table(20, Effort(1e-3, 1)).split("\n")
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:] if line.startswith("|")]
    bars = {name: bar for name, _, _, bar, _ in cells}
    assert len(bars) == 14 and list(bars.values())[-2:] == ["3000 ms", "50 ms, missed"]
    for name, cost, in_F, bar, _ in cells[:-2]:
        assert float(cost.split()[0]) > 0.0 or "rollout" not in name  # the others are differences of two short runs
        limit = re.match(r"([\d.e+]+) F(, missed)?$", bar)
        assert bar == "-" or (limit and bool(limit[2]) == (float(in_F) > float(limit[1]))), name
