"""Sphinx settings: `make docs` builds the site without network and without warnings."""

import os
import sys
from importlib.metadata import version as installed_version
from importlib.resources import files
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_sphinx"))
os.environ.setdefault("HOLDFAST_COMPILE", "quick")  # for the notebook that is executed: the same bits, sooner

project = "holdfast"
author = "the holdfast authors"
project_copyright = "the holdfast authors, Apache-2.0"
version = release = installed_version("holdfast")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "docstrings",
    "mathml",
    "notebook",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "_sphinx"]
suppress_warnings = ["myst.header"]  # included pages (changelog, contributing) begin at level 1 of their own
nitpicky = False

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = "holdfast"
html_static_path = ["_static", str(files("ziamath") / "fonts" / "STIXTwoMath-Regular.ttf")]  # for equations
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
pygments_style, pygments_dark_style = "friendly", "monokai"
highlight_language = "text"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_type_aliases = {
    name: name
    for name in (
        "Array",
        "Scalar",
        "Controller",
        "FreeDynamics",
        "BaseMotion",
        "Torque",
        "MakeStepper",
        "GraspKind",
        "Motions",
    )
} | {"ArrayLike": "ArrayLike"}
python_use_unqualified_type_names = True
maximum_signature_line_length = 100
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_attr_annotations = False
