"""The notebook runs from its first cell to its last, in Python and in a kernel, and shows what it is stored with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from holdfast.view import inline

NOTEBOOK = Path(__file__).parents[2] / "examples" / "notebooks" / "first_run.ipynb"


def cells() -> list[dict[str, Any]]:
    """Return the cells with code."""
    stored = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return [cell for cell in stored["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow
def test_in_python(monkeypatch):
    """Every cell, in one namespace; a thousand systems go on, and the one that is looked at is among them."""
    for extra in ("matplotlib", "viser"):
        pytest.importorskip(extra, reason=f"needs {extra}: pip install 'holdfast[plot,view]'")
    monkeypatch.setattr(inline, "in_notebook", lambda: True)  # no browser
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, Any] = {}
    for k, cell in enumerate(cells()):
        exec(compile("".join(cell["source"]), f"cell {k}", "exec"), names)
    record, moved = names["record"], names["moved"]
    assert record.systems.running.all() and len(record.systems) == 1000
    assert np.array_equal(record.trajectory(17).q, record["q"][:, 17])
    assert 1e-4 < np.median(moved) < 1e-2


def test_stored_with_its_output():
    """No cell was left out or failed, and none holds a page of a megabyte."""
    for k, cell in enumerate(cells()):
        assert cell["execution_count"] == k + 1
        assert cell["outputs"] and all(output["output_type"] != "error" for output in cell["outputs"])
    assert NOTEBOOK.stat().st_size < 250_000


@pytest.mark.long
def test_in_a_kernel():
    """A kernel shows tables, figures and the page inside the notebook, and prints nothing besides."""
    client = pytest.importorskip("nbclient", reason="needs nbclient: pip install nbclient ipykernel")
    import nbformat

    notebook = nbformat.read(NOTEBOOK, 4)
    client.NotebookClient(notebook, timeout=300).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    kinds = [output.output_type for output in shown]
    assert "error" not in kinds and "stream" not in kinds
    texts = ["".join(output.data.get("text/html", "")) for output in shown]
    assert sum(text.startswith("<iframe") for text in texts) == 1
    assert sum("<table>" in text for text in texts) == 3
    assert sum("image/png" in output.data for output in shown) == 2
