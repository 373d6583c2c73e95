"""A notebook as a page: executed when the site is built, its cells and what they show set below each other."""

import html
from pathlib import Path
from typing import Any

import nbformat
from docutils import nodes
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

TIMEOUT = 300  # seconds for a cell
QUIET = ["--IPKernelApp.log_level=ERROR"]  # of the kernel, which notes that it speaks to this machine


def setup(app: Any) -> dict[str, Any]:
    """Add the directive `notebook`, whose argument is the file, seen from the page."""
    app.add_directive("notebook", Notebook)
    return {"parallel_read_safe": True}


class Notebook(SphinxDirective):
    """The cells of a notebook, without the title with which it begins: the page has one."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Execute the notebook and return its cells."""
        path = Path(self.env.relfn2path(self.arguments[0])[1])
        self.env.note_dependency(str(path))
        notebook = nbformat.read(path, 4)
        place = {"metadata": {"path": str(path.parent)}}
        try:
            NotebookClient(notebook, timeout=TIMEOUT, resources=place, extra_arguments=QUIET).execute()
        except CellExecutionError as cause:
            raise ExtensionError(f"{path.name} fails: {cause}") from cause
        found: list[nodes.Node] = []
        for cell in notebook.cells:
            if cell.cell_type == "markdown":
                found += self.parsed(cell.source)
                continue
            found.append(nodes.literal_block(cell.source, cell.source, language="python"))
            for output in cell.outputs:
                found.append(nodes.container("", shown(output), classes=["notebook-output"]))
        return found

    def parsed(self, text: str) -> list[nodes.Node]:
        """Return the nodes of a text, less a title."""
        lines = [line for line in text.splitlines() if not line.startswith("# ")]
        return self.parse_text_to_nodes("\n".join(lines))


def shown(output: Any) -> nodes.Node:
    """Return what a cell shows, in the richest form that the site can show."""
    if output.output_type == "stream":
        return nodes.literal_block(output.text, output.text, language="text")
    data = output.data
    if "text/html" in data:
        return nodes.raw("", data["text/html"], format="html")
    if "image/png" in data:
        described = html.escape(data.get("text/plain", "figure"), quote=True)
        source = "".join(data["image/png"].split())
        return nodes.raw("", f'<img alt="{described}" src="data:image/png;base64,{source}">', format="html")
    return nodes.literal_block(data["text/plain"], data["text/plain"], language="text")
