"""The command that asks Talos, or a humanoid built in code, on two soles with a box."""

import sys

import pytest
from benchmarks import talos_box


@pytest.mark.slow
def test_main(capsys, monkeypatch):
    """It prints balance, residuals and margins within the bars, and what conflicts."""
    monkeypatch.setattr(sys, "argv", ["talos_box", "--rounds", "1"])
    talos_box.main()
    said = capsys.readouterr().out
    assert said.count("optimal") == 2
    assert float(said.split("feet and weight differ by ")[1].split()[0]) <= 1e-10
    assert all(float(part.split()[0].rstrip(",")) <= 1e-9 for part in said.split("residual ")[1:])
    assert "limit" in said.split("box up by 80 m/s^2: ")[1]
