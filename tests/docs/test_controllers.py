"""The gallery of controllers has every law of the library and of scenes, each with its picture."""

import re

from benchmarks.controller_pictures import FOLDER, PICTURES

import holdfast.control as control
from holdfast.control.law_parts import LawPart
from holdfast.scenario import controller_tables
from holdfast.scenario.table import KeyTable
from tests.docs.pages import DOCS

PAGE = (DOCS / "controllers.md").read_text(encoding="utf-8")


def test_every_law_and_every_type_of_scenes():
    """Parts of laws, laws of their own, and the words that scenes have for them."""
    public = [getattr(control, name) for name in control.__all__]
    parts = {one.__name__ for one in public if isinstance(one, type) and issubclass(one, LawPart)}
    laws = {"GravityCompensation", "ObjectTracking", "cooperative_law", "admittance_law", "observed"}
    for name in parts | laws:
        assert f"`{name}" in PAGE, name
    tables = [one for one in vars(controller_tables).values() if isinstance(one, type) and issubclass(one, KeyTable)]
    for tag in {one.__struct_config__.tag for one in tables} - {None, "torque_schedule", "cooperative_law"}:
        assert f'`"{tag}"`' in PAGE, tag


def test_every_picture():
    """Those that the command makes are there and shown, each once, with words for those who cannot see it."""
    shown = re.findall(r"!\[(.{30,})\]\(images/controllers/(\w+)\.png\)", PAGE)
    assert [name for _, name in shown] == sorted((name for _, name in shown), key=list(PICTURES).index)
    assert {name for _, name in shown} == set(PICTURES) == {path.stem for path in FOLDER.glob("*.png")}
